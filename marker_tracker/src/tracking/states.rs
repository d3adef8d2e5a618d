//! The markers' states: measured, predicted by the paper's eq. 3 or by the rigid motion of the
//! platform, or lost.

use crate::{
    config::TrackerConfig, debug_view::Outcome, geometry::isotropic, image::Pixels,
    outline::QuadFit, signal::Sampler, tracking::marker::MarkerTrack,
};
use nalgebra::{Matrix2, Vector2};
use rig_model::{MarkerColor, MarkerObservation, PerColor};

/// Standard deviation of a marker about the place that a pose gives it, px; tuned; guarded by
/// the bounds on predicted markers in `tests/bags`.
const POSE_SIGMA: f64 = 0.1;

/// Displacement of the visible markers since the last image, px.
pub(super) struct CommonFlow {
    /// Of the markers that were measured now and known in the last image.
    flows: PerColor<Option<Vector2<f64>>>,
    mean: Vector2<f64>,
    /// Standard deviation of a marker's flow about the mean, per axis, px.
    spread: f64,
}

impl CommonFlow {
    /// From the current measurements and the centroids `before`. Without any measurement the last
    /// flows continue; `ratio`: this image interval over the previous one.
    pub fn of(
        tracks: &PerColor<MarkerTrack>,
        before: &PerColor<Option<Vector2<f64>>>,
        ratio: f64,
    ) -> Self {
        let flows = PerColor::from_fn(|c| {
            tracks[c].fit.zip(before[c]).map(|(fit, before)| fit.centroid - before)
        });
        let measured = || flows.0.iter().flatten();
        let count = measured().count() as f64;
        let mean = if count > 0.0 {
            measured().sum::<Vector2<f64>>() / count
        } else {
            let last =
                || tracks.0.iter().filter(|m| m.centroid.is_some()).map(move |m| m.flow * ratio);
            last().sum::<Vector2<f64>>() / last().count().max(1) as f64
        };
        // One flow alone does not determine the rotation about it.
        let spread = if count > 1.0 {
            let square: f64 = measured().map(|f| (f - mean).norm_squared()).sum();
            (square / count / 2.0).sqrt() + 0.05
        } else {
            1.0 + mean.norm() * 0.5
        };
        Self { flows, mean, spread }
    }

    /// A marker's own flow, else the mean, px.
    pub fn of_marker(&self, color: MarkerColor) -> Vector2<f64> {
        self.flows[color].unwrap_or(self.mean)
    }
}

impl MarkerTrack {
    /// The observation of a measured marker; `flow`: its displacement since the last image, px.
    pub fn conclude_detected(
        &mut self,
        image: &Pixels<'_>,
        fit: &QuadFit,
        flow: Vector2<f64>,
    ) -> MarkerObservation {
        if let Some(appearance) = &self.appearance {
            self.features.extract(&Sampler::new(image, &appearance.discriminant), &fit.quad);
        }
        self.flow = flow;
        self.centroid = Some(fit.centroid);
        self.occluded = Some(0);
        self.sigma = POSE_SIGMA;
        MarkerObservation::detected(fit.centroid, fit.covariance, fit.area)
    }

    /// The observation of an unmeasured marker. `rigid`: its centroid (px) and covariance (px²) in
    /// the extrapolated pose.
    pub fn conclude_hidden(
        &mut self,
        rigid: Option<(Vector2<f64>, Matrix2<f64>)>,
        common: &CommonFlow,
        config: &TrackerConfig,
        has_pose: bool,
    ) -> MarkerObservation {
        self.features.clear();
        self.edges.hide();
        let rigid = rigid
            .zip(self.centroid)
            .map(|((place, covariance), centroid)| (place - centroid, covariance));
        let (flow, covariance) = match rigid {
            _ if !config.use_flow => (Vector2::zeros(), isotropic(self.sigma + 2.0)),
            Some((flow, covariance)) => (flow, covariance + isotropic(POSE_SIGMA)),
            None => (common.mean, isotropic(self.sigma + common.spread)),
        };
        self.flow = flow;
        self.predict(flow, covariance, if has_pose { config.max_predicted } else { 0 })
    }

    /// The observation in a repeated image, in which nothing is measured: the marker may have moved
    /// on as it did.
    pub fn repeat(&mut self, max_predicted: u16) -> MarkerObservation {
        self.fit = None;
        self.outcome = Outcome::RepeatedImage;
        let sigma = self.sigma + (1.0 + self.flow.norm());
        let observation = self.predict(Vector2::zeros(), isotropic(sigma), max_predicted);
        if self.occluded.is_some() && self.centroid.is_none() {
            self.flow = Vector2::zeros();
        }
        observation
    }

    /// Counts an image without a measurement, in which the centroid moves by `flow` (px); the
    /// marker is lost from the image `max_predicted` + 1 on.
    fn predict(
        &mut self,
        flow: Vector2<f64>,
        covariance: Matrix2<f64>,
        max_predicted: u16,
    ) -> MarkerObservation {
        let Some(before) = self.occluded else {
            return MarkerObservation::lost(MarkerObservation::NEVER);
        };
        let since = before.saturating_add(1).min(MarkerObservation::NEVER - 1);
        self.occluded = Some(since);
        self.centroid = self.centroid.filter(|_| since <= max_predicted).map(|c| c + flow);
        let Some(centroid) = self.centroid else { return MarkerObservation::lost(since) };
        self.sigma = (covariance.trace() / 2.0).sqrt();
        MarkerObservation::predicted(since, centroid, covariance)
    }
}
