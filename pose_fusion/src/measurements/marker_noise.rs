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

#[cfg(test)]
mod tests {
    use super::{
        super::{
            marker_prediction::linearize,
            markers::tests::{READING, example},
        },
        *,
    };

    #[test]
    fn only_without_an_imu_a_wide_attitude_adds_noise_and_by_the_fourth_power_of_its_sigma() {
        let (mut state, geometry, mut image) = example();
        let mut noise = |sigma: f64, without_imu: bool| {
            for i in 0..3 {
                state.set_sigma(ATTITUDE + i, sigma);
            }
            image.without_imu = without_imu;
            let linear = linearize(&state, &geometry, &image, &READING);
            let arms = size_derivative(&linear, &geometry);
            (measurement_noise(&state, &geometry, &linear, &image, &READING), arms)
        };
        let (plain, arms) = noise(0.2, false);
        let (wide, _) = noise(0.2, true);
        let (narrow, _) = noise(0.1, true);
        for row in 0..8 {
            let added = wide[(row, row)] - plain[(row, row)];
            let expected = 0.75 * 0.2f64.powi(4) * arms[row] * arms[row];
            assert!((added - expected).abs() < 1e-9 && added >= 0.0, "{row}: {added} {expected}");
            let less = narrow[(row, row)] - plain[(row, row)];
            assert!((added - 16.0 * less).abs() < 1e-6, "{row}: {added} {less}");
        }
        assert!((wide - plain).trace() > 1.0);
    }
}
