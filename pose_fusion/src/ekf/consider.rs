//! Consider parameters: constant errors of the rig's calibration that widen the covariance and are not estimated.
//!
//! Twelve seconds of swing cannot tell most of these errors from tilt, bias or height, so the filter takes the files as
//! exact when it computes its gains (Schmidt 1966). Beside the estimate it carries the sensitivity `V = ∂δx/∂θ` of the
//! estimation error to each parameter θ (Friedland 1969): `V ← F V` in a propagation, `V ← V − K (H V + E)` in an update
//! with `E = ∂z/∂θ`. The published covariance is `P + V Σ Vᵀ` with `Σ` the configured variances.

use super::state::{Error, N};
use crate::config::CalibrationSigmas;
use nalgebra::{SMatrix, SVector};

/// Number of consider parameters.
pub const PARAMETERS: usize = 15;
/// First of eight constant centroid offsets: x and y of red, green, blue, yellow, px.
pub const CENTROID: usize = 0;
/// Relative error of the focal length.
pub const FOCAL: usize = 8;
/// Relative error of the marker layout's size.
pub const LAYOUT: usize = 9;
/// First of three rotations of the camera mounting about the camera's axes, rad.
pub const MOUNTING: usize = 10;
/// Relative error of the x and y encoders' scale.
pub const ENCODER_SCALE: usize = 13;
/// Offset of the climber's stamps, s.
pub const CLIMBER_OFFSET: usize = 14;

/// Sensitivity of the error state to each consider parameter, one column each.
pub type Sensitivity = SMatrix<f64, N, PARAMETERS>;
/// Derivative of a scalar measurement by each consider parameter.
pub type ByParameter = SVector<f64, PARAMETERS>;

/// Variance of each consider parameter, in the order of the columns of [`Sensitivity`].
pub fn variances(sigmas: &CalibrationSigmas) -> ByParameter {
    let mut variances = ByParameter::zeros();
    for k in 0..8 {
        variances[CENTROID + k] = sigmas.centroid.powi(2);
    }
    variances[FOCAL] = sigmas.focal_length.powi(2);
    variances[LAYOUT] = sigmas.layout.powi(2);
    for axis in 0..3 {
        variances[MOUNTING + axis] = sigmas.mounting.powi(2);
    }
    variances[ENCODER_SCALE] = sigmas.encoder_scale.powi(2);
    variances[CLIMBER_OFFSET] = sigmas.climber_offset.powi(2);
    variances
}

/// Corrects the sensitivity for a scalar update: `V ← V − k (h V + e)`.
///
/// `gain` is the Kalman gain `k`, `by_state` the row `h V` and `by_parameter` the row `e`.
pub fn correct(
    sensitivity: &mut Sensitivity,
    gain: &Error,
    by_state: &ByParameter,
    by_parameter: &ByParameter,
) {
    for (k, mut column) in sensitivity.column_iter_mut().enumerate() {
        let residual = by_state[k] + by_parameter[k];
        if residual != 0.0 {
            column.axpy(-residual, gain, 1.0);
        }
    }
}
