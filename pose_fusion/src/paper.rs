//! The published filter (Kyriakoulis and Gasteratos 2010, section III-C), as it stands there.
//!
//! The state is the pose vector: three positions, and three rotations as roll, pitch and yaw. Inertial samples wait in a buffer until
//! an image comes; then
//! - the prediction (eq. 7, 9, 10 with the misprint read as `x⁻ = Ψ x`, Ψ = I) adds the inertial unit's change of translation
//!   and rotation since the last image: `x⁻ = x + u`, `P⁻ = P + Q`. The translation is the acceleration (turned to the
//!   world by the unit's own attitude, gravity taken off) integrated twice under the threshold control of section III-A; the
//!   rotation is the unit's own attitude, its heading aligned with the world at the first visual pose;
//! - the correction (eq. 11–13, read as usual) takes the visual pose as it is: `H = I`, `K = P⁻ (P⁻ + R)⁻¹`,
//!   `x = x⁻ + K (z − x⁻)`, `P = (I − K) P⁻`, with R/Q = 10.
//!
//! Output comes at the image rate. With two or more markers hidden the previous pose and the inertial data are the output.
//! Nothing corrects the inertial velocity (the paper names nothing that would); `velocity_from_fused` takes it from the
//! fused poses instead.

use crate::{
    config::PaperConfig,
    output::{Odometry, PoseEstimate},
};
use nalgebra::{Isometry3, Matrix3, Matrix6, UnitQuaternion, Vector3, Vector6};
use rig_model::{ImuSample, Rig, Stamp};
use std::{collections::VecDeque, f64::consts::TAU};

/// So many inertial samples wait at most (two minutes at 100 Hz would be too late anyway).
const WAITING: usize = 1024;

/// The published filter.
#[derive(Debug)]
pub struct Paper {
    config: PaperConfig,
    volant_from_imu: Isometry3<f64>,
    waiting: VecDeque<ImuSample>,
    last_sample: Option<ImuSample>,
    /// The heading that turns the unit's east-north-up to the world, rad; known from the first visual pose on.
    heading: Option<f64>,
    velocity: Vector3<f64>,
    moved: Vector3<f64>,
    state: Option<Estimate>,
}

#[derive(Clone, Debug)]
struct Estimate {
    stamp: Stamp,
    pose: Vector6<f64>,
    covariance: Matrix6<f64>,
    unit_rotation: Vector3<f64>,
}

impl Paper {
    /// A filter that knows nothing yet.
    pub fn new(rig: &Rig, config: PaperConfig) -> Self {
        Self {
            config,
            volant_from_imu: rig.imu.volant_from_imu,
            waiting: VecDeque::with_capacity(WAITING),
            last_sample: None,
            heading: None,
            velocity: Vector3::zeros(),
            moved: Vector3::zeros(),
            state: None,
        }
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.waiting.clear();
        self.last_sample = None;
        self.heading = None;
        self.velocity = Vector3::zeros();
        self.moved = Vector3::zeros();
        self.state = None;
    }

    /// An inertial sample: waits for the next image. One without the unit's attitude is of no use to this filter.
    pub fn imu(&mut self, sample: &ImuSample) {
        let finite =
            sample.specific_force.iter().chain(sample.angular_velocity.iter()).all(|x| x.is_finite());
        let attitude =
            sample.orientation.as_ref().is_some_and(|o| o.enu_from_imu.coords.iter().all(|x| x.is_finite()));
        if !(finite && attitude) {
            return;
        }
        let newest = self.waiting.back().or(self.last_sample.as_ref()).map(|s| s.stamp);
        if newest.is_some_and(|n| n.seconds_since(sample.stamp) > 1.0) {
            self.reset();
        } else if newest.is_some_and(|n| n >= sample.stamp) {
            return;
        }
        if self.waiting.len() == WAITING {
            self.waiting.pop_front();
        }
        self.waiting.push_back(sample.clone());
    }

    /// An image at `stamp`, with its visual pose where it has one: fuses what there is.
    pub fn image(&mut self, stamp: Stamp, visual: Option<&PoseEstimate>) -> Option<Odometry> {
        if self.state.as_ref().is_some_and(|s| s.stamp >= stamp) {
            return None;
        }
        self.integrate_to(stamp);
        let sample = self.last_sample.clone()?;
        let Some(before) = self.state.clone() else {
            // The first visual pose is the start, and aligns the unit's heading.
            let visual = visual?;
            let pose = vector(&visual.pose);
            let unit = self.unit_attitude(&sample)?;
            self.heading = Some(wrap(pose[5] - euler(&unit).z));
            self.velocity = Vector3::zeros();
            self.moved = Vector3::zeros();
            let state = Estimate {
                stamp,
                pose,
                covariance: self.measurement_noise(),
                unit_rotation: euler(&self.unit_attitude(&sample)?),
            };
            self.state = Some(state.clone());
            return Some(self.odometry(&state, &sample, Vector3::zeros(), 1.0));
        };
        let unit_rotation = euler(&self.unit_attitude(&sample)?);
        let turned = (unit_rotation - before.unit_rotation).map(wrap);
        let mut pose = before.pose;
        for i in 0..3 {
            pose[i] += self.moved[i];
            pose[3 + i] = wrap(pose[3 + i] + turned[i]);
        }
        self.moved = Vector3::zeros();
        let mut covariance = before.covariance + self.measurement_noise() / self.config.ratio;
        if let Some(visual) = visual {
            let z = vector(&visual.pose);
            let innovation = covariance + self.measurement_noise();
            let mut difference = z - pose;
            for i in 3..6 {
                difference[i] = wrap(difference[i]);
            }
            if let Some(cholesky) = innovation.cholesky() {
                pose += covariance * cholesky.solve(&difference);
                let gain_p = covariance * cholesky.solve(&covariance);
                covariance -= (gain_p + gain_p.transpose()) * 0.5;
            }
        }
        let dt = stamp.seconds_since(before.stamp);
        let speed = (pose - before.pose).fixed_rows::<3>(0) / dt;
        if self.config.velocity_from_fused && visual.is_some() {
            self.velocity = speed;
        }
        let state = Estimate { stamp, pose, covariance, unit_rotation };
        self.state = Some(state.clone());
        Some(self.odometry(&state, &sample, speed, dt))
    }

    /// Double integration with the threshold control.
    fn integrate_to(&mut self, stamp: Stamp) {
        while self.waiting.front().is_some_and(|s| s.stamp <= stamp) {
            let Some(sample) = self.waiting.pop_front() else { return };
            if let (Some(last), Some(attitude)) = (&self.last_sample, self.unit_attitude(&sample)) {
                let dt = sample.stamp.seconds_since(last.stamp);
                let world_from_imu = attitude * self.volant_from_imu.rotation;
                let gravity = Vector3::new(0.0, 0.0, self.config.gravity);
                let acceleration = world_from_imu * sample.specific_force - gravity;
                let velocity = self.velocity + acceleration * dt;
                if (velocity - self.velocity).norm() >= self.config.velocity_threshold {
                    self.moved += (self.velocity + velocity) * (dt / 2.0);
                    self.velocity = velocity;
                }
            }
            self.last_sample = Some(sample);
        }
    }

    /// `world_from_volant`'s rotation as the unit has it.
    fn unit_attitude(&self, sample: &ImuSample) -> Option<UnitQuaternion<f64>> {
        let enu_from_imu = sample.orientation.as_ref()?.enu_from_imu;
        let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.heading.unwrap_or(0.0));
        Some(heading * enu_from_imu * self.volant_from_imu.rotation.inverse())
    }

    fn measurement_noise(&self) -> Matrix6<f64> {
        let (p, r) = (self.config.position_sigma.powi(2), self.config.rotation_sigma.powi(2));
        Matrix6::from_diagonal(&Vector6::new(p, p, p, r, r, r))
    }

    fn odometry(&self, state: &Estimate, sample: &ImuSample, speed: Vector3<f64>, dt: f64) -> Odometry {
        let x = &state.pose;
        let rotation = UnitQuaternion::from_euler_angles(x[3], x[4], x[5]);
        // Roll, pitch and yaw turn about axes that are not the world's: δθ = E δ(roll, pitch, yaw).
        let (sp, cp) = x[4].sin_cos();
        let (sy, cy) = x[5].sin_cos();
        let e = Matrix3::new(cy * cp, -sy, 0.0, sy * cp, cy, 0.0, -sp, 0.0, 1.0);
        let mut jacobian = Matrix6::identity();
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&e);
        let pose_covariance = jacobian * state.covariance * jacobian.transpose();
        let dt = dt.max(1e-3);
        Odometry {
            stamp: state.stamp,
            world_from_volant: Isometry3::from_parts(Vector3::new(x[0], x[1], x[2]).into(), rotation),
            pose_covariance: (pose_covariance + pose_covariance.transpose()) * 0.5,
            linear_velocity: rotation.inverse() * speed,
            angular_velocity: self.volant_from_imu.rotation * sample.angular_velocity,
            twist_covariance: Matrix6::from_diagonal(&Vector6::new(
                2.0 * state.covariance[(0, 0)] / (dt * dt),
                2.0 * state.covariance[(1, 1)] / (dt * dt),
                2.0 * state.covariance[(2, 2)] / (dt * dt),
                1e-4,
                1e-4,
                1e-4,
            )),
        }
    }
}

/// x, y, z, roll, pitch, yaw.
fn vector(pose: &Isometry3<f64>) -> Vector6<f64> {
    let (t, e) = (pose.translation.vector, euler(&pose.rotation));
    Vector6::new(t.x, t.y, t.z, e.x, e.y, e.z)
}

fn euler(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let (roll, pitch, yaw) = rotation.euler_angles();
    Vector3::new(roll, pitch, yaw)
}

fn wrap(angle: f64) -> f64 {
    angle - (angle / TAU).round() * TAU
}
