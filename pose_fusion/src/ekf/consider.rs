//! Consider parameters: constant errors of the rig's calibration that widen the covariance and do
//! not change the estimate. Constants that images and IMU do observe are estimated with the same
//! sensitivity ([`super::calibration`]). Equations: `docs/src/equations.md`, "Consider parameters".

use super::{
    calibration::{self, CONSTANTS, Calibration, OFFSETS},
    state::{Error, N, TIME_OFFSET},
};
use crate::config::CalibrationSigmas;
use nalgebra::{SMatrix, SVector};
use rig_model::MarkerLayout;

/// Number of consider parameters.
pub const PARAMETERS: usize = 27;
/// Relative error of the focal length.
pub const FOCAL: usize = 0;
/// First of three rotations of the camera mounting about the camera's axes, rad.
pub const MOUNTING: usize = 1;
/// Relative error of the x and y encoders' scale.
pub const ENCODER_SCALE: usize = 4;
/// Offset of the climber's stamps, s.
pub const CLIMBER_OFFSET: usize = 5;
/// Error of the camera time offset while it is searched, s; the gains assume a small one.
pub const TIME_OFFSET_ERROR: usize = 6;
/// First of the constants that are estimated ([`super::calibration`]): first those of the IMU.
pub const ESTIMATED: usize = 7;
/// First of eight constants of the marker layout: x and y of red, green, blue, yellow.
pub const MARKERS: usize = ESTIMATED + calibration::MARKERS;

/// Relative error of the layout's size, in [`FileErrors`].
pub const SIZE: usize = TIME_OFFSET_ERROR;
/// Share of an error that images usually show (of stamps 0.07 s late 0.045 s, of 1 % of the focal
/// length 0.9 %); of stamps wrong by 0.4 s only a third.
const FOUND: f64 = 0.5;
/// Number of errors of the rig's files.
pub const FILE_ERRORS: usize = SIZE + 1;

/// Errors of the rig's files: focal length (relative), rotations of the mounting about the camera's
/// axes (rad), encoder scale (relative), climber stamps (s), size of the layout (relative).
pub type FileErrors = SVector<f64, FILE_ERRORS>;
/// Sensitivity of the error state to each parameter, transposed: one row for each parameter, one
/// column for each entry of the error. Single precision: it widens a covariance and moves the state
/// by its own corrections only.
pub type Sensitivity = SMatrix<f32, PARAMETERS, N>;
/// Derivative of a scalar measurement by each consider parameter.
pub type ByParameter = SVector<f64, PARAMETERS>;

/// Configured uncertainty of the consider parameters.
#[derive(Clone, Copy, Debug, Default)]
pub struct Uncertainty {
    /// Variance of each, in the order of the rows of [`Sensitivity`].
    pub variances: ByParameter,
    /// What an error of the layout's size, 1 sigma, moves the markers' centers by, m.
    size: SVector<f64, OFFSETS>,
    /// Variance of the climber's position on its rails, each axis, m²: the pose is off by as much.
    pub rails: f64,
}

impl Uncertainty {
    /// Returns the uncertainty of the parameters of a rig with these markers.
    pub fn new(sigmas: &CalibrationSigmas, markers: &MarkerLayout) -> Self {
        let mut variances = ByParameter::zeros();
        variances[FOCAL] = sigmas.focal_length.powi(2);
        variances.fixed_rows_mut::<3>(MOUNTING).fill(sigmas.mounting.powi(2));
        variances[ENCODER_SCALE] = sigmas.encoder_scale.powi(2);
        variances[CLIMBER_OFFSET] = sigmas.climber_offset.powi(2);
        variances.fixed_rows_mut::<OFFSETS>(MARKERS).fill(sigmas.marker.powi(2));
        Self { variances, size: size(sigmas.layout, markers), rails: sigmas.rails.powi(2) }
    }

    /// Multiplies every standard deviation by a factor.
    pub fn scale(&mut self, factor: f64) {
        self.variances *= factor * factor;
        self.size *= factor;
        self.rails *= factor * factor;
    }

    /// Widens the standard deviations to twice the errors that images show.
    pub fn open(&mut self, shown: &FileErrors, markers: &MarkerLayout) {
        let sigmas = shown / FOUND;
        for (variance, sigma) in self.variances.iter_mut().zip(&sigmas.fixed_rows::<SIZE>(0)) {
            *variance = variance.max(sigma * sigma);
        }
        let size = size(sigmas[SIZE], markers);
        if size.norm() > self.size.norm() {
            self.size = size;
        }
    }

    /// Returns the covariance `V Σ Vᵀ` of values with the sensitivity `by` to the parameters, what
    /// is known of the estimated ones included.
    pub fn spread<const M: usize>(
        &self,
        by: &SMatrix<f64, M, PARAMETERS>,
        calibration: &Calibration,
    ) -> SMatrix<f64, M, M> {
        let by_constants = by.fixed_columns::<CONSTANTS>(ESTIMATED);
        let mut spread = by_constants * calibration.covariance() * by_constants.transpose();
        for (column, variance) in by.column_iter().zip(&self.variances) {
            if *variance > 0.0 {
                spread += column * column.transpose() * *variance;
            }
        }
        let by_size = by.fixed_columns::<OFFSETS>(MARKERS) * self.size;
        spread + by_size * by_size.transpose()
    }
}

/// Returns what a relative error of the layout's size moves the markers' centers by, m.
pub fn size(error: f64, markers: &MarkerLayout) -> SVector<f64, OFFSETS> {
    SVector::from_fn(|k, _| error * markers.centers.0[k / 2].coords[k % 2])
}

/// Returns the sensitivity of one entry of the error to each parameter.
pub fn of_entry(sensitivity: &Sensitivity, index: usize) -> ByParameter {
    sensitivity.column(index).map(f64::from)
}

/// Returns the sensitivity of the error to the estimated constants.
pub fn of_constants(sensitivity: &Sensitivity) -> SMatrix<f64, N, CONSTANTS> {
    sensitivity.fixed_rows::<CONSTANTS>(ESTIMATED).map(f64::from).transpose()
}

/// Corrects the sensitivity for a scalar update: `V ← V − k (h V + e)`.
///
/// `gain` is the Kalman gain `k` and `residual` the row `h V + e`.
pub fn correct(sensitivity: &mut Sensitivity, gain: &Error, residual: &ByParameter) {
    let residual = residual.map(|x| x as f32);
    sensitivity.ger(-1.0, &residual, &gain.map(|k| k as f32), 1.0);
    // What the filter finds of a large error by itself counts once the alignment confirms it.
    sensitivity[(TIME_OFFSET_ERROR, TIME_OFFSET)] = 1.0;
}
