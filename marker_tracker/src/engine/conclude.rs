//! The markers' states from what was measured, and eq. 3 for what was not.

use super::Engine;
use crate::{image::ImageView, signal::Sampler};
use nalgebra::{Isometry3, Matrix2, Vector2};
use rig_model::{CameraModel, MarkerColor, MarkerObservation, MarkerObservations, MarkerState, PerColor};

impl Engine {
    /// States of the markers from what was measured; eq. 3 for what was not.
    pub(super) fn conclude(
        &mut self,
        image: &ImageView<'_>,
        camera: Option<&CameraModel>,
        before: [Option<Vector2<f64>>; 4],
        pose_before: Option<Isometry3<f64>>,
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
            spread = (sum / n / 2.0).sqrt() + 0.05;
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
        let pose_now = self.pose;
        // The others' flow as a rigid motion carries the turn about them too, which their mean leaves out.
        let rigid = |color: MarkerColor| {
            let (camera, before, now) = (camera?, pose_before?, pose_now?);
            let a = self.layout.projected_centroid(color, camera, &before)?.pixel;
            Some(self.layout.projected_centroid(color, camera, &now)?.pixel - a)
        };
        let rigid = PerColor::from_fn(|c| {
            let wanted = self.markers[c].fit.is_none() && n >= 2.0 && self.config.rigid_prediction;
            if wanted { rigid(c) } else { None }
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
                m.sigma = 0.1;
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
            let (flow, spread) = match rigid[color] {
                _ if !self.config.use_flow => (Vector2::zeros(), 2.0),
                Some(flow) if (flow - mean).norm() < 4.0 * spread + 2.0 => {
                    (flow, if n >= 3.0 { 0.04 } else { 0.1 })
                }
                _ => (mean, spread),
            };
            m.flow = flow;
            let Some(since) = m.occluded else { return MarkerObservation::lost(MarkerObservation::NEVER) };
            let since = since.saturating_add(1).min(MarkerObservation::NEVER - 1);
            m.occluded = Some(since);
            match m.centroid {
                Some(c) if since <= max && self.pose.is_some() => {
                    let place = c + flow;
                    m.sigma += spread;
                    m.centroid = Some(place);
                    MarkerObservation {
                        state: MarkerState::Predicted,
                        occluded_frames: since,
                        centroid: place,
                        covariance: Matrix2::identity() * m.sigma * m.sigma,
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
