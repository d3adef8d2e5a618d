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

ros_parameters::parameters! {
    /// Settings of the tracker; each row is a parameter of the node. The defaults suit any camera
    /// and light in which the markers' colors differ.
    #[derive(PartialEq)]
    pub struct TrackerConfig {
        /// Use the optical flow, the paper's first criterion.
        use_flow: bool = true, live;
        /// Use the hue histogram, the paper's second criterion.
        use_hue: bool = true, live;
        /// Number of consecutive images for which a hidden marker is predicted before it is lost.
        max_predicted: u16 = 6, range(0..=100), live;
        /// Move a hidden marker with the platform's rigid motion; false: with the others' mean flow
        /// (eq. 3), as method paper does.
        rigid_prediction: bool = true, live;
        /// Largest standard deviation of the centroid of a partly covered marker; a whole one is
        /// always measured (method outline).
        max_centroid_sigma: f64 = 0.5, unit("px"), range(0.01..=10.0), live;
        plain {
            /// Method; that of a running tracker does not change.
            method: Method = Method::default();
            /// Calibrated mean color of each marker's paper, r, g, b of 0–255 (`markers.colors` of
            /// the rig file); without one, the hue of the marker's name.
            start_colors: PerColor<Option<[f64; 3]>> = PerColor([None; 4]);
        }
    }
}
