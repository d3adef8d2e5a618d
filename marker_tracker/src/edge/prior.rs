//! What is known of an outline before it is measured.

use crate::edge::levels::Levels;
use nalgebra::Vector2;

/// Knowledge of an outline beside its predicted place.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ShapePrior {
    /// Distance of the marker's edges outside of the nominal square, px (paper cut too large,
    /// blooming): first and third edge, second and fourth edge.
    pub edge_bias: [f64; 2],
    /// Standard deviation of one edge's distance from the predicted shape, px.
    pub edge_sigma: f64,
    /// Standard deviation of the predicted place, px; decides which of two contradicting edges is
    /// right.
    pub place_sigma: f64,
    /// Standard deviation of one edge's direction, rad.
    pub slope_sigma: f64,
    /// Variance of a mean of neighboring pixels of a row over that of as many independent ones.
    pub correlation: f64,
    /// Factor on an edge's variance for what its rows do not show.
    pub inflation: f64,
    /// Half-width of the band across the edge that is integrated, px.
    pub half_width: f64,
    /// Maximum number of rows of an edge that are used.
    pub rows: usize,
    /// Recent gradient of the level inside, 1/px.
    pub gradient: Option<Vector2<f64>>,
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
