//! Noise of an image's markers: of their centroids, of the stamp, of the layout.

use super::{
    marker_prediction::Linearization,
    markers::{Block, ByCalibration, Image},
};
use crate::ekf::{calibration::OFFSETS, consider::MARKERS, propagation::ImuReading, state::State};
use nalgebra::{Matrix2, SVector};

/// Returns the covariance that the uncertain places of the markers add to the residuals.
pub fn layout_spread(state: &State, by_parameter: &ByCalibration) -> Block {
    let by_offset = by_parameter.fixed_columns::<OFFSETS>(MARKERS);
    by_offset * state.calibration.offset_covariance() * by_offset.transpose()
}

/// Returns the covariance of the centroids of an image: their own, and what the motion makes of the
/// error of its stamp. Of a marker that is absent it is the identity.
pub fn measurement_noise(
    state: &State,
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
    noise
}
