//! Loosely coupled extended Kalman filter as published (Kyriakoulis and Gasteratos 2010, section
//! III-C). Equations: `docs/src/equations.md`, "The published filter".

use crate::{
    config::{FusionConfig, PaperMeasurement},
    output::Odometry,
    reference::{
        gyro_attitude::GyroAttitude,
        marker_measurement::{plane_residual, world_rates},
        single_image::Visual,
    },
};
use nalgebra::{Isometry3, Matrix6, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use rig_model::{ImuSample, OrientationSample, Rig, Stamp, wrap_angle};
use std::collections::VecDeque;

/// Largest number of waiting IMU samples: ten seconds at 100 Hz.
const WAITING: usize = 1024;

/// A stamp this far before the newest one of its source is of a clock that was set back, s.
const SET_BACK: f64 = 1.0;

/// Published filter.
#[derive(Debug)]
pub struct Paper {
    pub(super) config: FusionConfig,
    rig: Rig,
    /// The IMU outputs its own attitude.
    own_attitude: bool,
    computed_attitude: GyroAttitude,
    waiting: VecDeque<ImuSample>,
    last_sample: Option<ImuSample>,
    /// Rotation of east-north-up to the world, rad; known from the first visual pose on.
    heading: Option<f64>,
    velocity: Vector3<f64>,
    moved: Vector3<f64>,
    pub(super) state: Option<Estimate>,
    /// Stamp of the newest image that gave a pose, and its number of markers.
    pub(super) last_visual: Option<(Stamp, u8)>,
}

#[derive(Clone, Debug)]
pub(super) struct Estimate {
    stamp: Stamp,
    pose: Vector6<f64>,
    /// Of x, y, z, roll, pitch and yaw.
    pub(super) covariance: Matrix6<f64>,
    imu_rotation: Vector3<f64>,
}

impl Paper {
    /// Creates a filter without an estimate.
    pub fn new(rig: &Rig, config: &FusionConfig) -> Self {
        Self {
            config: config.clone(),
            rig: rig.clone(),
            own_attitude: false,
            computed_attitude: GyroAttitude::default(),
            waiting: VecDeque::with_capacity(WAITING),
            last_sample: None,
            heading: None,
            velocity: Vector3::zeros(),
            moved: Vector3::zeros(),
            state: None,
            last_visual: None,
        }
    }

    /// Discards the estimate.
    pub fn reset(&mut self) {
        *self = Self {
            own_attitude: self.own_attitude,
            computed_attitude: std::mem::take(&mut self.computed_attitude),
            ..Self::new(&self.rig, &self.config)
        };
    }

    /// Takes in an IMU sample, which waits for the next image. Once the IMU has output its own
    /// attitude, a sample without it is not used.
    pub fn imu(&mut self, sample: &ImuSample) {
        let attitude = sample.orientation.iter().flat_map(|o| &o.enu_from_imu.coords);
        let numbers = sample.specific_force.iter().chain(&sample.angular_velocity).chain(attitude);
        if !numbers.into_iter().all(|x| x.is_finite()) {
            return;
        }
        let newest = self.newest_imu();
        if newest.is_some_and(|n| n.seconds_since(sample.stamp) > SET_BACK) {
            self.reset();
        } else if newest.is_some_and(|n| n >= sample.stamp) {
            return;
        }
        let Some(sample) = self.with_attitude(sample) else { return };
        if self.waiting.len() == WAITING {
            self.waiting.pop_front();
        }
        self.waiting.push_back(sample);
    }

    /// The sample with the IMU's own attitude or, of an IMU that outputs none, a computed one.
    fn with_attitude(&mut self, sample: &ImuSample) -> Option<ImuSample> {
        let mut sample = *sample;
        if sample.orientation.is_some() {
            if !self.own_attitude {
                // Both attitudes have a heading of their own.
                self.reset();
                self.own_attitude = true;
            }
        } else if self.own_attitude {
            return None;
        } else {
            let enu_from_imu = self.computed_attitude.update(&sample)?;
            sample.orientation = Some(OrientationSample { enu_from_imu, covariance: None });
        }
        Some(sample)
    }

    /// Takes in an image with its visual pose, if any, and returns the fused estimate.
    pub fn image(&mut self, stamp: Stamp, visual: Option<&Visual>) -> Option<Odometry> {
        let newest = self.stamp();
        if newest.is_some_and(|n| n.seconds_since(stamp) > SET_BACK) {
            self.reset();
        } else if newest.is_some_and(|n| n >= stamp) {
            return None;
        }
        self.integrate_to(stamp);
        let sample = self.last_sample?;
        let Some(before) = self.state.clone() else {
            // The first visual pose initializes the filter and aligns the IMU's heading.
            let visual = visual?;
            self.last_visual = Some((stamp, visual.markers()));
            let pose = vector(&visual.pose.pose);
            let measured = self.imu_attitude(&sample)?;
            self.heading = Some(wrap_angle(pose[5] - euler(&measured).z));
            self.velocity = Vector3::zeros();
            self.moved = Vector3::zeros();
            let state = Estimate {
                stamp,
                pose,
                covariance: self.measurement_noise(),
                imu_rotation: euler(&self.imu_attitude(&sample)?),
            };
            self.state = Some(state.clone());
            return Some(self.odometry(&state, &sample, Vector3::zeros(), 1.0));
        };
        let imu_rotation = euler(&self.imu_attitude(&sample)?);
        let rotated = (imu_rotation - before.imu_rotation).map(wrap_angle);
        let mut pose = before.pose;
        for i in 0..3 {
            pose[i] += self.moved[i];
            pose[3 + i] = wrap_angle(pose[3 + i] + rotated[i]);
        }
        self.moved = Vector3::zeros();
        let mut covariance = before.covariance + self.measurement_noise() / self.config.paper.ratio;
        if let Some(visual) = visual {
            self.last_visual = Some((stamp, visual.markers()));
            (pose, covariance) = self.corrected(pose, covariance, visual);
        }
        let dt = stamp.seconds_since(before.stamp);
        let speed = (pose - before.pose).fixed_rows::<3>(0) / dt;
        if self.config.paper.velocity_from_fused && visual.is_some() {
            self.velocity = speed;
        }
        let state = Estimate { stamp, pose, covariance, imu_rotation };
        self.state = Some(state.clone());
        Some(self.odometry(&state, &sample, speed, dt))
    }

    /// Returns the stamp of the estimate.
    pub fn stamp(&self) -> Option<Stamp> {
        self.state.as_ref().map(|s| s.stamp)
    }

    /// Returns the stamp of the newest IMU sample.
    pub fn newest_imu(&self) -> Option<Stamp> {
        self.waiting.back().or(self.last_sample.as_ref()).map(|s| s.stamp)
    }

    /// Whether the attitude is computed here, because the IMU outputs none.
    pub fn computes_attitude(&self) -> bool {
        !self.own_attitude && self.newest_imu().is_some()
    }

    /// Returns what the initialization waits for; empty where there is an estimate.
    pub fn missing(&self) -> &'static str {
        if self.state.is_some() {
            ""
        } else if self.newest_imu().is_none() {
            "no volant/imu/data"
        } else {
            "no image that gives a pose: the published one needs climber/camera/camera_info, \
             climber/transform and at least three detected markers"
        }
    }

    /// Correction (eq. 11–13) of a predicted pose and its covariance.
    fn corrected(
        &self,
        mut pose: Vector6<f64>,
        covariance: Matrix6<f64>,
        visual: &Visual,
    ) -> (Vector6<f64>, Matrix6<f64>) {
        let corrected = match self.config.paper.measurement {
            PaperMeasurement::Pose => {
                let mut residual = vector(&visual.pose.pose) - pose;
                for i in 3..6 {
                    residual[i] = wrap_angle(residual[i]);
                }
                let noise = self.measurement_noise();
                correction(&covariance, &Matrix6::identity(), &noise, &residual)
            }
            PaperMeasurement::Markers => {
                let (residual, h) = plane_residual(&pose, &self.rig.markers, &visual.lines);
                let noise = SMatrix::identity() * self.config.paper.position_sigma.powi(2);
                correction(&covariance, &h, &noise, &residual)
            }
        };
        let Some((step, covariance)) = corrected else { return (pose, covariance) };
        pose += step;
        for i in 3..6 {
            pose[i] = wrap_angle(pose[i]);
        }
        (pose, covariance)
    }

    /// Double integration with the threshold control.
    fn integrate_to(&mut self, stamp: Stamp) {
        while self.waiting.front().is_some_and(|s| s.stamp <= stamp) {
            let Some(sample) = self.waiting.pop_front() else { return };
            if let (Some(last), Some(attitude)) = (&self.last_sample, self.imu_attitude(&sample)) {
                let dt = sample.stamp.seconds_since(last.stamp);
                let world_from_imu = attitude * self.rig.imu.volant_from_imu.rotation;
                let gravity = Vector3::new(0.0, 0.0, self.config.tight.gravity);
                let acceleration = world_from_imu * sample.specific_force - gravity;
                let velocity = self.velocity + acceleration * dt;
                if (velocity - self.velocity).norm() >= self.config.paper.velocity_threshold {
                    self.moved += (self.velocity + velocity) * (dt / 2.0);
                    self.velocity = velocity;
                }
            }
            self.last_sample = Some(sample);
        }
    }

    /// Rotation of `world_from_volant` as the IMU has it.
    fn imu_attitude(&self, sample: &ImuSample) -> Option<UnitQuaternion<f64>> {
        let enu_from_imu = sample.orientation.as_ref()?.enu_from_imu;
        let heading =
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.heading.unwrap_or(0.0));
        Some(heading * enu_from_imu * self.rig.imu.volant_from_imu.rotation.inverse())
    }

    fn measurement_noise(&self) -> Matrix6<f64> {
        let (p, r) =
            (self.config.paper.position_sigma.powi(2), self.config.paper.rotation_sigma.powi(2));
        Matrix6::from_diagonal(&Vector6::new(p, p, p, r, r, r))
    }

    fn odometry(
        &self,
        state: &Estimate,
        sample: &ImuSample,
        speed: Vector3<f64>,
        dt: f64,
    ) -> Odometry {
        let x = &state.pose;
        let rotation = UnitQuaternion::from_euler_angles(x[3], x[4], x[5]);
        // Roll, pitch and yaw are about other axes than the world's.
        let mut jacobian = Matrix6::identity();
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&world_rates(x));
        let pose_covariance = jacobian * state.covariance * jacobian.transpose();
        let dt = dt.max(1e-3);
        Odometry {
            stamp: state.stamp,
            world_from_volant: Isometry3::from_parts(
                Vector3::new(x[0], x[1], x[2]).into(),
                rotation,
            ),
            pose_covariance: (pose_covariance + pose_covariance.transpose()) * 0.5,
            linear_velocity: rotation.inverse() * speed,
            angular_velocity: self.rig.imu.volant_from_imu.rotation * sample.angular_velocity,
            twist_covariance: Matrix6::from_diagonal(&Vector6::from_fn(|i, _| match i {
                0..3 => 2.0 * state.covariance[(i, i)] / (dt * dt),
                _ => 1e-4,
            })),
        }
    }
}

/// Step K r and covariance (I − K H) P of a Kalman correction; `None` where the innovation's
/// covariance is not positive definite.
fn correction<const N: usize>(
    covariance: &Matrix6<f64>,
    jacobian: &SMatrix<f64, N, 6>,
    noise: &SMatrix<f64, N, N>,
    residual: &SVector<f64, N>,
) -> Option<(Vector6<f64>, Matrix6<f64>)> {
    let innovation = jacobian * covariance * jacobian.transpose() + noise;
    let cholesky = innovation.cholesky()?;
    let cross = covariance * jacobian.transpose();
    let reduction = cross * cholesky.solve(&cross.transpose());
    let step = cross * cholesky.solve(residual);
    Some((step, covariance - (reduction + reduction.transpose()) * 0.5))
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
