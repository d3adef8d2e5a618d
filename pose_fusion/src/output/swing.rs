//! The platform relative to the climber: rope length, swing angles and their rates. Equations:
//! `docs/src/equations.md`, "Output".

use super::odometry::Settings;
use crate::{
    config::PendulumConfig,
    ekf::{
        consider::PARAMETERS,
        propagation::ImuReading,
        state::{
            ATTITUDE, CLIMBER, CLIMBER_RATE, GYROSCOPE_BIAS, N, POSITION, State, TIME_OFFSET,
            VELOCITY,
        },
    },
    measurements::geometry::{ClimberHeightTilt, Geometry},
};
use nalgebra::{Isometry3, Matrix6, Point3, SMatrix, UnitQuaternion, Vector3, Vector6};
use rig_model::Stamp;

/// Step of the differences (m, rad, per s).
const STEP: f64 = 1e-6;
/// Entries of the error that the swing depends on.
const USED: [usize; 6] = [POSITION, VELOCITY, ATTITUDE, GYROSCOPE_BIAS, CLIMBER, CLIMBER_RATE];

/// The platform relative to the climber at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Swing {
    /// Time.
    pub stamp: Stamp,
    /// Length of the rope, m.
    pub rope_length: f64,
    /// Swing toward the climber's +x and +y, rad.
    pub angles: [f64; 2],
    /// Rate of the length, m/s.
    pub rope_rate: f64,
    /// Rates of the angles, rad/s.
    pub rates: [f64; 2],
    /// Covariance of length, angles, rate of the length, rates of the angles.
    pub covariance: Matrix6<f64>,
    /// Pose of the platform in the climber's frame, m.
    pub climber_from_volant: Isometry3<f64>,
    /// Velocity of the platform's origin relative to the climber's frame, its axes, m/s.
    pub linear_velocity: Vector3<f64>,
    /// Angular velocity relative to it, its axes, rad/s.
    pub angular_velocity: Vector3<f64>,
}

/// Motion of platform and climber, and where the rope is attached.
#[derive(Clone, Copy)]
struct PlatformMotion<'a> {
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    attitude: UnitQuaternion<f64>,
    /// Of the IMU, its axes.
    angular_velocity: Vector3<f64>,
    climber: Vector3<f64>,
    climber_rate: Vector3<f64>,
    rest: &'a ClimberHeightTilt,
    /// IMU frame.
    platform_attachment: Vector3<f64>,
    climber_attachment: Vector3<f64>,
}

impl PlatformMotion<'_> {
    /// Position and velocity of a point of the platform (IMU frame) relative to a point of the
    /// climber, in the climber's axes.
    fn relative(
        &self,
        on_platform: &Vector3<f64>,
        on_climber: &Vector3<f64>,
    ) -> (Vector3<f64>, Vector3<f64>) {
        let world_from_climber = self.rest.join(&self.climber);
        let turn = Vector3::z() * self.climber_rate.z;
        let arm = world_from_climber.rotation * on_climber;
        let climber_velocity =
            Vector3::new(self.climber_rate.x, self.climber_rate.y, 0.0) + turn.cross(&arm);
        let lever = self.attitude * on_platform;
        let platform_velocity =
            self.velocity + (self.attitude * self.angular_velocity).cross(&lever);
        let between = self.position + lever - world_from_climber.translation.vector - arm;
        let change = platform_velocity - climber_velocity - turn.cross(&between);
        let into_climber = world_from_climber.rotation.inverse();
        (into_climber * between, into_climber * change)
    }

    /// Rope length, angles, their rates.
    fn values(&self) -> Vector6<f64> {
        let (rope, change) = self.relative(&self.platform_attachment, &self.climber_attachment);
        let length = rope.norm();
        let rate = if length > 0.0 { rope.dot(&change) / length } else { 0.0 };
        let angle_rate = |i: usize| {
            let square = rope[i] * rope[i] + rope.z * rope.z;
            if square > 0.0 { (rope[i] * change.z - rope.z * change[i]) / square } else { 0.0 }
        };
        Vector6::new(
            length,
            rope.x.atan2(-rope.z),
            rope.y.atan2(-rope.z),
            rate,
            angle_rate(0),
            angle_rate(1),
        )
    }

    /// The motion with one entry of the error state (an index of [`USED`] + axis) added.
    fn with(mut self, entry: usize, axis: usize, step: f64) -> Self {
        match entry {
            POSITION => self.position[axis] += step,
            VELOCITY => self.velocity[axis] += step,
            ATTITUDE => {
                let turned = Vector3::ith(axis, step);
                self.attitude = UnitQuaternion::from_scaled_axis(turned) * self.attitude;
            }
            GYROSCOPE_BIAS => self.angular_velocity[axis] -= step,
            CLIMBER => self.climber[axis] += step,
            _ => self.climber_rate[axis] += step,
        }
        self
    }
}

/// Returns the swing of a state at `stamp`; `rest` is the part of the climber's pose that its
/// encoders do not measure.
pub fn swing(
    stamp: Stamp,
    state: &State,
    reading: &ImuReading,
    rest: &ClimberHeightTilt,
    geometry: &Geometry,
    pendulum: &PendulumConfig,
    settings: &Settings,
) -> Swing {
    let motion = PlatformMotion {
        position: state.position,
        velocity: state.velocity,
        attitude: state.attitude,
        angular_velocity: state.motion(reading).angular_velocity,
        climber: state.climber,
        climber_rate: state.climber_rate,
        rest,
        platform_attachment: (geometry.imu_from_volant
            * Point3::from(pendulum.platform_attachment))
        .coords,
        climber_attachment: pendulum.climber_attachment.into(),
    };
    let values = motion.values();
    let mut jacobian = SMatrix::<f64, 6, N>::zeros();
    for entry in USED {
        for axis in 0..3 {
            let [ahead, behind] = [STEP, -STEP].map(|s| motion.with(entry, axis, s).values());
            jacobian.set_column(entry + axis, &((ahead - behind) / (2.0 * STEP)));
        }
    }
    // The error at IMU time: δx − ẋ δτ.
    let by_time = jacobian * state.rates(reading, settings.gravity);
    jacobian.set_column(TIME_OFFSET, &-by_time);
    let covariance = covariance(state, &jacobian, settings);
    let imu_from_volant = &geometry.imu_from_volant;
    let origin = imu_from_volant.translation.vector;
    let (position, linear_velocity) = motion.relative(&origin, &Vector3::zeros());
    let into_climber = rest.join(&state.climber).rotation.inverse();
    let turn = Vector3::z() * state.climber_rate.z;
    Swing {
        stamp,
        rope_length: values[0],
        angles: [values[1], values[2]],
        rope_rate: values[3],
        rates: [values[4], values[5]],
        covariance,
        climber_from_volant: Isometry3::from_parts(
            position.into(),
            into_climber * state.attitude * imu_from_volant.rotation,
        ),
        linear_velocity,
        angular_velocity: into_climber * (state.attitude * motion.angular_velocity - turn),
    }
}

/// Covariance of the values, calibration errors and the gyroscope's noise included.
fn covariance(state: &State, jacobian: &SMatrix<f64, 6, N>, settings: &Settings) -> Matrix6<f64> {
    let by_rate = jacobian.fixed_columns::<3>(GYROSCOPE_BIAS);
    let mut p = jacobian * state.covariance * jacobian.transpose()
        + by_rate * by_rate.transpose() * settings.rate_variance();
    let sensitivity: SMatrix<f64, 6, PARAMETERS> =
        jacobian * state.sensitivity.map(f64::from).transpose();
    p += settings.calibration.spread(&sensitivity, &state.calibration);
    (p + p.transpose()) * 0.5
}
