//! The node's parameters, declared once.

use crate::TrackerConfig;

node_kit::parameters! {
    /// Parameters of the marker tracker.
    pub struct MarkerTrackerParameters {
        /// Which of the camera's image topics is read: image_raw or image_raw/compressed.
        image_transport: String = "raw", one_of(&["raw", "compressed"]);
        /// Use the optical flow, the paper's first criterion.
        use_flow: bool = true, live;
        /// Use the hue histogram, the paper's second criterion.
        use_hue: bool = true, live;
        /// Images in a row for which an occluded marker is predicted before it is lost.
        max_predicted: u16 = 6, range(0..=100), live;
        /// Move an occluded marker with the others' flow as a rigid motion; false takes their mean flow (eq. 3).
        rigid_prediction: bool = true, live;
        /// Largest standard deviation of a centroid that still counts as measured.
        max_centroid_sigma: f64 = 0.5, unit("px"), range(0.01..=10.0), live;
    }
}

impl MarkerTrackerParameters {
    /// As the core wants them.
    pub fn config(&self) -> TrackerConfig {
        TrackerConfig {
            use_flow: self.use_flow,
            use_hue: self.use_hue,
            max_predicted: self.max_predicted,
            rigid_prediction: self.rigid_prediction,
            max_centroid_sigma: self.max_centroid_sigma,
        }
    }
}
