//! The facade: images and camera models in, observations and warnings out.

use crate::{
    config::TrackerConfig,
    image::{ImageError, ImageView},
};
use rig_model::{CameraModel, MarkerLayout, MarkerObservation, MarkerObservations, PerColor, Stamp};
use std::collections::VecDeque;
use thiserror::Error;

/// What the tracker is fed with, in the order of arrival.
#[derive(Clone, Debug)]
pub enum Input<'a> {
    /// The camera's intrinsic parameters. Without them geometry is checked more coarsely.
    Camera(CameraModel),
    /// An image.
    Image(ImageView<'a>),
}

/// What comes out.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// One per image that was taken.
    Observations(MarkerObservations),
    /// Something that a human should know of.
    Warning(Warning),
}

/// What was refused, and why.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Warning {
    /// The image cannot be read.
    #[error("{0}")]
    Image(ImageError),
    /// The image is not younger than the one before.
    #[error("image stamped {stamp} is not younger than the one before ({previous}); it is left out")]
    StampFromThePast {
        /// Its stamp.
        stamp: Stamp,
        /// The stamp of the last image that was taken.
        previous: Stamp,
    },
    /// The camera model is for another image size.
    #[error(
        "camera_info is for {camera_width}x{camera_height}, but images are {width}x{height}; it is scaled where the ratio is the same, else left out"
    )]
    CameraSize {
        /// Of the camera model, px.
        camera_width: u32,
        /// Of the camera model, px.
        camera_height: u32,
        /// Of the image, px.
        width: usize,
        /// Of the image, px.
        height: usize,
    },
}

/// Finds and follows the four markers.
#[derive(Debug)]
pub struct Tracker {
    _layout: MarkerLayout,
    _config: TrackerConfig,
    outputs: VecDeque<Output>,
}

impl Tracker {
    /// For markers at these places of the platform.
    pub fn new(layout: MarkerLayout, config: TrackerConfig) -> Self {
        Self { _layout: layout, _config: config, outputs: VecDeque::new() }
    }

    /// Takes the next input; what follows from it waits in [`Tracker::poll`].
    pub fn handle(&mut self, input: Input<'_>) {
        if let Input::Image(image) = input {
            match image.check() {
                Ok(()) => self.outputs.push_back(Output::Observations(MarkerObservations {
                    stamp: image.stamp,
                    markers: PerColor([MarkerObservation::lost(MarkerObservation::NEVER); 4]),
                })),
                Err(error) => self.outputs.push_back(Output::Warning(Warning::Image(error))),
            }
        }
    }

    /// The next output, oldest first.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }
}
