//! A tracking method behind [`Tracker`](crate::Tracker).

use crate::{
    config::{Method, TrackerConfig},
    debug_view::{MarkerView, SignalView},
    image::{ImageView, Pixels, Window},
    tracking::Pipeline,
};
use rig_model::{CameraModel, MarkerColor, MarkerLayout, MarkerObservations, Stamp};
use std::fmt::Debug;

/// A tracking method. What a method does not have is its default.
pub(crate) trait Engine: Debug + Send + Sync {
    /// Processes one image, whose fields must have passed [`ImageView::check`]. `None`, without any
    /// effect, where more of it is needed than the [`windows`](Self::windows) that are decoded.
    ///
    /// # Errors
    /// The reason why the image library failed.
    fn process(&mut self, image: &Pixels<'_>) -> Result<Option<MarkerObservations>, String>;

    /// Where an image of this stamp will be read, px; `None` where all of it is needed.
    fn windows(&self, _stamp: Stamp) -> Option<[Window; 4]> {
        None
    }

    /// Replaces the settings, except for the method, and keeps all tracks.
    fn set_config(&mut self, config: TrackerConfig);

    /// Whether the method uses the camera's intrinsic parameters.
    fn uses_camera(&self) -> bool {
        false
    }

    /// Sets the camera's intrinsic parameters.
    fn set_camera(&mut self, _camera: CameraModel) {}

    /// Size (width, height; px) of the camera model where the image has another one.
    fn mismatched_camera_size(&self, _image: &ImageView<'_>) -> Option<(u32, u32)> {
        None
    }

    /// Number of consecutive images that were identical to their predecessor.
    fn repeated(&self) -> u32 {
        0
    }

    /// The track of a marker.
    fn view(&self, color: MarkerColor) -> MarkerView;

    /// The color signal of a marker's window in the image processed last.
    fn signal(&self, _color: MarkerColor, _image: &Pixels<'_>) -> Option<SignalView> {
        None
    }
}

impl Method {
    /// Creates the tracker of this method.
    pub(crate) fn engine(self, layout: MarkerLayout, config: TrackerConfig) -> Box<dyn Engine> {
        match self {
            Self::Outline => Box::new(Pipeline::new(layout, config)),
            #[cfg(feature = "opencv")]
            Self::Paper(threshold) => Box::new(crate::opencv::PaperTracker::new(config, threshold)),
        }
    }
}
