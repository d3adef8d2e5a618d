//! The markers' states from what was measured, and eq. 3 for what was not.

use super::Engine;
use crate::{geometry::foretell, image::ImageView, signal::Sampler};
use nalgebra::{Matrix2, Vector2};
use rig_model::{CameraModel, MarkerObservation, MarkerObservations, MarkerState, PerColor};

/// Standard deviation, px, of a marker about the place that a pose gives it.
const SEEN_SIGMA: f64 = 0.1;

fn widened(sigma: f64) -> Matrix2<f64> {
    Matrix2::identity() * (sigma * sigma)
}

impl Engine {
    /// States of the markers from what was measured; eq. 3 for what was not.
    pub(super) fn conclude(
        &mut self,
        image: &ImageView<'_>,
        camera: Option<&CameraModel>,
        before: [Option<Vector2<f64>>; 4],
        ratio: f64,
    ) -> MarkerObservations {
        // Flows of the visible markers that were known in the previous image as well.
        let (mut mean, mut n) = (Vector2::zeros(), 0.0);
        let mut flows = [None; 4];
        for i in 0..4 {
            if let (Some(f), Some(b)) = (self.markers.0[i].fit, before[i]) {
                let flow = f.centroid - b;
                flows[i] = Some(flow);
                mean += flow;
                n += 1.0;
            }
        }
        let mut spread = 1.0;
        if n > 0.0 {
            mean /= n;
            let sum: f64 = flows.iter().flatten().map(|f| (f - mean).norm_squared()).sum();
            // One alone does not tell how the others turn about it.
            spread = if n > 1.0 { (sum / n / 2.0).sqrt() + 0.05 } else { 1.0 + mean.norm() * 0.5 };
        } else {
            // Nobody is seen: on as before.
            let (mut sum, mut known) = (Vector2::zeros(), 0.0);
            for m in self.markers.0.iter().filter(|m| m.centroid.is_some()) {
                sum += m.flow * ratio;
                known += 1.0;
            }
            if known > 0.0 {
                mean = sum / known;
                spread = 1.0 + mean.norm() * 0.5;
            }
        }
        let max = self.config.max_predicted;
        // The others' flow as a rigid motion carries the turn about them too, which their mean leaves out; where none or one is
        // seen the platform's motion goes on for a while.
        let carried = self.carry(camera, ratio).filter(|_| self.config.rigid_prediction);
        let rigid = PerColor::from_fn(|color| {
            let (pose, covariance) = carried.as_ref()?;
            foretell(&self.layout, color, camera?, pose, covariance)
        });
        let markers = PerColor::from_fn(|color| {
            let m = &mut self.markers[color];
            if let Some(f) = m.fit {
                if let Some(appearance) = &m.appearance {
                    m.outline.remember(&Sampler::new(image, &appearance.discriminant), &f.quad);
                }
                m.flow = flows[color.index()].unwrap_or(mean);
                m.centroid = Some(f.centroid);
                m.occluded = Some(0);
                m.sigma = SEEN_SIGMA;
                return MarkerObservation {
                    state: MarkerState::Detected,
                    occluded_frames: 0,
                    centroid: f.centroid,
                    covariance: f.covariance,
                    area: f.area as f32,
                };
            }
            m.outline.clear();
            (m.blur, m.gradient) = (0.0, None);
            let rigid = rigid[color].zip(m.centroid).map(|((place, covariance), c)| (place - c, covariance));
            let (flow, covariance) = match rigid {
                _ if !self.config.use_flow => (Vector2::zeros(), widened(m.sigma + 2.0)),
                Some((flow, covariance)) if n < 2.0 || (flow - mean).norm() < 4.0 * spread + 2.0 => {
                    (flow, covariance + widened(SEEN_SIGMA))
                }
                _ => (mean, widened(m.sigma + spread)),
            };
            m.flow = flow;
            let Some(since) = m.occluded else { return MarkerObservation::lost(MarkerObservation::NEVER) };
            let since = since.saturating_add(1).min(MarkerObservation::NEVER - 1);
            m.occluded = Some(since);
            match m.centroid {
                Some(c) if since <= max && self.pose.is_some() => {
                    let place = c + flow;
                    m.sigma = (covariance.trace() / 2.0).sqrt();
                    m.centroid = Some(place);
                    MarkerObservation {
                        state: MarkerState::Predicted,
                        occluded_frames: since,
                        centroid: place,
                        covariance,
                        area: 0.0,
                    }
                }
                _ => {
                    m.centroid = None;
                    MarkerObservation::lost(since)
                }
            }
        });
        MarkerObservations { stamp: image.stamp, markers }
    }
}
