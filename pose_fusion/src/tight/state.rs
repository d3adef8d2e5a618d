//! The state of the error-state filter, its error and their composition.
//!
//! | index | error | unit | of |
//! | --- | --- | --- | --- |
//! | 0–2 | δp | m | position of the inertial unit, world |
//! | 3–5 | δv | m/s | its velocity, world |
//! | 6–8 | δθ | rad | attitude `world_from_imu`: `R_true = Exp(δθ) R`, a rotation about **world-fixed** axes |
//! | 9–11 | δb_a | m/s² | accelerometer bias, imu axes |
//! | 12–14 | δb_g | rad/s | gyroscope bias, imu axes |
//! | 15–17 | δc | m, m, rad | x, y and turn of the climber |
//! | 18–20 | δċ | per s | their rates |
//! | 21–23 | δc̈ | per s² | their accelerations |
//! | 24 | δτ_c | s | camera clock: an image stamped t was taken at t + τ_c of the inertial unit's clock |
//!
//! A reading of the climber stamped t was taken at t + τ_c + d. The offset d is no part of the state: a filter takes it as
//! given, and beside it finds how much another one would change (see [`super::tie`]).
//!
//! **Which instant.** The nominal state lives on the inertial unit's clock, its error on the camera's: δp compares the truth and
//! the estimate at the instant that a camera's stamp names, wherever that is on the inertial unit's clock. The clock
//! offset then drops out of the images' equations and enters with the inertial samples, whose changes are measured; the other
//! way round it is multiplied by the velocity, which nobody knows at the start, and an extended Kalman filter makes up
//! information from that product. The error at the inertial unit's time, which is the one published, is `δx − ẋ δτ_c`.
//!
//! The attitude's error is on the world's side because that is what ROS' pose covariance means, and because the error
//! dynamics are then free of the rate of turn (Solà, "Quaternion kinematics for the error-state Kalman filter",
//! section 7, global angular error).

use super::{
    propagate::{Felt, retime},
    systematic::ByPixel,
    tie::Tie,
};
use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3};

/// Dimension of the error.
pub const N: usize = 25;
/// First index of the position.
pub const POSITION: usize = 0;
/// First index of the velocity.
pub const VELOCITY: usize = 3;
/// First index of the attitude.
pub const ATTITUDE: usize = 6;
/// First index of the accelerometer's bias.
pub const ACCELEROMETER: usize = 9;
/// First index of the gyroscope's bias.
pub const GYROSCOPE: usize = 12;
/// First index of the climber's x, y, turn.
pub const CLIMBER: usize = 15;
/// First index of their rates.
pub const CLIMBER_RATE: usize = 18;
/// First index of their accelerations.
pub const CLIMBER_ACCELERATION: usize = 21;
/// Index of the camera's clock.
pub const CAMERA_CLOCK: usize = 24;

/// Covariance of the error.
pub type Covariance = SMatrix<f64, N, N>;
/// An error.
pub type Error = SVector<f64, N>;

/// The nominal state with its covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Position of the inertial unit, world, m.
    pub position: Vector3<f64>,
    /// Its velocity, world, m/s.
    pub velocity: Vector3<f64>,
    /// Attitude, `world_from_imu`.
    pub attitude: UnitQuaternion<f64>,
    /// Accelerometer bias, imu axes, m/s².
    pub accelerometer_bias: Vector3<f64>,
    /// Gyroscope bias, imu axes, rad/s.
    pub gyroscope_bias: Vector3<f64>,
    /// x, y (m) and turn (rad) of the climber.
    pub climber: Vector3<f64>,
    /// Their rates.
    pub climber_rate: Vector3<f64>,
    /// Their accelerations.
    pub climber_acceleration: Vector3<f64>,
    /// Camera clock offset τ_c, s.
    pub camera_clock: f64,
    /// Covariance of the error.
    pub covariance: Covariance,
    /// What is found of the climber's clock.
    pub tie: Tie,
    /// By how much it would differ, per pixel of the constant offsets of the markers' centroids.
    pub by_pixel: ByPixel,
    /// For how long no marker has corrected it, s.
    pub unseen: f64,
}

impl State {
    /// All zero, with no uncertainty.
    pub fn zero() -> Self {
        Self {
            position: Vector3::zeros(),
            velocity: Vector3::zeros(),
            attitude: UnitQuaternion::identity(),
            accelerometer_bias: Vector3::zeros(),
            gyroscope_bias: Vector3::zeros(),
            climber: Vector3::zeros(),
            climber_rate: Vector3::zeros(),
            climber_acceleration: Vector3::zeros(),
            camera_clock: 0.0,
            covariance: Covariance::zeros(),
            tie: Tie::none(),
            by_pixel: ByPixel::zeros(),
            unseen: 0.0,
        }
    }

    /// Adds an error to the nominal state (⊞); the covariance stays.
    pub fn add(&mut self, error: &Error) {
        let three = |i: usize| Vector3::new(error[i], error[i + 1], error[i + 2]);
        self.position += three(POSITION);
        self.velocity += three(VELOCITY);
        self.attitude = UnitQuaternion::from_scaled_axis(three(ATTITUDE)) * self.attitude;
        self.attitude.renormalize_fast();
        self.accelerometer_bias += three(ACCELEROMETER);
        self.gyroscope_bias += three(GYROSCOPE);
        self.climber += three(CLIMBER);
        self.climber_rate += three(CLIMBER_RATE);
        self.climber_acceleration += three(CLIMBER_ACCELERATION);
        self.camera_clock += error[CAMERA_CLOCK];
    }

    /// What it would be with the climber's clock further off by `seconds`; `felt` is what the unit felt then.
    pub fn recentre(&mut self, seconds: f64, felt: &Felt, gravity: f64) {
        let by_offset = self.tie.by_offset;
        self.add(&(by_offset * seconds));
        retime(self, felt, by_offset[CAMERA_CLOCK] * seconds, gravity);
        self.tie.recentre(seconds);
    }

    /// `self ⊟ other`: the error that leads from `other` to `self`.
    pub fn minus(&self, other: &State) -> Error {
        let mut e = Error::zeros();
        let mut put = |i: usize, v: Vector3<f64>| e.fixed_rows_mut::<3>(i).copy_from(&v);
        put(POSITION, self.position - other.position);
        put(VELOCITY, self.velocity - other.velocity);
        put(ATTITUDE, (self.attitude * other.attitude.inverse()).scaled_axis());
        put(ACCELEROMETER, self.accelerometer_bias - other.accelerometer_bias);
        put(GYROSCOPE, self.gyroscope_bias - other.gyroscope_bias);
        put(CLIMBER, self.climber - other.climber);
        put(CLIMBER_RATE, self.climber_rate - other.climber_rate);
        put(CLIMBER_ACCELERATION, self.climber_acceleration - other.climber_acceleration);
        e[CAMERA_CLOCK] = self.camera_clock - other.camera_clock;
        e
    }

    /// Is every number finite, and every variance not negative?
    pub fn is_sound(&self) -> bool {
        self.position.iter().chain(self.velocity.iter()).all(|x| x.is_finite())
            && self.attitude.coords.iter().all(|x| x.is_finite())
            && (0..N).all(|i| self.covariance[(i, i)] >= 0.0 && self.covariance[(i, i)].is_finite())
    }

    /// Sets the variances of three entries and clears what they share with the others.
    pub fn set_variance(&mut self, first: usize, sigma: &Vector3<f64>) {
        for i in 0..3 {
            self.set_variance_of(first + i, sigma[i] * sigma[i]);
        }
    }

    /// Sets the variance of one entry and clears what it shares with the others.
    pub fn set_variance_of(&mut self, index: usize, variance: f64) {
        self.covariance.row_mut(index).fill(0.0);
        self.covariance.column_mut(index).fill(0.0);
        self.covariance[(index, index)] = variance;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn minus_is_the_inverse_of_add() {
        let mut a = State::zero();
        a.attitude = UnitQuaternion::from_euler_angles(0.3, -0.2, 1.1);
        let error = Error::from_fn(|i, _| 0.01 * (i as f64 + 1.0) * if i % 2 == 0 { 1.0 } else { -1.0 });
        let mut b = a.clone();
        b.add(&error);
        assert!((b.minus(&a) - error).norm() < 1e-12);
    }
}
