//! Outline measurement of one marker with what is known of its shape, levels and noise.

use crate::{
    edge::{Light, MAX_ROWS, ShapePrior, Tolerance},
    outline::{QuadFit, fit},
    quad::Quad,
    signal::Sampler,
    tracking::{marker::EdgeHistory, noise::NoiseModel, platform::MarkerGeometry},
};

/// Half-width of the band across an edge while it is searched, px: tuned; guarded by
/// the fast_swing bag of `tests/bags`.
pub(super) const SEARCH_HALF_WIDTH: f64 = 4.5;
/// Widest band of a measurement after the search, px.
pub(super) const MAX_HALF_WIDTH: f64 = SEARCH_HALF_WIDTH - 0.1;
/// Rows of an edge that are read during the search and in a one-pass measurement. Tuned: `make
/// bench` bounds the time, `tests/synthetic` the accuracy.
const SEARCH_ROWS: usize = 16;
pub(super) const ONE_PASS_ROWS: usize = 32;

/// While an outline is searched.
pub(super) const SEARCH: Tolerance = Tolerance {
    half_width: SEARCH_HALF_WIDTH,
    edge: 1.0,
    place: 3.0,
    slope: 0.06,
    gradient: None,
    rows: SEARCH_ROWS,
};

/// Once an outline is known to a fraction of a pixel.
pub(super) const KNOWN: Tolerance = Tolerance {
    half_width: 2.0,
    edge: 0.5,
    place: 3.0,
    slope: 0.03,
    gradient: None,
    rows: MAX_ROWS,
};

/// Measures the outline of one marker in one image.
#[derive(Clone, Copy, Debug)]
pub(super) struct OutlineMeter {
    prior: ShapePrior,
}

impl Default for OutlineMeter {
    /// For a marker of which nothing is known.
    fn default() -> Self {
        Self::new(&MarkerGeometry::default(), &EdgeHistory::default(), &NoiseModel::default())
    }
}

impl OutlineMeter {
    /// Collects what is known of a marker.
    pub fn new(geometry: &MarkerGeometry, edges: &EdgeHistory, noise: &NoiseModel) -> Self {
        Self {
            prior: ShapePrior {
                edge_bias: geometry.edge_bias,
                correlation: noise.correlation(),
                inflation: noise.inflation(),
                // Until the shape is known all edges are needed, whatever is beside them.
                levels: edges.levels.filter(|_| geometry.is_shape_known()),
                ..ShapePrior::default()
            },
        }
    }

    /// Measures the outline near `predicted` (px).
    pub fn measure(
        &self,
        sampler: &Sampler<'_>,
        predicted: &Quad,
        tolerance: Tolerance,
    ) -> Option<QuadFit> {
        let prior = ShapePrior { tolerance, ..self.prior };
        match prior.light {
            Light::ByPixel => fit(&sampler.in_any_light()?, predicted, &prior),
            Light::Even | Light::ByRow { .. } => fit(sampler, predicted, &prior),
        }
    }

    /// The same measurement with the light treated as `light`.
    pub fn in_light(&self, light: Light) -> Self {
        // A row's own levels are not those of other images.
        let levels = self.prior.levels.filter(|_| !matches!(light, Light::ByRow { .. }));
        Self { prior: ShapePrior { light, levels, ..self.prior } }
    }

    /// The same measurement where nothing is known of what is beside the edges.
    pub fn without_levels(&self) -> Self {
        Self { prior: ShapePrior { levels: None, ..self.prior } }
    }

    /// Measures a whole outline in two passes: with the tolerance `first`, then about the outline
    /// that was found, with the half-width that its blur needs.
    pub fn whole(
        &self,
        sampler: &Sampler<'_>,
        predicted: &Quad,
        first: Tolerance,
    ) -> Option<QuadFit> {
        let first = self.measure(sampler, predicted, first).filter(QuadFit::is_whole)?;
        let tolerance = Tolerance { half_width: first.half_width(), ..KNOWN };
        let mut second = self.measure(sampler, &first.quad, tolerance).filter(QuadFit::is_whole)?;
        // The distance from where it was predicted, not from the first pass.
        second.miss += first.miss;
        Some(second)
    }
}
