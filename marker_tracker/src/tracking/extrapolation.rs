//! Where a hidden marker is: the platform's motion continues, corrected by the markers that are
//! still visible.

use crate::{
    geometry::{PoseEstimate, PoseObservation, PosePrior},
    tracking::{
        marker::MarkerTrack,
        motion::{ImageInterval, Motion, PlatformMotion},
        platform::PlatformModel,
    },
};
use nalgebra::Isometry3;
use rig_model::{CameraModel, PerColor, planar_pose::moved};

/// Longest extrapolation of a motion that fewer than three markers cannot determine, s. Tuned;
/// guarded by the bounds on predicted markers in `tests/synthetic` and `tests/bags`.
const MAX_AGE: f64 = 0.25;
/// Standard deviations of the growth of the pose's error: error of the measured velocity (m/s,
/// rad/s) and half the acceleration of a platform on a rope (m/s², rad/s²), for translation and
/// rotation. Tuned; guarded by the same bounds on their normalized squared error.
const VELOCITY_SIGMA: [f64; 2] = [0.02, 0.04];
const HALF_ACCELERATION_SIGMA: [f64; 2] = [1.0, 3.0];
/// Standard deviation without a known motion, and of the pose at age zero: m and rad.
const UNKNOWN_SIGMA: f64 = 0.1;
const START_SIGMA: f64 = 1e-3;
/// Error of an adapted marker place in a centroid, px: that of the centroids themselves in
/// `tests/bags`.
const LAYOUT_SIGMA: f64 = 0.05;

/// Pose and motion of the platform while markers are hidden.
#[derive(Clone, Copy, Debug)]
struct State {
    camera_from_volant: Isometry3<f64>,
    /// Over the last interval, as three markers last determined it.
    motion: Option<Motion>,
    /// Time since then, s.
    age: f64,
}

impl State {
    /// The pose `dt` s later, as a prior.
    fn predict(&self, ratio: f64, dt: f64) -> Option<PosePrior> {
        let motion = self.motion?;
        let age = self.age + dt;
        let sigma = |i: usize| {
            let by_velocity = START_SIGMA + VELOCITY_SIGMA[i] * age;
            (by_velocity + HALF_ACCELERATION_SIGMA[i] * age * age).min(UNKNOWN_SIGMA)
        };
        (age < MAX_AGE).then(|| PosePrior {
            camera_from_volant: moved(&self.camera_from_volant, &(motion * ratio)),
            position_sigma: sigma(0),
            rotation_sigma: sigma(1),
        })
    }

    fn after(&self, pose: &Isometry3<f64>, ratio: f64, dt: f64) -> Self {
        Self {
            camera_from_volant: *pose,
            motion: self.motion.map(|m| m * ratio),
            age: self.age + dt,
        }
    }
}

/// Extrapolates the platform's pose through images in which markers are hidden.
#[derive(Clone, Debug, Default)]
pub(super) struct Extrapolator {
    state: Option<State>,
}

impl Extrapolator {
    /// Advances to an image; returns its pose where markers are hidden and something determines it.
    /// `ratio`: this image interval over the previous one.
    pub fn advance(
        &mut self,
        platform_motion: &PlatformMotion,
        platform: &PlatformModel,
        tracks: &PerColor<MarkerTrack>,
        camera: Option<&CameraModel>,
        ratio: f64,
        interval: &ImageInterval,
    ) -> Option<PoseEstimate> {
        let pose = platform_motion.pose?;
        let seen = tracks.0.iter().filter(|m| m.fit.is_some()).count();
        let measured = platform_motion.last.filter(|_| seen >= 3);
        let before = self.state.take();
        let fresh = State { camera_from_volant: pose, motion: measured, age: 0.0 };
        let hidden = tracks.0.iter().any(|m| m.fit.is_none() && m.centroid.is_some());
        let result = if hidden {
            let prior = before.as_ref().and_then(|b| b.predict(ratio, interval.seconds));
            combine(platform, tracks, camera?, prior, &pose)
        } else {
            None
        };
        self.state = Some(match (before, result) {
            (_, _) if measured.is_some() => fresh,
            (Some(b), Some(r)) => b.after(&r.camera_from_volant, ratio, interval.seconds),
            (Some(b), None) if seen < 3 => b.after(&pose, ratio, interval.seconds),
            _ => fresh,
        });
        result
    }
}

/// The pose from its prior and the visible markers, each by its covariance. `pose`: start without a
/// prior.
fn combine(
    platform: &PlatformModel,
    tracks: &PerColor<MarkerTrack>,
    camera: &CameraModel,
    prior: Option<PosePrior>,
    pose: &Isometry3<f64>,
) -> Option<PoseEstimate> {
    let mut observations = [PoseObservation::NONE; 4];
    let mut n = 0;
    for (color, track) in tracks.iter() {
        if let Some(fit) = &track.fit {
            let misplacement = platform.markers[color].misplacement;
            let variance =
                fit.covariance.trace() / 2.0 + LAYOUT_SIGMA.powi(2) + misplacement.powi(2);
            let observation = platform.observation(color, fit, true);
            observations[n] = PoseObservation { sigma: variance.sqrt(), ..observation };
            n += 1;
        }
    }
    if n == 0 && prior.is_none() {
        return None;
    }
    let prior = prior.unwrap_or(PosePrior {
        camera_from_volant: *pose,
        position_sigma: UNKNOWN_SIGMA,
        rotation_sigma: UNKNOWN_SIGMA,
    });
    let start = if n < 3 { prior.camera_from_volant } else { *pose };
    let geometry = platform.geometry(camera);
    let (pose, _, normal) = geometry.refine(&observations[..n], &start, Some(&prior), 8)?;
    Some(PoseEstimate { camera_from_volant: pose, covariance: normal.cholesky()?.inverse() })
}
