//! From the state of the inertial unit to the odometry of the platform, with its covariances.
//!
//! With `t` the unit's place on the platform and `ω` its rate of turn (volant axes): `p_v = p − R_v t`,
//! `δp_v = δp + [R_v t]× δθ`; the velocity in the volant frame is `R_vᵀ v − ω × t`, its error
//! `R_vᵀ δv + R_vᵀ [v]× δθ + [t]× δω` with `δω = R_vi (n_g − δb_g)`.

use super::{
    geometry::Geometry,
    propagate::Felt,
    state::{ATTITUDE, CAMERA_CLOCK, GYROSCOPE, POSITION, State, VELOCITY},
};
use crate::output::Odometry;
use nalgebra::{Isometry3, Matrix3, Matrix6, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};
use rig_model::Stamp;

/// Entries of the error that the odometry is made of: position, velocity, attitude, gyroscope bias.
const USED: [usize; 4] = [POSITION, VELOCITY, ATTITUDE, GYROSCOPE];

/// What the odometry is made with beside the state.
#[derive(Clone, Copy, Debug)]
pub struct Along {
    /// The gyroscope's white noise per sample, (rad/s)².
    pub rate_variance: f64,
    /// m/s².
    pub gravity: f64,
    /// What is thought of the climber's clock beyond what the state takes as given: mean, s, and variance, s².
    pub climber_clock: (f64, f64),
    /// Constant offset of the markers' centroids, each axis, px (1 sigma).
    pub systematic: f64,
}

/// The odometry of a state.
pub fn odometry(stamp: Stamp, state: &State, felt: &Felt, geometry: &Geometry, along: &Along) -> Odometry {
    let Along { rate_variance, gravity, climber_clock: (offset, doubt), systematic } = *along;
    let world_from_imu = Isometry3::from_parts(state.position.into(), state.attitude);
    let world_from_volant = world_from_imu * geometry.imu_from_volant;
    let rv = world_from_volant.rotation.to_rotation_matrix();
    let rv: &Matrix3<f64> = rv.matrix();
    let lever = geometry.volant_from_imu.translation.vector;
    let volant_from_imu = geometry.volant_from_imu.rotation.to_rotation_matrix();
    let angular_velocity = volant_from_imu * (felt.rate - state.gyroscope_bias);
    let linear_velocity = rv.transpose() * state.velocity - angular_velocity.cross(&lever);

    let mut p = SMatrix::<f64, 12, 12>::zeros();
    for (a, &i) in USED.iter().enumerate() {
        for (b, &j) in USED.iter().enumerate() {
            p.fixed_view_mut::<3, 3>(3 * a, 3 * b).copy_from(&state.covariance.fixed_view::<3, 3>(i, j));
        }
    }
    // From the camera's time to the inertial unit's: δx − ẋ δτ.
    let force = state.attitude * (felt.force - state.accelerometer_bias);
    let acceleration = force - Vector3::new(0.0, 0.0, gravity);
    let rate = state.attitude * (felt.rate - state.gyroscope_bias);
    let mut motion = SVector::<f64, 12>::zeros();
    motion.fixed_rows_mut::<3>(0).copy_from(&state.velocity);
    motion.fixed_rows_mut::<3>(3).copy_from(&acceleration);
    motion.fixed_rows_mut::<3>(6).copy_from(&rate);
    let mut with_clock = SVector::<f64, 12>::zeros();
    for (a, &i) in USED.iter().enumerate() {
        with_clock
            .fixed_rows_mut::<3>(3 * a)
            .copy_from(&state.covariance.fixed_view::<3, 1>(i, CAMERA_CLOCK));
    }
    let clock = state.covariance[(CAMERA_CLOCK, CAMERA_CLOCK)];
    p += motion * motion.transpose() * clock
        - with_clock * motion.transpose()
        - motion * with_clock.transpose();
    let mut pose = SMatrix::<f64, 6, 12>::zeros();
    pose.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
    pose.fixed_view_mut::<3, 3>(0, 6).copy_from(&(rv * lever).cross_matrix());
    pose.fixed_view_mut::<3, 3>(3, 6).copy_from(&Matrix3::identity());
    let lever_cross = lever.cross_matrix();
    let by_bias: Matrix3<f64> = -*volant_from_imu.matrix();
    let mut twist = SMatrix::<f64, 6, 12>::zeros();
    twist.fixed_view_mut::<3, 3>(0, 3).copy_from(&rv.transpose());
    twist.fixed_view_mut::<3, 3>(0, 6).copy_from(&(rv.transpose() * state.velocity.cross_matrix()));
    twist.fixed_view_mut::<3, 3>(0, 9).copy_from(&(lever_cross * by_bias));
    twist.fixed_view_mut::<3, 3>(3, 9).copy_from(&by_bias);
    // By how much it would differ, per second of the climber's clock: δx − ẋ δτ as well.
    let mut by_offset = motion * -state.tie.by_offset[CAMERA_CLOCK];
    for (a, &i) in USED.iter().enumerate() {
        let mut rows = by_offset.fixed_rows_mut::<3>(3 * a);
        rows += state.tie.by_offset.fixed_rows::<3>(i);
    }
    p += by_offset * by_offset.transpose() * doubt;
    // And per pixel of the markers' constant offsets.
    let mut by_pixel = motion * -state.by_pixel.row(CAMERA_CLOCK);
    for (a, &i) in USED.iter().enumerate() {
        let mut rows = by_pixel.fixed_rows_mut::<3>(3 * a);
        rows += state.by_pixel.fixed_rows::<3>(i);
    }
    p += by_pixel * by_pixel.transpose() * systematic.powi(2);
    let (moved, driven) = (pose * by_offset * offset, twist * by_offset * offset);
    let symmetric = |m: Matrix6<f64>| (m + m.transpose()) * 0.5;
    let mut white = SMatrix::<f64, 6, 3>::zeros();
    white.fixed_view_mut::<3, 3>(0, 0).copy_from(&lever_cross);
    white.fixed_view_mut::<3, 3>(3, 0).copy_from(&Matrix3::identity());
    Odometry {
        stamp,
        world_from_volant: Isometry3::from_parts(
            Translation3::from(world_from_volant.translation.vector + moved.fixed_rows::<3>(0)),
            UnitQuaternion::from_scaled_axis(moved.fixed_rows::<3>(3).into_owned())
                * world_from_volant.rotation,
        ),
        pose_covariance: symmetric(pose * p * pose.transpose()),
        linear_velocity: linear_velocity + driven.fixed_rows::<3>(0),
        angular_velocity: angular_velocity + driven.fixed_rows::<3>(3),
        twist_covariance: symmetric(
            twist * p * twist.transpose() + white * white.transpose() * rate_variance,
        ),
    }
}
