//! Outline measurement from four edges, and the measured outline.

use crate::{
    edge::{EdgeFit, Interior, Light, MAX_ROWS, Rows, SHADE, ShapePrior, Side, fit_edge},
    outline::{
        beside,
        combine::{Estimate, combine},
    },
    quad::Quad,
    signal::Sampler,
};
use nalgebra::{Matrix2, Vector2};

/// Smallest area of an outline that is measured, px².
const MIN_AREA: f64 = 9.0;

/// Measures the outline near `predicted` (px).
///
/// Each edge is measured by the rows that cross it ([`fit_edge`]). The level inside is a plane over
/// the interior, the level outside a line along the edge that continues with the interior's
/// relative shading. Rows that something crosses are left out. An edge that is not visible is put
/// where the shape prior has it relative to the others; the covariance contains that.
///
/// `None` where fewer than two adjacent edges are visible or the contrast is lost.
pub(crate) fn fit(sampler: &Sampler<'_>, predicted: &Quad, prior: &ShapePrior) -> Option<QuadFit> {
    if !predicted.0.iter().all(|c| c.amax() < 1e6) {
        return None;
    }
    let (signed_area, center) = predicted.area_and_centroid();
    if signed_area.is_nan() || signed_area.abs() < MIN_AREA {
        return None;
    }
    let half_width =
        prior.tolerance.half_width.min(predicted.thickness_of(signed_area) * 0.25).max(1.0);
    let quick = prior.tolerance.rows < MAX_ROWS;
    let interior =
        Interior::measure(sampler, predicted, half_width, quick, prior.tolerance.gradient)?;
    let interior = match prior.light {
        Light::ByRow { .. } => interior.relit(),
        Light::Even | Light::ByPixel => interior,
    };
    let sides = Side::of(predicted, center);
    let mut edges: [Option<EdgeFit>; 4] = [None; 4];
    let mut scratch = Rows::new();
    for (edge, side) in edges.iter_mut().zip(&sides) {
        *edge = fit_edge(sampler, &interior, side, half_width, prior, &mut scratch);
    }
    if let Some(levels) = &prior.levels
        && !sampler.saturated
    {
        levels.mark_foreign(&mut edges, interior.level);
    }
    match prior.light {
        Light::Even => beside::widen(&mut edges),
        Light::ByPixel => beside::mark_moved(&mut edges, interior.level, half_width),
        Light::ByRow { .. } => {}
    }
    let (estimate, edges) = combine(&sides, edges, prior)?;
    let mut fit = finish(predicted, center, &sides, edges, &estimate, &interior, prior);
    let contrast = (fit.inside - fit.outside).abs().max(1e-3);
    // (A band is whole pixels, some 0.4 px more on either side.)
    let lever = (prior.tolerance.half_width + 0.4) * interior.sigma / contrast * prior.correlation;
    fit.covariance += Matrix2::identity()
        * (lever * lever * interior.reach * prior.inflation / prior.correlation);
    Some(fit)
}

/// Intersects the edges and propagates their covariance to the centroid.
fn finish(
    predicted: &Quad,
    center: Vector2<f64>,
    sides: &[Side; 4],
    edges: [Option<EdgeFit>; 4],
    estimate: &Estimate,
    interior: &Interior,
    prior: &ShapePrior,
) -> QuadFit {
    // Each edge as point and direction, then neighbours intersected.
    let line: [(Vector2<f64>, Vector2<f64>); 4] = std::array::from_fn(|i| {
        let Side { middle, tangent, normal, .. } = sides[i];
        (middle + normal * estimate.offsets[i], tangent + normal * estimate.slopes[i])
    });
    let mut quad = *predicted;
    for i in 0..4 {
        // Corner i + 1 is where edge i meets edge i + 1.
        let ((p, d), (q, e)) = (line[i], line[(i + 1) % 4]);
        let cross = d.perp(&e);
        if cross.abs() > 1e-6 {
            quad.0[(i + 1) % 4] = p + d * ((q - p).perp(&e) / cross);
        }
    }
    let (area, centroid) = quad.area_and_centroid();
    let a = area.abs().max(1.0);
    // ∂centroid/∂(offset, slope) of each edge: the strip's first moment about the centroid over the
    // area.
    let by: [Matrix2<f64>; 4] = std::array::from_fn(|i| {
        let Side { middle, tangent, length, .. } = sides[i];
        Matrix2::from_columns(&[
            (middle - center) * (length / a),
            tangent * (length.powi(3) / (12.0 * a)),
        ])
    });
    let (mut covariance, mut beside) = (Matrix2::zeros(), Matrix2::zeros());
    match &estimate.covariance {
        None => {
            for (b, e) in by.iter().zip(&edges) {
                if let Some(e) = e {
                    covariance += b * e.covariance * b.transpose();
                    beside += b.column(0) * e.beside * b.column(0).transpose();
                }
            }
        }
        Some(all) => {
            for i in 0..4 {
                for j in 0..4 {
                    let part = Matrix2::new(
                        all[(i, j)],
                        all[(i, 4 + j)],
                        all[(4 + i, j)],
                        all[(4 + i, 4 + j)],
                    );
                    covariance += by[i] * part * by[j].transpose();
                }
            }
        }
    }
    let miss = (0..4)
        .map(|i| estimate.offsets[i].abs() + estimate.slopes[i].abs() * sides[i].length / 2.0)
        .fold(0.0, f64::max);
    let seen = edges.iter().flatten().count() as f64;
    let outside = edges.iter().flatten().map(|e| e.outside).sum::<f64>() / seen.max(1.0);
    QuadFit {
        quad,
        centroid,
        covariance: (covariance + covariance.transpose()) * 0.5,
        beside,
        area: a,
        edges,
        gradient: interior.gradient,
        inside: interior.level,
        outside,
        filled: interior.filled,
        inflation: prior.inflation,
        miss,
        relit: prior.light != Light::Even,
    }
}

/// A measured outline.
#[derive(Clone, Copy, Debug)]
pub(crate) struct QuadFit {
    pub quad: Quad,
    /// Area centroid, px.
    pub centroid: Vector2<f64>,
    /// Of the centroid, px².
    pub covariance: Matrix2<f64>,
    /// Part of it that is due to what is beside the marker, where all edges were measured well.
    pub beside: Matrix2<f64>,
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
    ///
    /// What all four edges have in common is a border of the paper, not a shadow.
    pub fn is_shaded(&self) -> bool {
        let border = beside::border(&self.edges);
        self.edges.iter().flatten().any(|e| e.shade > border + SHADE)
    }

    /// Standard deviation of the centroid per axis, px.
    pub fn sigma(&self) -> f64 {
        (self.covariance.trace() / 2.0).sqrt()
    }
}
