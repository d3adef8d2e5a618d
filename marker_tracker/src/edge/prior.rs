//! What is known of an outline before it is measured.

use crate::edge::levels::Levels;
use nalgebra::Vector2;

/// How precisely an outline's edges are known before a measurement, and how they are measured.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Tolerance {
    /// Half-width of the band across the edges that is integrated, px.
    pub half_width: f64,
    /// Standard deviation of an edge's distance from the predicted shape, px.
    pub edge: f64,
    /// Standard deviation of the predicted place, px; decides which of two contradicting edges is
    /// right.
    pub place: f64,
    /// Standard deviation of an edge's direction, rad.
    pub slope: f64,
    /// Recent gradient of the signal inside, 1/px, where it is known.
    pub gradient: Option<Vector2<f64>>,
    /// Maximum number of rows of an edge that are used.
    pub rows: usize,
}

/// Knowledge of an outline beside its predicted place.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ShapePrior {
    pub tolerance: Tolerance,
    /// Distance of the marker's edges outside of the nominal square, px (paper cut too large,
    /// blooming): first and third edge, second and fourth edge.
    pub edge_bias: [f64; 2],
    /// Variance of a mean of neighboring pixels of a row over that of as many independent ones.
    pub correlation: f64,
    /// Factor on an edge's variance for what its rows do not show.
    pub inflation: f64,
    /// Recent levels inside and beside each edge.
    pub levels: Option<Levels>,
    /// How the light on the outline is treated.
    pub light: Light,
}

/// How the light on an outline is treated.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Light {
    /// One light on the whole marker: the most precise.
    #[default]
    Even,
    /// Each row is normalized to the levels at its own ends, and left out where the light changes
    /// along it: for covers, and shadows that leave enough rows.
    ByRow {
        /// Brightness of the surroundings over that of the marker.
        brightness: f32,
    },
    /// The signal is divided by the light on each pixel: for shadows whose edge lies along the
    /// marker's. A gray cover looks like the surroundings then.
    ByPixel,
}
