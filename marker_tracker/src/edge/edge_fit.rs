//! The result of an edge measurement.

use nalgebra::Matrix2;

/// Number of lags at which the residuals of rows are correlated, lag 0 included.
pub(crate) const LAGS: usize = 2;

/// A measured edge of a square.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgeFit {
    /// Displacement of the edge's middle along its outward normal, px.
    pub offset: f64,
    /// Change of the displacement per pixel along the edge.
    pub slope: f64,
    /// Covariance of (offset, slope); px², px, 1.
    pub covariance: Matrix2<f64>,
    /// Share of the edge's usable rows that agree with the line.
    pub support: f64,
    /// Level outside, at the edge's middle.
    pub outside: f64,
    /// Whether the level outside has changed: something lies beside the marker, over its edge or
    /// just short of it, and this may be that thing's edge.
    pub foreign: bool,
    /// ∫ c·(1 − c) across the edge, px, for the share c of the marker: a sixth of the width of a
    /// motion blur, 0.56 σ of a Gaussian one.
    pub blur: f64,
    /// Root mean square, over the rows, of the light that the band has in excess of that inside and
    /// beyond it, px of the light inside: 0 unless the light changes within the band.
    pub shade: f64,
    /// Σ rᵢ² and Σ rᵢ·rᵢ₊₁ of the rows' residuals, px².
    pub lag: [f64; LAGS],
}
