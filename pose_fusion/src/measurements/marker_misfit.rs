//! What no pose explains of four markers: pixel noise, a false marker, or an error of their places
//! in the rig file.

use super::{
    geometry::Geometry,
    marker_prediction::{Linearization, by_calibration, linearize, times_error},
    markers::{Image, Offsets, Residual},
};
use crate::ekf::{
    calibration::OFFSETS,
    consider::MARKERS,
    propagation::ImuReading,
    state::{ATTITUDE, Error, POSITION, State},
};

/// Residual beyond which the projection is not linear: the misfit is found at the best pose, px.
const FAR: f64 = 2.0;
/// Largest number of linearizations; a best pose that is not found by then is not used.
const ITERATIONS: usize = 4;

/// What no pose explains of four markers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// Residuals after the best pose, in units of their covariance.
    pub whitened: Residual,
    /// The residuals as offsets of the markers' centers.
    pub offsets: Offsets,
}

impl Misfit {
    /// Returns the squared residuals: χ² with 8 − 6 degrees of freedom at any prediction.
    pub fn squared(&self) -> f64 {
        self.whitened.norm_squared()
    }

    /// Returns the factor on the pixels' variance with which the residuals are as expected.
    pub fn noise_factor(&self) -> f64 {
        self.squared() / 2.0
    }
}

/// Returns what no pose explains of an image; `None` without four markers.
pub fn misfit(
    state: &State,
    geometry: &Geometry,
    image: &Image,
    reading: &ImuReading,
    linear: &Linearization,
) -> Option<Misfit> {
    let (found, mut step) = misfit_at(state, geometry, image, linear)?;
    if linear.residual.amax() <= FAR {
        return Some(found);
    }
    let mut there = state.clone();
    for _ in 1..ITERATIONS {
        there.add(&step);
        let linear = linearize(&there, geometry, image, reading);
        let (found, next) = misfit_at(&there, geometry, image, &linear)?;
        if times_error(&linear.jacobian, &next).amax() <= FAR {
            return Some(found);
        }
        step = next;
    }
    None
}

/// Returns the misfit at a linearization, and the step of position and attitude to the best pose.
fn misfit_at(
    state: &State,
    geometry: &Geometry,
    image: &Image,
    linear: &Linearization,
) -> Option<(Misfit, Error)> {
    let by_offset = by_calibration(linear, geometry);
    let by_offset = by_offset.fixed_columns::<OFFSETS>(MARKERS);
    let mut covariance = by_offset * state.calibration.offset_covariance() * by_offset.transpose();
    for (i, pixel) in image.pixels().iter().enumerate() {
        let mut own = covariance.fixed_view_mut::<2, 2>(2 * i, 2 * i);
        own += pixel.as_ref()?.1;
    }
    let covariance = covariance.cholesky()?;
    let by_pose = linear.jacobian.fixed_columns::<6>(0).into_owned();
    let weighted = covariance.solve(&by_pose);
    let normal = by_pose.transpose() * weighted;
    let pose = normal.cholesky()?.solve(&(weighted.transpose() * linear.residual));
    let left = linear.residual - by_pose * pose;
    let mut offsets = Offsets::zeros();
    for i in 0..4 {
        let by_center = by_offset.fixed_view::<2, 2>(2 * i, 2 * i).try_inverse()?;
        let offset = by_center * left.fixed_rows::<2>(2 * i);
        offsets.fixed_rows_mut::<2>(2 * i).copy_from(&offset);
    }
    let mut step = Error::zeros();
    step.fixed_rows_mut::<3>(POSITION).copy_from(&pose.fixed_rows::<3>(0));
    step.fixed_rows_mut::<3>(ATTITUDE).copy_from(&pose.fixed_rows::<3>(3));
    let whitened = covariance.l().solve_lower_triangular(&left)?;
    Some((Misfit { whitened, offsets }, step))
}
