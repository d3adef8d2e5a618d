//! `volant/visual_pose`: the platform's pose from one image alone, by the paper's section II-E and eq. 4.
//!
//! The markers' centroids give the pose in the camera's frame ([`rig_model::planar_pose`]); the climber's readings,
//! interpolated to the image's stamp, and the camera's place on the climber bring it to the world (eq. 4). With two or
//! more markers hidden there is none. Where the image allows two poses, the unit's own "up" decides, in proportion to what it
//! is worth; without one, the previous visual pose; the pixels alone place the pose that is chosen.

use crate::{
    output::PoseEstimate,
    tight::start::{CLIMBER_ACCELERATION_SIGMA, CLIMBER_SPEED_SIGMA, Up, up_of},
};
use nalgebra::{Isometry3, Matrix6, UnitQuaternion, Vector3, Vector6};
use rig_model::{
    CameraModel, ClimberSample, ImuSample, MarkerObservations, MarkerState, PerColor, Rig, Stamp, planar_pose,
};
use std::collections::VecDeque;

/// So many samples are remembered.
const REMEMBERED: usize = 64;
/// A sample further from the image than this does not serve it, s.
const NEAR: f64 = 0.1;
/// The climber's speed is that of its readings of so long, s.
const SPAN: f64 = 0.1;
/// What the climber's way and turn do at most, as the filter takes it at its start.
const ACCELERATION: [f64; 2] = [CLIMBER_ACCELERATION_SIGMA[0], CLIMBER_ACCELERATION_SIGMA[2]];
const SPEED: [f64; 2] = [CLIMBER_SPEED_SIGMA[0], CLIMBER_SPEED_SIGMA[2]];

/// Poses from single images.
#[derive(Debug)]
pub struct VisualPoses {
    rig: Rig,
    camera: Option<CameraModel>,
    ups: VecDeque<(Stamp, Up)>,
    climber: VecDeque<(Stamp, Isometry3<f64>)>,
    last: Option<(Stamp, UnitQuaternion<f64>)>,
    floor: f64,
    climber_sigma: [f64; 2],
}

impl VisualPoses {
    /// For a rig; `floor` is the pixel model's own error (px), `climber_sigma` that of the climber's place (m) and turn (rad).
    pub fn new(rig: Rig, floor: f64, climber_sigma: [f64; 2]) -> Self {
        Self {
            rig,
            camera: None,
            ups: VecDeque::with_capacity(REMEMBERED),
            climber: VecDeque::with_capacity(REMEMBERED),
            last: None,
            floor,
            climber_sigma,
        }
    }

    /// Forgets all but the camera.
    pub fn reset(&mut self) {
        self.ups.clear();
        self.climber.clear();
        self.last = None;
    }

    /// The camera's calibration.
    pub fn camera(&mut self, camera: &CameraModel) {
        if self.camera.as_ref() != Some(camera) {
            self.camera = Some(camera.clone());
        }
    }

    /// An inertial sample: for its attitude.
    pub fn imu(&mut self, sample: &ImuSample) {
        let Some(orientation) = &sample.orientation else { return };
        let coords = orientation.enu_from_imu.coords;
        if !coords.iter().all(|x| x.is_finite()) || (coords.norm() - 1.0).abs() > 0.01 {
            return;
        }
        let variance = orientation.covariance.map_or(1e-4, |c| c[(0, 0)].max(c[(1, 1)]));
        let sigma = if variance.is_finite() { variance.max(1e-6).sqrt() } else { 0.02 };
        if self.ups.len() == REMEMBERED {
            self.ups.pop_front();
        }
        self.ups.push_back((sample.stamp, Up { in_imu: up_of(&orientation.enu_from_imu), sigma }));
    }

    /// A climber sample.
    pub fn climber(&mut self, sample: &ClimberSample) {
        let pose = &sample.world_from_climber;
        if !pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|x| x.is_finite()) {
            return;
        }
        if self.climber.back().is_some_and(|(last, _)| *last >= sample.stamp) {
            // A looped bag starts anew; what is merely late does not matter here.
            if self.climber.back().is_some_and(|(last, _)| last.seconds_since(sample.stamp) > 1.0) {
                self.reset();
            } else {
                return;
            }
        }
        if self.climber.len() == REMEMBERED {
            self.climber.pop_front();
        }
        self.climber.push_back((sample.stamp, *pose));
    }

    /// The pose of an image; `None` with fewer than three measured markers or where the climber's readings do not reach.
    pub fn estimate(&mut self, observations: &MarkerObservations) -> Option<PoseEstimate> {
        let camera = self.camera.as_ref()?;
        let stamp = observations.stamp;
        let usable = |state: MarkerState| {
            observations
                .markers
                .0
                .iter()
                .filter(|m| m.state == state && m.centroid.iter().all(|x| x.is_finite()))
                .count()
        };
        if usable(MarkerState::Detected) < 3 {
            return None;
        }
        // One hidden marker may be where the flow of the others put it (eq. 3); what it is worth, its covariance says.
        let with_predicted = usable(MarkerState::Predicted) == 1;
        let floor = nalgebra::Matrix2::identity() * (self.floor * self.floor + 1e-4);
        let pixels = PerColor::from_fn(|color| {
            let m = &observations.markers[color];
            let take =
                m.state == MarkerState::Detected || (with_predicted && m.state == MarkerState::Predicted);
            let fine = m.centroid.iter().chain(m.covariance.iter()).all(|x| x.is_finite());
            (take && fine).then(|| (m.centroid, m.covariance + floor))
        });
        let (world_from_climber, climber_sigma) = self.climber_at(stamp)?;
        let world_from_camera = world_from_climber * self.rig.climber_from_camera;
        let found = planar_pose::candidates(&self.rig.markers, camera, &pixels, None);
        let up = self
            .ups
            .iter()
            .min_by_key(|(s, _)| (s.as_nanos() - stamp.as_nanos()).unsigned_abs())
            .filter(|(s, _)| s.seconds_since(stamp).abs() < NEAR)
            .map(|(_, up)| *up);
        let mut best: Option<(f64, Isometry3<f64>, Matrix6<f64>)> = None;
        for candidate in &found {
            let world_from_volant = world_from_camera * candidate.camera_from_volant;
            let doubt = match (up, self.last) {
                (Some(up), _) => {
                    let felt = world_from_volant.rotation * self.rig.imu.volant_from_imu.rotation * up.in_imu;
                    (felt.angle(&Vector3::z()) / up.sigma).powi(2)
                }
                (None, Some((last, rotation))) if stamp.seconds_since(last).abs() < 0.3 => {
                    (world_from_volant.rotation.angle_to(&rotation) / 0.2).powi(2)
                }
                _ => 0.0,
            };
            let cost = candidate.cost + doubt;
            if best.as_ref().is_none_or(|(least, _, _)| cost < *least) {
                best = Some((cost, world_from_volant, candidate.covariance));
            }
        }
        let (_, pose, in_camera) = best?;
        self.last = Some((stamp, pose.rotation));
        let turn = world_from_camera.rotation.to_rotation_matrix();
        let mut jacobian = Matrix6::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(turn.matrix());
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(turn.matrix());
        let mut covariance = jacobian * in_camera * jacobian.transpose();
        let [place, angle] = climber_sigma.map(|s| s * s);
        covariance[(0, 0)] += place;
        covariance[(1, 1)] += place;
        let arm = pose.translation.vector - world_from_climber.translation.vector;
        let by_turn = Vector6::new(-arm.y, arm.x, 0.0, 0.0, 0.0, 1.0);
        covariance += by_turn * by_turn.transpose() * angle;
        let covariance = (covariance + covariance.transpose()) * 0.5;
        Some(PoseEstimate { stamp, pose, covariance })
    }

    /// The climber at an image's stamp and what its place (m) and turn (rad) are uncertain by. An image that is faster than
    /// the readings is ahead of them by up to their period: there the climber goes on as it went.
    fn climber_at(&self, stamp: Stamp) -> Option<(Isometry3<f64>, [f64; 2])> {
        let after = self.climber.partition_point(|(s, _)| *s < stamp);
        let before = after.checked_sub(1).and_then(|i| self.climber.get(i));
        match (before, self.climber.get(after)) {
            (Some((a, from)), Some((b, to))) => {
                let span = b.seconds_since(*a);
                let share = if span > 0.0 { stamp.seconds_since(*a) / span } else { 0.0 };
                (span < 2.0 * NEAR).then(|| (between(from, to, share), self.climber_sigma))
            }
            (Some((newest, last)), None) => {
                let age = stamp.seconds_since(*newest);
                if age >= NEAR {
                    return None;
                }
                let recent = self.climber.iter().find(|(s, _)| newest.seconds_since(*s) <= SPAN);
                let (first, from) = recent?;
                let span = newest.seconds_since(*first);
                if span < 0.3 * SPAN {
                    return Some((*last, self.grown(age, SPEED)));
                }
                let speed = [0, 1].map(|i| {
                    let rounded = self.climber_sigma[i] * 2.0_f64.sqrt() / span;
                    (rounded + ACCELERATION[i] * (span + age) / 2.0).min(SPEED[i])
                });
                Some((between(from, last, 1.0 + age / span), self.grown(age, speed)))
            }
            (None, Some((oldest, pose))) => {
                let age = oldest.seconds_since(stamp);
                (age < NEAR).then(|| (*pose, self.grown(age, SPEED)))
            }
            (None, None) => None,
        }
    }

    /// The readings' own uncertainty and that of the way since.
    fn grown(&self, age: f64, speed: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|i| self.climber_sigma[i].hypot(speed[i] * age))
    }
}

/// On the way from one pose to another, or beyond (share above 1).
fn between(from: &Isometry3<f64>, to: &Isometry3<f64>, share: f64) -> Isometry3<f64> {
    let place = from.translation.vector.lerp(&to.translation.vector, share);
    let turn = (to.rotation * from.rotation.inverse()).scaled_axis() * share;
    Isometry3::from_parts(place.into(), UnitQuaternion::from_scaled_axis(turn) * from.rotation)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_ahead_of_the_readings_finds_the_climber_where_it_has_come_to() {
        let rig = Rig::from_yaml(include_str!("../../test/src/rig/rig.yaml")).unwrap();
        let start = Stamp::from_nanos(1_760_001_000_000_000_000);
        let at = |t: f64| Vector3::new(0.3 * t + 0.05 * t * t, -0.2 * t, 2.8);
        let turn = |t: f64| 0.6 + 0.15 * t;
        let sigma = [1e-3 / 12.0_f64.sqrt(), 0.05_f64.to_radians() / 12.0_f64.sqrt()];
        let mut visual = VisualPoses::new(rig, 0.03, sigma);
        let mut worst = 0.0_f64;
        for i in 0..100 {
            let t = f64::from(i) * 0.02;
            let rounded = at(t).map(|x| (x * 1e3).round() * 1e-3);
            let rotation = UnitQuaternion::from_scaled_axis(Vector3::z() * turn(t));
            let world_from_climber = Isometry3::from_parts(rounded.into(), rotation);
            visual.climber(&ClimberSample { stamp: start.plus_seconds(t), world_from_climber });
            if i < 10 {
                continue;
            }
            for ahead in [0.0, 0.007, 0.019] {
                let (pose, sigma) = visual.climber_at(start.plus_seconds(t + ahead)).unwrap();
                let error = (pose.translation.vector - at(t + ahead)).norm();
                worst = worst.max(error);
                assert!(error < 3.0 * 2.0_f64.sqrt() * sigma[0], "{t} {ahead}: {error} {sigma:?}");
                assert!((pose.rotation.scaled_axis().z - turn(t + ahead)).abs() < 1e-9);
            }
        }
        // It was 7 mm behind with the newest reading alone.
        assert!(worst < 2e-3, "{worst}");
        assert!(visual.climber_at(start.plus_seconds(3.0)).is_none(), "readings that ended serve no image");
    }
}
