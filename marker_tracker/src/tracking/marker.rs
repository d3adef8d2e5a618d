//! The track of one marker.

use crate::{
    appearance::Appearance,
    debug_view::{MarkerView, Outcome, SignalView},
    edge::{Levels, Tolerance},
    flow::FlowFeatures,
    hue::HueHistogram,
    image::Pixels,
    outline::QuadFit,
    quad::Quad,
    signal::Sampler,
    tracking::meter::{KNOWN, MAX_HALF_WIDTH, ONE_PASS_ROWS, OutlineMeter, SEARCH},
};
use nalgebra::Vector2;
use rig_model::MarkerState;

/// Track of one marker from image to image.
#[derive(Clone, Debug, Default)]
pub(crate) struct MarkerTrack {
    pub appearance: Option<Appearance>,
    /// Measured or predicted centroid in the last image, px; `None` while lost.
    pub centroid: Option<Vector2<f64>>,
    /// Displacement over the last image interval, px.
    pub flow: Vector2<f64>,
    /// Standard deviation of the prediction, px.
    pub sigma: f64,
    /// Images since the last detection; `None` before the first.
    pub occluded: Option<u16>,
    /// Searched window: left, top, right, bottom (the last two excluded), px.
    pub window: [i32; 4],
    pub features: FlowFeatures,
    pub edges: EdgeHistory,
    /// Measurement in the current image.
    pub fit: Option<QuadFit>,
    pub outcome: Outcome,
}

impl MarkerTrack {
    /// Gain of the appearance per update: a time constant of 3 updates, 12 images.
    const APPEARANCE_GAIN: f32 = 0.3;

    /// Clears the measurement of the previous image.
    pub fn begin_image(&mut self) {
        self.fit = None;
        self.outcome = Outcome::NotFound;
    }

    /// The predicted outline, moved to where the optical flow finds it.
    pub fn moved_by_flow(&self, sampler: &Sampler<'_>, outline: &Quad) -> Quad {
        let Some(before) = self.centroid else { return *outline };
        let (_, place) = outline.area_and_centroid();
        let predicted = place - before;
        match self.features.displacement(sampler, predicted) {
            Some(flow) => outline.shifted(flow - predicted),
            None => *outline,
        }
    }

    /// Whether the inside of an outline has the marker's hues.
    pub fn has_hue(&self, image: &Pixels<'_>, outline: &Quad) -> bool {
        let Some(appearance) = &self.appearance else { return false };
        HueHistogram::of(image, outline).is_some_and(|h| h.is_like(&appearance.hue))
    }

    /// Adapts the levels, and where it `is_due` the colors, to a whole outline.
    pub fn adapt(&mut self, image: &Pixels<'_>, fit: &QuadFit, is_due: bool) {
        if is_due && let Some(appearance) = &mut self.appearance {
            appearance.adapt(image, &fit.quad, Self::APPEARANCE_GAIN);
        }
        self.edges.adapt(fit);
    }

    /// The state of the track.
    pub fn view(&self) -> MarkerView {
        MarkerView {
            window: self.window,
            outline: self.fit.map(|f| f.quad.0),
            centroid: self.centroid.unwrap_or(Vector2::repeat(f64::NAN)),
            flow: self.flow,
            state: match (self.fit, self.centroid) {
                (Some(_), _) => MarkerState::Detected,
                (None, Some(_)) => MarkerState::Predicted,
                (None, None) => MarkerState::Lost,
            },
            outcome: self.outcome,
            color: self.appearance.map(|a| a.marker),
        }
    }

    /// The color signal of the window in `image`.
    pub fn signal(&self, image: &Pixels<'_>) -> Option<SignalView> {
        let appearance = self.appearance.as_ref()?;
        let [x0, y0, x1, y1] = self.window;
        let width = usize::try_from(x1 - x0).ok()?;
        // The projection of the surroundings is not 0; the view's is.
        let offset = appearance.discriminant.project(appearance.surroundings);
        let sampler = Sampler::new(image, &appearance.discriminant);
        let signal = (y0..y1)
            .flat_map(|y| (x0..x1).map(move |x| (x, y)))
            .map(|(x, y)| sampler.at(x, y).map_or(f32::NAN, |v| v - offset))
            .collect();
        let hue = appearance.hue.bins.to_vec();
        Some(SignalView { origin: [x0, y0], width, signal, hue })
    }
}

/// What the last images say about a marker's edges: how wide their blur is and how far they lie off
/// the prediction.
#[derive(Clone, Debug, Default)]
pub(crate) struct EdgeHistory {
    /// Half-width across an edge that its blur needs, px; `None` until measured.
    half_width: Option<f64>,
    /// Recent largest distance of the edges from their predicted places, px.
    miss: f64,
    /// Signal gradient inside, 1/px.
    gradient: Option<Vector2<f64>>,
    /// Signal levels inside and beside each edge.
    pub levels: Option<Levels>,
}

impl EdgeHistory {
    /// Standard deviation of a centroid up to which one pass suffices, px. With more noise or
    /// compression, a second pass about the measured place improves the centroid by a quarter.
    const ONE_PASS_SIGMA: f64 = 0.025;
    /// Miss that is assumed after an acquisition, px: the accuracy of a patch's centroid.
    const ACQUISITION_MISS: f64 = 0.4;
    /// Gain of the levels: a time constant of 5 images.
    const LEVEL_GAIN: f64 = 0.2;
    /// Share of the recent miss that remains from image to image, and its bounds, px.
    const MISS_DECAY: f64 = 0.85;
    const MISS_BOUNDS: (f64, f64) = (0.1, 1.5);

    /// Restarts after an acquisition that measured this half-width, px.
    pub fn restart(&mut self, half_width: Option<f64>) {
        self.half_width = half_width;
        self.miss = Self::ACQUISITION_MISS;
    }

    /// Forgets blur and gradient, which change while a marker is hidden.
    pub fn hide(&mut self) {
        (self.half_width, self.gradient) = (None, None);
    }

    /// Measures a whole outline near `predicted`.
    ///
    /// One narrow pass suffices where the last images determined blur and prediction error and the
    /// outline lies within them; otherwise a wide pass comes first.
    pub fn follow(
        &mut self,
        meter: &OutlineMeter,
        sampler: &Sampler<'_>,
        predicted: &Quad,
    ) -> Option<QuadFit> {
        let one_pass = self.half_width.and_then(|half_width| {
            let half_width = (half_width + (1.3 * self.miss - 0.3).max(0.0)).min(MAX_HALF_WIDTH);
            let rows = if self.gradient.is_some() { ONE_PASS_ROWS } else { KNOWN.rows };
            let tolerance = Tolerance { half_width, gradient: self.gradient, rows, ..KNOWN };
            let fit = meter.measure(sampler, predicted, tolerance).filter(QuadFit::is_whole)?;
            // Things beside the marker need the wide pass, too.
            let certain = fit.covariance.trace() < 2.0 * Self::ONE_PASS_SIGMA.powi(2);
            let within = fit.half_width() + fit.miss - Self::ACQUISITION_MISS <= half_width;
            (certain && within).then_some(fit)
        });
        let fit = one_pass.or_else(|| meter.whole(sampler, predicted, SEARCH));
        match &fit {
            Some(fit) => {
                self.half_width = Some(fit.half_width());
                self.gradient = Some(fit.gradient);
                let (low, high) = Self::MISS_BOUNDS;
                self.miss = fit.miss.max(Self::MISS_DECAY * self.miss).clamp(low, high);
            }
            None => self.hide(),
        }
        fit
    }

    /// Whether an outline lies in another light than the last ones, or in two lights: a shadow has
    /// come, and its edge may be near.
    pub fn has_changed_light(&self, fit: &QuadFit) -> bool {
        /// Largest relative change of the level inside from image to image without a shadow. Tuned;
        /// guarded by `tests/synthetic` and `tests/bags`.
        const CHANGE: f64 = 0.12;
        /// Least share of the interior that has one level, and of an edge's rows that agree.
        const EVEN: f64 = 0.95;
        const SUPPORT: f64 = 0.9;
        let changed = self.levels.is_none_or(|l| (l.light(fit.inside) - 1.0).abs() > CHANGE);
        changed
            || fit.is_shaded()
            || fit.filled < EVEN
            || fit.edges.iter().flatten().any(|e| e.support < SUPPORT)
    }

    fn adapt(&mut self, fit: &QuadFit) {
        let Some(now) = Levels::of(fit.inside, &fit.edges) else { return };
        match &mut self.levels {
            Some(levels) => levels.adapt(&now, Self::LEVEL_GAIN),
            None => self.levels = Some(now),
        }
    }
}
