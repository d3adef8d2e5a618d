//! Measurements: each with its prediction, Jacobian, noise and gate.

pub mod encoders;
pub mod geometry;
pub mod marker_misfit;
pub mod marker_prediction;
mod marker_solution;
pub mod markers;
pub mod rope;
pub mod zero_velocity;

use nalgebra::{SMatrix, SVector};

/// What became of a measurement; with the numbers of `MarkerUpdate.msg`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Outcome {
    /// It corrected the state.
    Used,
    /// It was not measured (a marker that the tracker predicted or lost).
    NotDetected,
    /// Its own NIS exceeds the gate.
    Gated,
    /// It contradicts the other measurements of the same image.
    Inconsistent,
    /// The prediction lies outside of what the lens model covers.
    NotPredictable,
    /// The filter is not initialized.
    NotInitialized,
    /// The image is too old or too far ahead.
    Rejected,
    /// The filter is frozen: compared, but not used.
    Frozen,
}

/// Record of one measurement of dimension `D`, used or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation<const D: usize> {
    /// Measured minus predicted; NaN where there is none.
    pub residual: SVector<f64, D>,
    /// Covariance of the residual; NaN where there is none.
    pub covariance: SMatrix<f64, D, D>,
    /// Normalized innovation squared (`D` degrees of freedom); NaN where there is none.
    pub nis: f64,
    /// What became of it.
    pub outcome: Outcome,
}

impl<const D: usize> Innovation<D> {
    /// Returns the record of a measurement that was compared with nothing.
    pub fn without_values(outcome: Outcome) -> Self {
        Self {
            residual: SVector::repeat(f64::NAN),
            covariance: SMatrix::repeat(f64::NAN),
            nis: f64::NAN,
            outcome,
        }
    }
}
