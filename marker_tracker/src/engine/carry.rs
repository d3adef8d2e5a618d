//! Where a hidden marker is: the platform goes on as it went, and what is still seen of it says where that is wrong.

use super::{Engine, Motion};
use crate::geometry::{PosePrior, Sight, covariance, moved, refine};
use nalgebra::{Isometry3, Matrix6, Vector2, Vector6};
use rig_model::{CameraModel, MarkerColor};

/// The platform's pose and motion while markers are hidden.
#[derive(Clone, Copy, Debug)]
pub(super) struct Carried {
    camera_from_volant: Isometry3<f64>,
    /// Over the last interval, as it was when three markers told it.
    motion: Option<Motion>,
    /// Since then, s.
    adrift: f64,
}

/// How long a motion goes on that fewer than three markers cannot tell, s.
const FORETOLD: f64 = 0.25;
/// How fast the platform may have been beside what was told (m/s, rad/s), and half of what one on a rope may be accelerated by
/// (m/s², rad/s²); 1 sigma.
const SPEED_SIGMA: [f64; 2] = [0.02, 0.04];
const PUSH_SIGMA: [f64; 2] = [1.0, 3.0];
/// Where nothing is known of the motion: m, rad.
const ANYWHERE: f64 = 0.1;
/// What the place of a marker on the platform, as it was learnt, adds to a centroid, px.
const LAYOUT_SIGMA: f64 = 0.05;

impl Engine {
    /// The pose in this image, with its covariance (as [`covariance`]), from the motion before it and the markers that are seen, where
    /// some are hidden; `None` where nothing tells it or all are seen. `ratio` is this interval over the one before.
    pub(super) fn carry(
        &mut self,
        camera: Option<&CameraModel>,
        ratio: f64,
    ) -> Option<(Isometry3<f64>, Matrix6<f64>)> {
        let pose = self.pose?;
        let seen = self.markers.0.iter().filter(|m| m.fit.is_some()).count();
        let told = self.motion.filter(|_| seen >= 3);
        let before = self.carried.take();
        let fresh = Carried { camera_from_volant: pose, motion: told, adrift: 0.0 };
        let hidden = self.markers.0.iter().any(|m| m.fit.is_none() && m.centroid.is_some());
        let result = if hidden { self.weighed(camera?, before.as_ref(), &pose, ratio) } else { None };
        self.carried = Some(match (before, result) {
            (_, _) if told.is_some() => fresh,
            (Some(b), Some((pose, _))) => b.after(&pose, ratio, self.interval),
            (Some(b), None) if seen < 3 => b.after(&pose, ratio, self.interval),
            _ => fresh,
        });
        result
    }

    /// The foretold pose and the seen markers, each by its weight.
    fn weighed(
        &self,
        camera: &CameraModel,
        before: Option<&Carried>,
        pose: &Isometry3<f64>,
        ratio: f64,
    ) -> Option<(Isometry3<f64>, Matrix6<f64>)> {
        let mut sights =
            [Sight { color: MarkerColor::Red, pixel: Vector2::zeros(), sigma: 0.1, outline: None }; 4];
        let mut n = 0;
        for color in MarkerColor::ALL {
            let m = &self.markers[color];
            if let Some(f) = &m.fit {
                let variance = f.covariance.trace() / 2.0 + LAYOUT_SIGMA.powi(2) + m.misplaced.powi(2);
                sights[n] = Sight { sigma: variance.sqrt(), ..self.sight(color, f, true) };
                n += 1;
            }
        }
        let foretold = before.and_then(|b| b.foretold(ratio, self.interval));
        if n == 0 && foretold.is_none() {
            return None;
        }
        let prior = foretold.unwrap_or(PosePrior {
            camera_from_volant: *pose,
            position_sigma: ANYWHERE,
            rotation_sigma: ANYWHERE,
        });
        let start = if n < 3 { prior.camera_from_volant } else { *pose };
        let (pose, _) = refine(&self.layout, camera, &sights[..n], &start, Some(&prior), 8)?;
        let covariance = covariance(&self.layout, camera, &sights[..n], &pose, &prior)?;
        Some((pose, covariance))
    }
}

impl Carried {
    /// What is known of the pose after another interval (`dt`, s).
    fn foretold(&self, ratio: f64, dt: f64) -> Option<PosePrior> {
        let (t, r) = self.motion?;
        let age = self.adrift + dt;
        let sigma = |i: usize| (1e-3 + SPEED_SIGMA[i] * age + PUSH_SIGMA[i] * age * age).min(ANYWHERE);
        (age < FORETOLD).then(|| PosePrior {
            camera_from_volant: moved(
                &self.camera_from_volant,
                &(Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z) * ratio),
            ),
            position_sigma: sigma(0),
            rotation_sigma: sigma(1),
        })
    }

    fn after(&self, pose: &Isometry3<f64>, ratio: f64, dt: f64) -> Self {
        Self {
            camera_from_volant: *pose,
            motion: self.motion.map(|(t, r)| (t * ratio, r * ratio)),
            adrift: self.adrift + dt,
        }
    }
}
