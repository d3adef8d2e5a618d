//! The tracker's interface: images and camera models in, observations and warnings out.

use crate::{
    config::TrackerConfig,
    debug_view::{MarkerView, SignalView, why_not_found},
    decode::PartialImage,
    engine::Engine,
    image::{ImageError, ImageView, Pixels, Window},
};
use rig_model::{CameraModel, MarkerColor, MarkerLayout, MarkerObservations, PerColor, Stamp};
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
        "camera_info is for {}x{}, but images are {}x{}; no marker is detected in them: set the \
         camera to the calibrated size or calibrate at this one",
        .camera.0, .camera.1, .image.0, .image.1
    )]
    CameraSize {
        /// Width and height of the camera model, px.
        camera: (u32, u32),
        /// Of the image, px.
        image: (usize, usize),
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
        Self::with(config.method.engine(layout, config))
    }

    fn with(engine: Box<dyn Engine>) -> Self {
        let outputs = VecDeque::with_capacity(8);
        Self { engine, last_stamp: None, reported_size: None, outputs }
    }

    /// Processes the next input; its outputs wait in [`Tracker::poll`].
    pub fn handle(&mut self, input: Input<'_>) {
        match input {
            Input::Camera(camera) => {
                self.reported_size = None;
                self.engine.set_camera(camera);
            }
            Input::Image(image) => {
                self.process(&Pixels::whole(image, None));
            }
        }
    }

    /// Processes a compressed image as [`Input::Image`] of it, and decodes what is missing of it.
    pub fn handle_partial(&mut self, image: &mut PartialImage<'_>) {
        if self.process(&image.pixels()) {
            return;
        }
        match image.whole() {
            Ok(_) => {
                self.process(&image.pixels());
            }
            Err(error) => self.warn(Warning::Image(error)),
        }
    }

    /// Where an image of this stamp will probably be read, px; `None` where all of it is needed.
    pub(crate) fn windows(&self, stamp: Stamp) -> Option<[Window; 4]> {
        self.engine.windows(stamp)
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

    /// Processes an image; false, without any effect, where more of it is needed than is decoded.
    fn process(&mut self, image: &Pixels<'_>) -> bool {
        let failed = |reason| Warning::Library { stamp: image.stamp, reason };
        let checked = self.check(image);
        let observations = match checked.and_then(|()| self.engine.process(image).map_err(failed)) {
            Ok(Some(observations)) => observations,
            Ok(None) => return false,
            Err(warning) => {
                self.warn(warning);
                return true;
            }
        };
        self.last_stamp = Some(image.stamp);
        self.outputs.push_back(Output::Observations(observations));
        let size = (image.width, image.height);
        if let Some(camera) = self.engine.mismatched_camera_size(image)
            && self.reported_size.replace(size) != Some(size)
        {
            self.warn(Warning::CameraSize { camera, image: size });
        }
        let images = self.engine.repeated();
        if images > 0 {
            self.warn(Warning::Repeated { stamp: image.stamp, images });
        }
        true
    }

    fn warn(&mut self, warning: Warning) {
        self.outputs.push_back(Output::Warning(warning));
    }

    /// Replaces the settings, except for the method; all tracks are kept.
    pub fn set_config(&mut self, config: TrackerConfig) {
        self.engine.set_config(config);
    }

    /// Whether the method uses the camera's intrinsic parameters.
    pub fn uses_camera(&self) -> bool {
        self.engine.uses_camera()
    }

    /// The tracks after the last image.
    pub fn views(&self) -> PerColor<MarkerView> {
        PerColor::from_fn(|c| self.engine.view(c))
    }

    /// Why the markers were not found in the last image, with a remedy; `None` where they were.
    pub fn why_not_found(&self) -> Option<String> {
        why_not_found(&PerColor(self.views().0.map(|view| view.outcome)))
    }

    /// The color signal of a marker's window in `image`, which must be the last one processed;
    /// `None` until the marker's color is known.
    pub fn signal(&self, color: MarkerColor, image: &ImageView<'_>) -> Option<SignalView> {
        self.engine.signal(color, &Pixels::whole(*image, None))
    }

    /// The next output, oldest first.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::fixtures::drawn;

    /// A method whose image library always fails.
    #[derive(Debug)]
    struct Failing;

    impl Engine for Failing {
        fn process(&mut self, _: &Pixels<'_>) -> Result<Option<MarkerObservations>, String> {
            Err("no memory".to_owned())
        }

        fn set_config(&mut self, _: TrackerConfig) {}

        fn view(&self, _: MarkerColor) -> MarkerView {
            unreachable!("nothing shows it")
        }
    }

    #[test]
    fn an_image_at_which_the_library_fails_is_reported_and_ignored() {
        let mut tracker = Tracker::with(Box::new(Failing));
        let (stamp, image) = (Stamp::default(), drawn(1, 1, 0, &[]));
        tracker.handle(Input::Image(image.view(stamp)));
        let warning = Warning::Library { stamp, reason: "no memory".to_owned() };
        assert_eq!(tracker.poll(), Some(Output::Warning(warning)));
        assert_eq!(tracker.poll(), None);
    }
}
