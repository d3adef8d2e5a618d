//! The measured outline.

use crate::{
    edge::{EdgeFit, SHADE},
    quad::Quad,
};
use nalgebra::{Matrix2, Vector2};

/// A measured outline.
#[derive(Clone, Copy, Debug)]
pub(crate) struct QuadFit {
    pub quad: Quad,
    /// Area centroid, px.
    pub centroid: Vector2<f64>,
    /// Of the centroid, px².
    pub covariance: Matrix2<f64>,
    /// px².
    pub area: f64,
    /// Per edge; `None` where it was not measured.
    pub edges: [Option<EdgeFit>; 4],
    /// Gradient of the level inside, 1/px.
    pub gradient: Vector2<f64>,
    /// Signal level inside, at the square's middle.
    pub inside: f64,
    /// Mean signal level outside.
    pub outside: f64,
    /// Share of the interior's samples that have the marker's level.
    pub filled: f64,
    /// Factor on the edges' variance that the covariance contains.
    pub inflation: f64,
    /// Largest distance of the outline from where it was predicted, px.
    pub miss: f64,
    /// Whether the light was not taken to be even.
    pub relit: bool,
}

impl QuadFit {
    /// Bounds of the half-width of a band, px; above lies the search's.
    const HALF_WIDTH: (f64, f64) = (1.5, 4.4);

    /// Half-width across the edges that contains their blur, px: 2.5 times ∫ c·(1 − c) is 1.4 σ of
    /// a Gaussian blur or 0.4 of a motion blur's width, plus a pixel's size.
    pub fn half_width(&self) -> f64 {
        let widest = self.edges.iter().flatten().map(|e| e.blur).fold(0.0, f64::max);
        (0.8 + 2.5 * widest + (widest - 0.6).max(0.0)).clamp(Self::HALF_WIDTH.0, Self::HALF_WIDTH.1)
    }

    /// Whether all four edges were measured along most of their length. Tuned:
    /// whole markers are detected (`tests/bags`), cut ones are not.
    pub fn is_whole(&self) -> bool {
        let support = if self.relit { 0.5 } else { 0.7 };
        self.filled > 0.8
            && self.edges.iter().all(|e| e.is_some_and(|e| e.support > support && !e.foreign))
    }

    /// Whether the visible part determines the whole square's centroid with at most `max_sigma` px.
    pub fn determines_centroid(&self, max_sigma: f64) -> bool {
        self.edges.iter().flatten().count() >= 2
            && self.filled > 0.5
            && self.unevenness() < 0.3
            && self.covariance.trace() < 2.0 * max_sigma * max_sigma
    }

    /// Change of the interior's level over the square, in units of the contrast.
    fn unevenness(&self) -> f64 {
        self.gradient.norm() * self.area.sqrt() / (self.inside - self.outside).abs().max(1e-3)
    }

    /// Chooses between an outline measured with common levels and one with the levels of each row,
    /// after the light has changed. The first is more precise where all of the marker is in the
    /// same light; then both agree.
    pub fn in_changed_light(common: Option<Self>, relit: Option<Self>) -> Option<Self> {
        /// Share of the interior that has one level.
        const EVEN: f64 = 0.97;
        let common = common.filter(|f| f.filled > EVEN && !f.is_shaded());
        // A shadow along an edge leaves an edge of its own on all rows.
        let relit = relit.filter(|f| !f.is_shaded());
        match (common, relit) {
            (Some(common), Some(relit)) => {
                let off = (common.centroid - relit.centroid).norm();
                Some(if off < 0.05 + 3.0 * relit.sigma() { common } else { relit })
            }
            (common, relit) => relit.or(common),
        }
    }

    /// Whether the light changes within the band of an edge, which moves it.
    pub fn is_shaded(&self) -> bool {
        self.edges.iter().flatten().any(|e| e.shade > SHADE)
    }

    /// Standard deviation of the centroid per axis, px.
    pub fn sigma(&self) -> f64 {
        (self.covariance.trace() / 2.0).sqrt()
    }
}
