//! The facade: images and camera models in, observations and warnings out.

use crate::{
    config::TrackerConfig,
    engine::Engine,
    image::{ImageError, ImageView},
};
use nalgebra::Vector2;
use rig_model::{CameraModel, MarkerColor, MarkerLayout, MarkerObservations, MarkerState, PerColor, Stamp};
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

/// A stamp that is so much older than the one before is no late image: the camera's time was set back, s.
const JUMP_BACK: f64 = 1.0;

/// What was refused, and why.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Warning {
    /// The image cannot be read.
    #[error("{0}")]
    Image(ImageError),
    /// The image is not younger than the one before (and not so much older that time was set back).
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
    /// The image is the one before it, byte for byte, with another stamp.
    #[error(
        "image stamped {stamp} is byte for byte the one before, the {images}. in a row: the camera or its driver stands still; nothing is measured in it"
    )]
    Repeated {
        /// Its stamp.
        stamp: Stamp,
        /// How many of them came in a row.
        images: u32,
    },
}

/// What a debug picture shows of one marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mark {
    /// The window that was looked at: left, top, right, bottom (the last two excluded), px.
    pub window: [i32; 4],
    /// Corners of the measured outline, px.
    pub outline: Option<[Vector2<f64>; 4]>,
    /// Centroid, px; NaN where the marker is lost.
    pub centroid: Vector2<f64>,
    /// Displacement since the image before, px.
    pub flow: Vector2<f64>,
    /// Its state.
    pub state: MarkerState,
}

/// What the tracker itself saw of one marker in the last image, for pictures of its stages.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// Column and row of the window's first pixel, px.
    pub origin: [i32; 2],
    /// Columns of the window.
    pub width: usize,
    /// The window's colour signal, row by row: 1 on the marker, 0 beside it, NaN outside of the image. It is the paper's
    /// binary image before it is rounded, and what the flow is told from.
    pub signal: Vec<f32>,
    /// The marker's hue histogram as it was learnt: equal bins over the circle from 0°, weighted by saturation, sum 1.
    pub hue: Vec<f32>,
}

impl Warning {
    /// A word for the kind, to count and throttle by.
    pub fn kind(&self) -> &'static str {
        match self {
            Warning::Image(_) => "image",
            Warning::StampFromThePast { .. } => "stamp",
            Warning::CameraSize { .. } => "camera size",
            Warning::Repeated { .. } => "repeated image",
        }
    }
}

/// Finds and follows the four markers.
#[derive(Debug)]
pub struct Tracker {
    engine: Engine,
    last_stamp: Option<Stamp>,
    /// The image size that does not fit the camera's model and was told of.
    warned_of: Option<(usize, usize)>,
    outputs: VecDeque<Output>,
}

impl Tracker {
    /// For markers at these places of the platform.
    pub fn new(layout: MarkerLayout, config: TrackerConfig) -> Self {
        Self {
            engine: Engine::new(layout, config),
            last_stamp: None,
            warned_of: None,
            outputs: VecDeque::with_capacity(8),
        }
    }

    /// Takes the next input; what follows from it waits in [`Tracker::poll`].
    pub fn handle(&mut self, input: Input<'_>) {
        match input {
            Input::Camera(camera) => {
                self.warned_of = None;
                self.engine.set_camera(camera);
            }
            Input::Image(image) => {
                if let Err(error) = image.check() {
                    self.outputs.push_back(Output::Warning(Warning::Image(error)));
                    return;
                }
                // A camera whose clock was put right, or a bag that is looped, goes on.
                let late = |last: &Stamp| (0.0..JUMP_BACK).contains(&last.seconds_since(image.stamp));
                if let Some(previous) = self.last_stamp.filter(late) {
                    self.outputs.push_back(Output::Warning(Warning::StampFromThePast {
                        stamp: image.stamp,
                        previous,
                    }));
                    return;
                }
                self.last_stamp = Some(image.stamp);
                let observations = self.engine.process(&image);
                self.outputs.push_back(Output::Observations(observations));
                if let Some((camera_width, camera_height)) = self.engine.other_size(&image)
                    && self.warned_of != Some((image.width, image.height))
                {
                    self.warned_of = Some((image.width, image.height));
                    self.outputs.push_back(Output::Warning(Warning::CameraSize {
                        camera_width,
                        camera_height,
                        width: image.width,
                        height: image.height,
                    }));
                }
                let images = self.engine.repeated();
                if images > 0 {
                    self.outputs.push_back(Output::Warning(Warning::Repeated { stamp: image.stamp, images }));
                }
            }
        }
    }

    /// Takes other settings; what is tracked stays tracked.
    pub fn set_config(&mut self, config: TrackerConfig) {
        self.engine.set_config(config);
    }

    /// What a picture of the last image's tracking shows.
    pub fn marks(&self) -> PerColor<Mark> {
        PerColor::from_fn(|c| self.engine.mark(c))
    }

    /// What was seen of a marker in `image`, the last one that was handed in; `None` as long as its colour is unknown.
    pub fn seen(&self, color: MarkerColor, image: &ImageView<'_>) -> Option<Seen> {
        self.engine.seen(color, image)
    }

    /// A marker's colour as it was learnt, r, g, b of 0–255; `None` as long as it is unknown.
    pub fn color(&self, color: MarkerColor) -> Option<[f32; 3]> {
        self.engine.markers[color].appearance.as_ref().map(|a| a.marker)
    }

    /// Per marker, what became of it in the last image.
    pub fn reasons(&self) -> [(MarkerColor, &'static str); 4] {
        MarkerColor::ALL.map(|c| (c, self.engine.reason(c)))
    }

    /// The next output, oldest first.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }
}
