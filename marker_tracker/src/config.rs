//! What can be set.

use rig_model::PerColor;

/// Settings of the tracker. Every default works for any camera and light that the markers can be told in.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackerConfig {
    /// Whether the optical flow takes part (the paper's first criterion).
    pub use_flow: bool,
    /// Whether the hue histogram takes part (the paper's second criterion).
    pub use_hue: bool,
    /// Images in a row for which an occluded marker is predicted before it is lost.
    pub max_predicted: u16,
    /// Whether an occluded marker moves with the others' flow as a rigid motion (their turn included) or, as eq. 3 has it,
    /// with its mean.
    pub rigid_prediction: bool,
    /// Largest standard deviation of a centroid, px, that still counts as measured.
    pub max_centroid_sigma: f64,
    /// What each marker's paper looks like, mean r, g, b of 0–255, where it was calibrated (the rig file's `markers.colors`);
    /// else it is told by the hue that its name says.
    pub start_colors: PerColor<Option<[f64; 3]>>,
}

impl Default for TrackerConfig {
    fn default() -> Self {
        Self {
            use_flow: true,
            use_hue: true,
            max_predicted: 6,
            rigid_prediction: true,
            max_centroid_sigma: 0.5,
            start_colors: PerColor([None; 4]),
        }
    }
}
