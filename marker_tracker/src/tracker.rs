//! The tracker's interface: images and camera models in, observations and warnings out.

use crate::{
    config::TrackerConfig,
    debug_view::{MarkerView, SignalView},
    decode::PartialImage,
    engine::Engine,
    image::{ImageError, ImageView, Pixels, Window},
    tracking::Outcome,
};
use rig_model::{
    CameraModel, MarkerColor, MarkerLayout, MarkerObservation, MarkerObservations, PerColor, Stamp,
};
use std::collections::VecDeque;
use thiserror::Error;

/// Input of the tracker, in the order of arrival.
#[derive(Clone, Debug)]
pub enum Input<'a> {
    /// Intrinsic parameters of the camera. Without them the geometry is checked coarsely.
    Camera(CameraModel),
    /// An image.
    Image(ImageView<'a>),
}

/// Output of the tracker.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// The markers of one image; one per accepted image.
    Observations(MarkerObservations),
    /// Something that an operator should know.
    Warning(Warning),
}

/// A stamp that is older than the previous one by this time is no late image: the camera's clock
/// was set back, or a bag is played in a loop; s.
const JUMP_BACK: f64 = 1.0;

/// A rejected image, or one that needs attention.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Warning {
    /// The image cannot be read.
    #[error("{0}")]
    Image(ImageError),
    /// The image is not newer than the previous one (and not so much older that time was set back).
    #[error(
        "image stamped {stamp} is not newer than the previous one ({previous}); it is ignored, \
         check the camera driver's stamps"
    )]
    StampFromThePast {
        /// Stamp of the image.
        stamp: Stamp,
        /// Stamp of the last accepted image.
        previous: Stamp,
    },
    /// The camera model is for another image size.
    #[error(
        "camera_info is for {camera_width}x{camera_height}, but images are {width}x{height}; no \
         marker is detected in them: set the camera to the calibrated size or calibrate at this one"
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
    /// The image is a copy of the previous one with another stamp.
    #[error(
        "image stamped {stamp} is byte for byte the previous one ({images} in a row); it is no \
         measurement, check whether the camera or its driver hangs"
    )]
    Repeated {
        /// Stamp of the image.
        stamp: Stamp,
        /// Number of consecutive copies.
        images: u32,
    },
    /// The image library failed.
    #[error(
        "image stamped {stamp} is ignored, because OpenCV failed: {reason}; report this with the \
         image"
    )]
    Library {
        /// Stamp of the image.
        stamp: Stamp,
        /// The library's reason.
        reason: String,
    },
}

impl Warning {
    /// Name of the kind, for counting and throttling.
    pub fn kind(&self) -> &'static str {
        match self {
            Warning::Image(_) => "image",
            Warning::StampFromThePast { .. } => "stamp",
            Warning::CameraSize { .. } => "camera size",
            Warning::Repeated { .. } => "repeated image",
            Warning::Library { .. } => "image library",
        }
    }
}

/// Detects and tracks the four markers.
#[derive(Debug)]
pub struct Tracker {
    engine: Box<dyn Engine>,
    last_stamp: Option<Stamp>,
    /// Image size (width, height; px) whose mismatch with the camera model has been reported.
    reported_size: Option<(usize, usize)>,
    outputs: VecDeque<Output>,
}

impl Tracker {
    /// Creates a tracker for markers at these places of the platform (volant frame, m).
    pub fn new(layout: MarkerLayout, config: TrackerConfig) -> Self {
        Self {
            engine: config.method.engine(layout, config),
            last_stamp: None,
            reported_size: None,
            outputs: VecDeque::with_capacity(8),
        }
    }

    /// Processes the next input; its outputs wait in [`Tracker::poll`].
    pub fn handle(&mut self, input: Input<'_>) {
        match input {
            Input::Camera(camera) => {
                self.reported_size = None;
                self.engine.set_camera(camera);
            }
            Input::Image(image) => match self.check(&image) {
                Ok(()) => self.process(&Pixels::whole(image, None)),
                Err(warning) => self.outputs.push_back(Output::Warning(warning)),
            },
        }
    }

    /// Processes a compressed image as [`Input::Image`] of it, and decodes what is missing of it.
    pub fn handle_partial(&mut self, image: &mut PartialImage<'_>) {
        match self.check(&image.view()) {
            Ok(()) => self.process_partial(image),
            Err(warning) => self.outputs.push_back(Output::Warning(warning)),
        }
    }

    /// Where an image of this stamp will probably be read, px; `None` where all of it is needed.
    pub(crate) fn windows(&self, stamp: Stamp) -> Option<[Window; 4]> {
        self.engine.windows(stamp)
    }

    fn process_partial(&mut self, image: &mut PartialImage<'_>) {
        let observations =
            image.windows().and_then(|windows| self.engine.process_windows(&windows));
        match observations {
            Some(observations) => self.finish(&image.view(), observations),
            None => match image.whole() {
                Ok(_) => self.process(&image.pixels()),
                Err(error) => {
                    return self.outputs.push_back(Output::Warning(Warning::Image(error)));
                }
            },
        }
        image.keep();
    }

    /// Rejects images with contradicting fields or an old stamp.
    fn check(&self, image: &ImageView<'_>) -> Result<(), Warning> {
        image.check().map_err(Warning::Image)?;
        let late = |last: &Stamp| (0.0..JUMP_BACK).contains(&last.seconds_since(image.stamp));
        match self.last_stamp.filter(late) {
            Some(previous) => Err(Warning::StampFromThePast { stamp: image.stamp, previous }),
            None => Ok(()),
        }
    }

    fn process(&mut self, image: &Pixels<'_>) {
        let observations = self.engine.process(image).unwrap_or_else(|reason| {
            let warning = Warning::Library { stamp: image.stamp, reason };
            self.outputs.push_back(Output::Warning(warning));
            let markers = PerColor([MarkerObservation::lost(MarkerObservation::NEVER); 4]);
            MarkerObservations { stamp: image.stamp, markers }
        });
        self.finish(image, observations);
    }

    fn finish(&mut self, image: &ImageView<'_>, observations: MarkerObservations) {
        self.last_stamp = Some(image.stamp);
        self.outputs.push_back(Output::Observations(observations));
        let (width, height) = (image.width, image.height);
        if let Some((camera_width, camera_height)) = self.engine.mismatched_camera_size(image)
            && self.reported_size != Some((width, height))
        {
            self.reported_size = Some((width, height));
            let warning = Warning::CameraSize { camera_width, camera_height, width, height };
            self.outputs.push_back(Output::Warning(warning));
        }
        let images = self.engine.repeated();
        if images > 0 {
            let warning = Warning::Repeated { stamp: image.stamp, images };
            self.outputs.push_back(Output::Warning(warning));
        }
    }

    /// Replaces the settings, except for the method; all tracks are kept.
    pub fn set_config(&mut self, config: TrackerConfig) {
        self.engine.set_config(config);
    }

    /// What a debug image of the last image shows, marker by marker.
    pub fn views(&self) -> PerColor<MarkerView> {
        PerColor::from_fn(|c| self.engine.view(c))
    }

    /// The color signal of a marker's window in `image`, which must be the last one processed;
    /// `None` until the marker's color is known.
    pub fn signal(&self, color: MarkerColor, image: &ImageView<'_>) -> Option<SignalView> {
        self.engine.signal(color, &Pixels::whole(*image, None))
    }

    /// A marker's adapted color, r, g, b of 0–255; `None` until it is known.
    pub fn color(&self, color: MarkerColor) -> Option<[f32; 3]> {
        self.engine.color(color)
    }

    /// Outcome of the search for each marker in the last image.
    pub fn outcomes(&self) -> PerColor<Outcome> {
        PerColor::from_fn(|c| self.engine.outcome(c))
    }

    /// The next output, oldest first.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }
}
