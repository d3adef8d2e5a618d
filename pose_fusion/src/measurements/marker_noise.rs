//! Noise of an image's markers: of their centroids, of the stamp, of the layout.

use super::{
    marker_prediction::Linearization,
    markers::{Block, ByCalibration, Image},
};
use crate::ekf::{calibration::OFFSETS, consider::MARKERS, state::State};
use nalgebra::{Matrix2, Vector2};

/// Returns the covariance that the uncertain places of the markers add to the residuals.
pub fn layout_spread(state: &State, by_parameter: &ByCalibration) -> Block {
    let by_offset = by_parameter.fixed_columns::<OFFSETS>(MARKERS);
    by_offset * state.calibration.offset_covariance() * by_offset.transpose()
}

/// Returns the covariance of the centroids of an image: their own, what the motion makes of the
/// error of its stamp, and the shake of the camera. Of a marker that is absent it is the identity.
pub fn measurement_noise(linear: &Linearization, image: &Image) -> Block {
    let moved = linear.velocity * f64::from(image.stamp_sigma);
    let mut noise = moved * moved.transpose();
    for (axis, variance) in image.shake.iter().enumerate() {
        for i in (axis..8).step_by(2) {
            (axis..8).step_by(2).for_each(|j| noise[(i, j)] += f64::from(*variance));
        }
    }
    for (i, pixel) in image.pixels().iter().enumerate() {
        let mut own = noise.fixed_view_mut::<2, 2>(2 * i, 2 * i);
        own += pixel.as_ref().map_or(Matrix2::identity(), |(_, covariance)| *covariance);
    }
    noise
}

/// Returns the variance of the mean of an image's markers, without the shake of the camera.
pub fn mean_variance(noise: &Block, image: &Image) -> Vector2<f64> {
    let detected = || (0..4).filter(|i| image.has(*i));
    let count = detected().count().max(1) as f64;
    Vector2::from_fn(|axis, _| {
        let row = |i: usize| detected().map(move |j| noise[(2 * i + axis, 2 * j + axis)]);
        let sum: f64 = detected().flat_map(row).sum();
        sum / (count * count) - f64::from(image.shake[axis])
    })
}
