//! Odometry of the platform from the state of the IMU, with its covariances.
//!
//! With `t` the IMU's position on the platform and `ω` its angular velocity (volant axes):
//! `p_v = p − R_v t`, `δp_v = δp + [R_v t]× δθ`; the velocity in the volant frame is
//! `R_vᵀ v − ω × t`, its error `R_vᵀ δv + R_vᵀ [v]× δθ + [t]× δω` with `δω = R_vi (n_g − δb_g)`.

use super::Odometry;
use crate::{
    ekf::{
        consider::{self, PARAMETERS, TIME_OFFSET_ERROR, Uncertainty},
        propagation::ImuReading,
        state::{ATTITUDE, GYROSCOPE_BIAS, POSITION, State, TIME_OFFSET, VELOCITY},
    },
    measurements::geometry::Geometry,
};
use nalgebra::{Isometry3, Matrix3, Matrix6, SMatrix, SVector, Vector3};
use rig_model::Stamp;
use std::ops::AddAssign;

/// Entries of the error that the odometry consists of.
const USED: [usize; 4] = [POSITION, VELOCITY, ATTITUDE, GYROSCOPE_BIAS];

/// What the odometry is computed with beside the state.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// White noise of the gyroscope per sample, (rad/s)².
    pub rate_variance: f64,
    /// Gravity, m/s².
    pub gravity: f64,
    /// Variances of the consider parameters.
    pub calibration: Uncertainty,
    /// The IMU is silent: how fast the platform moves is known from images alone.
    pub silent: bool,
}

/// Changes of velocity, m/s, and angular velocity, rad/s, that images alone may miss.
const UNSEEN_MOTION: [f64; 2] = [0.3, 0.5];

impl Settings {
    /// Returns the variance of the angular velocity beside the gyroscope bias', (rad/s)². While
    /// the IMU is silent, the platform is assumed not to turn: what it may turn is added.
    pub fn rate_variance(&self) -> f64 {
        self.rate_variance + if self.silent { UNSEEN_MOTION[1].powi(2) } else { 0.0 }
    }
}

/// Returns the odometry of a state at `stamp`.
pub fn odometry(
    stamp: Stamp,
    state: &State,
    reading: &ImuReading,
    geometry: &Geometry,
    settings: &Settings,
) -> Odometry {
    let world_from_imu = Isometry3::from_parts(state.position.into(), state.attitude);
    let world_from_volant = world_from_imu * geometry.imu_from_volant;
    let motion = state.motion(reading);
    let rv = world_from_volant.rotation.to_rotation_matrix();
    let rv: &Matrix3<f64> = rv.matrix();
    let lever = geometry.volant_from_imu.translation.vector;
    let volant_from_imu = geometry.volant_from_imu.rotation.to_rotation_matrix();
    let angular_velocity = volant_from_imu * motion.angular_velocity;
    let linear_velocity = rv.transpose() * state.velocity - angular_velocity.cross(&lever);

    let p = covariance_at_imu_time(state, reading, settings);
    let mut pose = SMatrix::<f64, 6, 12>::zeros();
    pose.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    pose.fixed_view_mut::<3, 3>(0, 6).copy_from(&(rv * lever).cross_matrix());
    pose.fixed_view_mut::<3, 3>(3, 6).fill_with_identity();
    let lever_cross = lever.cross_matrix();
    let by_bias: Matrix3<f64> = -*volant_from_imu.matrix();
    let mut twist = SMatrix::<f64, 6, 12>::zeros();
    twist.fixed_view_mut::<3, 3>(0, 3).copy_from(&rv.transpose());
    twist.fixed_view_mut::<3, 3>(0, 6).copy_from(&(rv.transpose() * state.velocity.cross_matrix()));
    twist.fixed_view_mut::<3, 3>(0, 9).copy_from(&(lever_cross * by_bias));
    twist.fixed_view_mut::<3, 3>(3, 9).copy_from(&by_bias);
    let symmetric = |m: Matrix6<f64>| (m + m.transpose()) * 0.5;
    let mut white = SMatrix::<f64, 6, 3>::zeros();
    white.fixed_view_mut::<3, 3>(0, 0).copy_from(&lever_cross);
    white.fixed_view_mut::<3, 3>(3, 0).fill_with_identity();
    Odometry {
        stamp,
        world_from_volant,
        pose_covariance: symmetric(pose * p * pose.transpose()),
        linear_velocity,
        angular_velocity,
        twist_covariance: symmetric(
            twist * p * twist.transpose() + white * white.transpose() * settings.rate_variance(),
        ),
    }
}

/// Covariance of the used entries at IMU time, `δx − ẋ δτ`, calibration errors included.
fn covariance_at_imu_time(
    state: &State,
    reading: &ImuReading,
    settings: &Settings,
) -> SMatrix<f64, 12, 12> {
    let mut p = SMatrix::<f64, 12, 12>::zeros();
    let mut with_offset = SVector::<f64, 12>::zeros();
    let mut sensitivity = SMatrix::<f64, 12, PARAMETERS>::zeros();
    for (a, &i) in USED.iter().enumerate() {
        for (b, &j) in USED.iter().enumerate() {
            p.fixed_view_mut::<3, 3>(3 * a, 3 * b)
                .copy_from(&state.covariance.fixed_view::<3, 3>(i, j));
        }
        with_offset
            .fixed_rows_mut::<3>(3 * a)
            .copy_from(&state.covariance.fixed_view::<3, 1>(i, TIME_OFFSET));
        let columns = state.sensitivity.fixed_columns::<3>(i).map(f64::from);
        sensitivity.fixed_rows_mut::<3>(3 * a).copy_from(&columns.transpose());
    }
    let rates = state.rates(reading, settings.gravity);
    let motion = SVector::<f64, 12>::from_fn(|k, _| rates[USED[k / 3] + k % 3]);
    let offset = state.covariance[(TIME_OFFSET, TIME_OFFSET)];
    p += motion * motion.transpose() * offset
        - with_offset * motion.transpose()
        - motion * with_offset.transpose();
    if settings.silent {
        let offset = offset + settings.calibration.variances[TIME_OFFSET_ERROR];
        for axis in 0..3 {
            p[(axis, axis)] += UNSEEN_MOTION[0].powi(2) * offset;
            p[(6 + axis, 6 + axis)] += UNSEEN_MOTION[1].powi(2) * offset;
        }
    }
    sensitivity -= motion * consider::of_entry(&state.sensitivity, TIME_OFFSET).transpose();
    let rails = Vector3::from_element(settings.calibration.rails);
    p += settings.calibration.spread(&sensitivity, &state.calibration);
    p.fixed_view_mut::<3, 3>(0, 0).add_assign(Matrix3::from_diagonal(&rails));
    p
}
