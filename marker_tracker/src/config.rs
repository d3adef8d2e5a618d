//! Settings of the tracker.

use rig_model::PerColor;

/// How markers are found and followed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Method {
    /// Outlines of the squares, checked against the layout.
    #[default]
    Outline,
    /// The published tracker (paper, II-B to II-D), on OpenCV.
    #[cfg(feature = "opencv")]
    Paper(BinaryThreshold),
}

/// Threshold of the published tracker's binary images.
#[cfg(feature = "opencv")]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BinaryThreshold {
    /// Share of the range.
    pub share: f64,
    /// Whether the range is a layer's maximum, or 255 as printed.
    pub of_maximum: bool,
}

#[cfg(feature = "opencv")]
impl Default for BinaryThreshold {
    fn default() -> Self {
        Self { share: 0.75, of_maximum: true }
    }
}

/// Settings of the tracker. The defaults suit any camera and light in which the markers' colors
/// differ.
#[derive(Clone, Debug, PartialEq)]
pub struct TrackerConfig {
    /// Method; that of a running tracker does not change.
    pub method: Method,
    /// Whether the optical flow is used (the paper's first criterion).
    pub use_flow: bool,
    /// Whether the hue histogram is used (the paper's second criterion).
    pub use_hue: bool,
    /// Number of consecutive images for which a hidden marker is predicted before it is lost.
    pub max_predicted: u16,
    /// Whether a hidden marker moves with the platform's rigid motion, or with the mean flow of the
    /// others (paper, eq. 3).
    pub rigid_prediction: bool,
    /// Largest standard deviation of a measured centroid, px.
    pub max_centroid_sigma: f64,
    /// Calibrated mean color of each marker's paper, r, g, b of 0–255 (`markers.colors` of the rig
    /// file); without one, the hue of the marker's name.
    pub start_colors: PerColor<Option<[f64; 3]>>,
}

impl Default for TrackerConfig {
    fn default() -> Self {
        Self {
            method: Method::default(),
            use_flow: true,
            use_hue: true,
            max_predicted: 6,
            rigid_prediction: true,
            max_centroid_sigma: 0.5,
            start_colors: PerColor([None; 4]),
        }
    }
}
