//! Pose from one image alone, by the paper's section II-E and eq. 4 (`volant/visual_pose`).
//!
//! The markers' centroids give the pose in the camera's frame ([`rig_model::planar_pose`]); the
//! encoders, interpolated to the image's stamp, and the camera's mounting bring it to the world
//! (eq. 4). With two or more markers hidden there is none. Where the image allows two poses, the
//! previous visual pose decides, or with `visual_pose.use_gravity` the IMU's direction of "up"; the
//! pixels alone place the pose that is chosen.

use crate::{
    config::{ClimberConfig, TightConfig},
    input::{
        climber_track::ClimberTrack,
        imu::{Up, nearest, up_of},
    },
    measurements::geometry::ClimberRest,
    output::PoseEstimate,
};
use nalgebra::{Isometry3, Matrix6, UnitQuaternion, Vector3, Vector6};
use rig_model::{
    CameraModel, ClimberSample, ImuSample, MarkerObservations, MarkerState, PerColor, Rig, Stamp,
    planar_pose,
};
use std::collections::VecDeque;

/// Number of attitudes kept.
const KEPT: usize = 64;
/// Encoder readings further from the image than this do not serve it, s.
const NEAR: f64 = 0.1;
/// Smallest uncertainty of the IMU's own roll and pitch, rad.
const ATTITUDE_FLOOR: f64 = 1e-3;
/// The previous visual pose decides between two for this long, s, with this uncertainty of the
/// rotation in between, rad.
const PREVIOUS: [f64; 2] = [0.3, 0.2];

/// Poses from single images.
#[derive(Debug)]
pub struct SingleImagePose {
    rig: Rig,
    camera: Option<CameraModel>,
    ups: VecDeque<(Stamp, Up)>,
    climber: ClimberTrack,
    climber_config: ClimberConfig,
    last: Option<(Stamp, UnitQuaternion<f64>)>,
    floor: f64,
    max_range: f64,
    use_gravity: bool,
}

impl SingleImagePose {
    /// Creates an estimator for a rig. With `use_gravity` the IMU's direction of "up" decides
    /// between two poses.
    pub fn new(rig: Rig, config: &TightConfig, use_gravity: bool) -> Self {
        Self {
            rig,
            camera: None,
            ups: VecDeque::with_capacity(KEPT),
            climber: ClimberTrack::new(&config.climber),
            climber_config: config.climber.clone(),
            last: None,
            floor: config.markers.pixel_floor,
            max_range: config.limits.max_range,
            use_gravity,
        }
    }

    /// Discards everything but the camera.
    pub fn reset(&mut self) {
        self.ups.clear();
        self.climber = ClimberTrack::new(&self.climber_config);
        self.last = None;
    }

    /// Sets the camera's calibration.
    pub fn camera(&mut self, camera: &CameraModel) {
        if self.camera.as_ref() != Some(camera) {
            self.camera = Some(camera.clone());
        }
    }

    /// Takes in an IMU sample, for its attitude.
    pub fn imu(&mut self, sample: &ImuSample) {
        if let Some(up) = up_of(sample, ATTITUDE_FLOOR).filter(|_| self.use_gravity) {
            if self.ups.len() == KEPT {
                self.ups.pop_front();
            }
            self.ups.push_back((sample.stamp, up));
        }
    }

    /// Takes in an encoder reading.
    pub fn climber(&mut self, sample: &ClimberSample) {
        let pose = &sample.world_from_climber;
        if !pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|x| x.is_finite())
        {
            return;
        }
        // A looped bag starts again.
        if self
            .climber
            .newest()
            .is_some_and(|(newest, _, _)| newest.seconds_since(sample.stamp) > 1.0)
        {
            self.reset();
        }
        let (values, rest) = ClimberRest::split(pose);
        self.climber.add(sample.stamp, values, rest);
    }

    /// Returns `world_from_volant` from one image. `None` with fewer than three detected markers,
    /// or without encoder readings within 0.1 s.
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
        // One hidden marker may be placed by the flow of the others (eq. 3), with its covariance.
        let with_predicted = usable(MarkerState::Predicted) == 1;
        let floor = nalgebra::Matrix2::identity() * (self.floor * self.floor + 1e-4);
        let pixels = PerColor::from_fn(|color| {
            let m = &observations.markers[color];
            let take = m.state == MarkerState::Detected
                || (with_predicted && m.state == MarkerState::Predicted);
            let fine = m.centroid.iter().chain(m.covariance.iter()).all(|x| x.is_finite());
            (take && fine).then(|| (m.centroid, m.covariance + floor))
        });
        let (world_from_climber, climber_sigma) = self.climber_at(stamp)?;
        let world_from_camera = world_from_climber * self.rig.climber_from_camera;
        let found = planar_pose::candidates(&self.rig.markers, camera, &pixels, None);
        let up = nearest(&self.ups, stamp).filter(|_| self.use_gravity);
        let mut best: Option<(f64, Isometry3<f64>, Matrix6<f64>)> = None;
        // A false marker may put the platform anywhere.
        let within = |c: &&planar_pose::PlanarPose| {
            c.camera_from_volant.translation.vector.norm() < self.max_range
        };
        for candidate in found.iter().filter(within) {
            let world_from_volant = world_from_camera * candidate.camera_from_volant;
            let unlikely = match (up, self.last) {
                (Some(up), _) => {
                    let measured = world_from_volant.rotation
                        * self.rig.imu.volant_from_imu.rotation
                        * up.in_imu;
                    (measured.angle(&Vector3::z()) / up.sigma).powi(2)
                }
                (None, Some((last, rotation))) if stamp.seconds_since(last).abs() < PREVIOUS[0] => {
                    (world_from_volant.rotation.angle_to(&rotation) / PREVIOUS[1]).powi(2)
                }
                _ => 0.0,
            };
            let cost = candidate.cost + unlikely;
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

    /// `world_from_climber` at an image's stamp with the standard deviations of its position (m)
    /// and turn (rad).
    fn climber_at(&self, stamp: Stamp) -> Option<(Isometry3<f64>, [f64; 2])> {
        let at = self.climber.at(stamp).filter(|at| at.distance < NEAR)?;
        let sigma = |axis: usize| at.noise[axis].hypot(at.growth[axis]);
        Some((at.rest.join(&at.values), [sigma(0).max(sigma(1)), sigma(2)]))
    }
}
