//! Noise of an image's markers: of their centroids, of the stamp, of the layout, and what a
//! first-order update leaves out.

use super::{
    geometry::Geometry,
    marker_prediction::{Linearization, size_derivative},
    markers::{Block, ByCalibration, Image, Residual},
};
use crate::ekf::{
    calibration::OFFSETS,
    consider::MARKERS,
    propagation::ImuReading,
    state::{ATTITUDE, State},
};
use nalgebra::{Matrix2, SVector};

/// Returns the covariance that the uncertain places of the markers add to the residuals.
pub fn layout_spread(state: &State, by_parameter: &ByCalibration) -> Block {
    let by_offset = by_parameter.fixed_columns::<OFFSETS>(MARKERS);
    by_offset * state.calibration.offset_covariance() * by_offset.transpose()
}

/// Returns the covariance of the centroids of an image: their own, and what the motion makes of the
/// error of its stamp; without an IMU also what the first order leaves out. Of a marker that is
/// absent it is the identity.
pub fn measurement_noise(
    state: &State,
    geometry: &Geometry,
    linear: &Linearization,
    image: &Image,
    reading: &ImuReading,
) -> Block {
    let mut motion = SVector::<f64, 9>::zeros();
    let rate = state.attitude * state.motion(reading).angular_velocity;
    motion.fixed_rows_mut::<3>(0).copy_from(&state.velocity);
    motion.fixed_rows_mut::<3>(3).copy_from(&rate);
    motion.fixed_rows_mut::<3>(6).copy_from(&state.climber_rate);
    let moved = linear.jacobian * motion * f64::from(image.stamp_sigma);
    let mut noise = moved * moved.transpose();
    for (i, pixel) in image.pixels().iter().enumerate() {
        let mut own = noise.fixed_view_mut::<2, 2>(2 * i, 2 * i);
        own += pixel.as_ref().map_or(Matrix2::identity(), |(_, covariance)| *covariance);
    }
    if image.without_imu {
        noise += curvature_noise(state, &size_derivative(linear, geometry));
    }
    noise
}

/// Returns the covariance of what a first-order update leaves out of the attitude's error: turned by
/// an angle `φ` of variance `σ²` a marker's arm is shorter by `φ²/2`, in the mean square by `¾ σ⁴`.
/// The two directions in the image are shortened by two rotations.
///
/// Without an IMU an image is compared with an attitude that is known to ten degrees. From straight
/// above, tilt shows in the second order only; the update would decide for one of two mirrored poses
/// and be sure of it.
fn curvature_noise(state: &State, by_size: &Residual) -> Block {
    let variance = |i: usize| state.covariance[(ATTITUDE + i, ATTITUDE + i)];
    let variance = variance(0).max(variance(1)).max(variance(2));
    let along = |direction: usize| {
        Residual::from_fn(|row, _| if row % 2 == direction { by_size[row] } else { 0.0 })
    };
    let [x, y] = [along(0), along(1)];
    (x * x.transpose() + y * y.transpose()) * (0.75 * variance * variance)
}
