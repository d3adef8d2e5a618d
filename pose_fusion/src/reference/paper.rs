//! Loosely coupled extended Kalman filter as published (Kyriakoulis and Gasteratos 2010, section
//! III-C). Equations: `docs/src/equations.md`, "The published filter".

use crate::{
    config::{FusionConfig, PaperMeasurement},
    health::{
        pose_status::{NO_IMU_SAMPLE, PoseState, PoseStatus, StatusTimer},
        status::{Counts, InputCounts, Status, TimeOffsetStatus},
    },
    output::{Odometry, largest_sigma},
    reference::{
        correction, euler,
        gyro_attitude::GyroAttitude,
        marker_measurement::{plane_residual, world_rates},
        single_image::Visual,
        vector,
    },
    timeline::{arrival::Source, dropout::GAP},
};
use nalgebra::{Isometry3, Matrix6, SMatrix, UnitQuaternion, Vector3, Vector6};
use rig_model::{ImuSample, OrientationSample, Rig, Sample, Stamp, wrap_angle};
use std::collections::VecDeque;

/// Largest number of waiting IMU samples: ten seconds at 100 Hz.
const WAITING: usize = 1024;
/// A stamp this far before the newest one of its source is of a clock that was set back, s.
const SET_BACK: f64 = 1.0;

/// Published filter. The time offsets of camera and climber are those configured: the paper
/// estimates none. Its time is that of the IMU.
#[derive(Debug)]
pub struct Paper {
    config: FusionConfig,
    rig: Rig,
    /// Attitude of an IMU that has not output its own.
    computed_attitude: Option<GyroAttitude>,
    waiting: VecDeque<ImuSample>,
    last_sample: Option<ImuSample>,
    /// Rotation of east-north-up to the world, rad; known from the first visual pose on.
    heading: Option<f64>,
    velocity: Vector3<f64>,
    moved: Vector3<f64>,
    state: Option<Estimate>,
    /// Stamp of the newest image that gave a pose, and its number of markers.
    last_visual: Option<(Stamp, u8)>,
    images: u64,
    status_timer: StatusTimer,
}

#[derive(Clone, Debug)]
struct Estimate {
    stamp: Stamp,
    pose: Vector6<f64>,
    /// Of x, y, z, roll, pitch and yaw.
    covariance: Matrix6<f64>,
    imu_rotation: Vector3<f64>,
}

impl Paper {
    /// Creates a filter without an estimate.
    pub fn new(rig: &Rig, config: &FusionConfig) -> Self {
        Self {
            config: config.clone(),
            rig: rig.clone(),
            computed_attitude: Some(GyroAttitude::default()),
            waiting: VecDeque::with_capacity(WAITING),
            last_sample: None,
            heading: None,
            velocity: Vector3::zeros(),
            moved: Vector3::zeros(),
            state: None,
            last_visual: None,
            images: 0,
            status_timer: StatusTimer::default(),
        }
    }

    /// Discards the estimate.
    pub fn reset(&mut self) {
        *self = Self {
            computed_attitude: self.computed_attitude.take(),
            images: self.images,
            status_timer: std::mem::take(&mut self.status_timer),
            ..Self::new(&self.rig, &self.config)
        };
    }

    /// Takes in one input with its visual pose, if it is an image that has one; of an image returns
    /// the fused estimate.
    pub fn handle(&mut self, input: &Sample, visual: Option<&Visual>) -> Option<Odometry> {
        match input {
            Sample::Imu(sample) => {
                self.imu(sample);
                None
            }
            Sample::Markers(markers) => {
                self.images += 1;
                let odometry = self.image(self.imu_time(Source::Image, markers.stamp), visual)?;
                self.status_timer.0 = Some(odometry.stamp);
                Some(odometry)
            }
            Sample::Climber(_) | Sample::Camera(_) => None,
        }
    }

    /// Takes in an IMU sample, which waits for the next image. Once the IMU has output its own
    /// attitude, a sample without it is not used.
    fn imu(&mut self, sample: &ImuSample) {
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
            if self.computed_attitude.is_some() {
                // Both attitudes have a heading of their own.
                self.reset();
                self.computed_attitude = None;
            }
        } else {
            let enu_from_imu = self.computed_attitude.as_mut()?.update(&sample)?;
            sample.orientation = Some(OrientationSample { enu_from_imu, covariance: None });
        }
        Some(sample)
    }

    /// Takes in an image with its visual pose, if any, and returns the fused estimate.
    fn image(&mut self, stamp: Stamp, visual: Option<&Visual>) -> Option<Odometry> {
        let newest = self.last_output();
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

    /// Returns the stamp of the newest odometry of the estimate.
    fn last_output(&self) -> Option<Stamp> {
        self.state.as_ref().map(|s| s.stamp)
    }

    /// Returns the status where it is due at an input's stamp while no image gives a pose.
    pub fn due_status(&mut self, from: Source, stamp: Stamp) -> Option<PoseStatus> {
        let now = self.imu_time(from, stamp);
        let silent = self.silence(now) > self.config.status.max_image_age;
        (silent && self.status_timer.is_due(now)).then(|| self.pose_status(now))
    }

    /// Returns the status at an instant of IMU time.
    pub fn pose_status(&self, now: Stamp) -> PoseStatus {
        let time_offset = self.config.tight.clock.camera_offset;
        let Some(state) = &self.state else {
            return PoseStatus::initializing(now, time_offset, self.missing().to_owned());
        };
        let age = |s: Option<Stamp>| s.map_or(f64::INFINITY, |s| now.seconds_since(s).max(0.0));
        let image_age = age(self.last_visual.map(|(stamp, _)| stamp));
        let imu_age = age(self.newest_imu());
        // A visual pose rests on an encoder reading of its instant.
        let ages = [image_age, imu_age, image_age];
        let limits = &self.config.status;
        let mut status = PoseStatus {
            position_sigma: largest_sigma(&state.covariance, 0),
            rotation_sigma: largest_sigma(&state.covariance, 3),
            markers_used: self.last_visual.map_or(0, |(_, markers)| markers),
            ..PoseStatus::lost(now, ages, time_offset, String::new())
        }
        .judged(limits, (imu_age > GAP).then_some((NO_IMU_SAMPLE, imu_age)), None);
        let silence = self.silence(now);
        if silence > limits.max_image_age {
            (status.state, status.valid) = (PoseState::Lost, false);
            status.reason = format!(
                "no climber/markers for {silence:.1} s: the published filter outputs a pose with \
                 images only"
            );
        } else if status.state == PoseState::Coasting {
            // The published covariance does not contain what an acceleration's error becomes.
            let drift = self.config.tight.imu.accelerometer_bias * image_age * image_age / 2.0;
            status.valid &= drift <= limits.max_position_sigma;
            status.reason = format!(
                "two or more markers hidden, or no climber/transform: {}; the doubly integrated \
                 accelerations carry the pose and may be off by {drift:.2} m",
                status.reason
            );
        }
        status
    }

    /// Returns counters and insights for diagnostics.
    pub fn status(&self) -> Status {
        let offset = self.config.tight.clock.camera_offset;
        let (configured, sigma, searching) = (offset, f64::NAN, false);
        let inputs = InputCounts { images: self.images, ..InputCounts::default() };
        let state = self.state.as_ref();
        Status {
            initialized: state.is_some(),
            newest_imu: self.newest_imu(),
            position_sigma: state.map_or(f64::INFINITY, |s| largest_sigma(&s.covariance, 0)),
            time_offset: TimeOffsetStatus { offset, configured, sigma, searching },
            counts: Counts { inputs, ..Counts::default() },
            ..Status::default()
        }
    }

    /// Returns the stamp of an input in IMU time.
    fn imu_time(&self, from: Source, stamp: Stamp) -> Stamp {
        let clock = &self.config.tight.clock;
        match from {
            Source::Imu => stamp,
            Source::Image => stamp.plus_seconds(clock.camera_offset),
            Source::Encoders => stamp.plus_seconds(clock.climber_offset + clock.camera_offset),
        }
    }

    /// Returns the time since the newest odometry, s.
    fn silence(&self, now: Stamp) -> f64 {
        self.last_output().map_or(f64::INFINITY, |last| now.seconds_since(last))
    }

    /// Returns the stamp of the newest IMU sample.
    fn newest_imu(&self) -> Option<Stamp> {
        self.waiting.back().or(self.last_sample.as_ref()).map(|s| s.stamp)
    }

    /// Whether the attitude is computed here, because the IMU outputs none.
    pub fn computes_attitude(&self) -> bool {
        self.computed_attitude.is_some() && self.newest_imu().is_some()
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
        let position = Vector3::new(x[0], x[1], x[2]);
        let rotation = UnitQuaternion::from_euler_angles(x[3], x[4], x[5]);
        // Roll, pitch and yaw are about other axes than the world's.
        let mut jacobian = Matrix6::identity();
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&world_rates(x));
        let pose_covariance = jacobian * state.covariance * jacobian.transpose();
        let dt = dt.max(1e-3);
        Odometry {
            stamp: state.stamp,
            world_from_volant: Isometry3::from_parts(position.into(), rotation),
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
