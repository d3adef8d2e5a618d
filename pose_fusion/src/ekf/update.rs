//! Measurement updates of the state: a scalar update, and a square-root form for a block of rows.

use super::{
    consider::{self, ByParameter},
    state::{Covariance, Error, N, State},
};
use nalgebra::SMatrix;

/// Corrects `state` by a scalar measurement.
///
/// `h` lists the non-zero entries of the Jacobian row, `residual` is measured minus predicted,
/// `variance` the measurement noise in the residual's unit squared, `by_parameter` the derivative
/// of the measurement by the consider parameters. Leaves the state alone where the residual or the
/// innovation variance is not a number.
pub fn scalar(
    state: &mut State,
    h: &[(usize, f64)],
    residual: f64,
    variance: f64,
    by_parameter: &ByParameter,
) {
    let mut gain = Error::zeros();
    let mut by_state = ByParameter::zeros();
    for &(i, weight) in h {
        gain.axpy(weight, &state.covariance.column(i), 1.0);
        by_state += consider::of_entry(&state.sensitivity, i) * weight;
    }
    let spread: f64 = h.iter().map(|&(i, weight)| weight * gain[i]).sum();
    let innovation = spread + variance;
    if !(innovation > 0.0 && residual.is_finite()) {
        return;
    }
    subtract_square(&mut state.covariance, &(gain / innovation.sqrt()));
    gain /= innovation;
    state.add(&(gain * residual));
    consider::correct(&mut state.sensitivity, &gain, &(by_state + by_parameter));
}

/// Corrects a covariance by `P ← P − W Wᵀ` with `W = P Hᵀ L⁻ᵀ`, `L Lᵀ = H P Hᵀ + R`.
///
/// The result is symmetric to the last bit and equals Joseph's form at the optimal gain.
pub fn subtract_square<const M: usize>(p: &mut Covariance, root: &SMatrix<f64, N, M>) {
    for k in 0..M {
        let w = root.column(k);
        for j in 0..N {
            let scale = w[j];
            if scale != 0.0 {
                p.column_mut(j).axpy(-scale, &w, 1.0);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{
        super::{
            consider::TIME_OFFSET_ERROR,
            state::{POSITION, TIME_OFFSET},
        },
        *,
    };

    #[test]
    fn a_scalar_update_equals_joseph_s_form_and_corrects_the_sensitivity() {
        let mut state = State::zero();
        let seed = Covariance::from_fn(|i, j| ((i * 5 + j * 3) % 7) as f64 / 7.0);
        let square = seed * seed.transpose();
        state.covariance = (square + square.transpose()) * 0.5 + Covariance::identity();
        state.sensitivity[(2, POSITION)] = 0.4;
        let (p, v) = (state.covariance, state.sensitivity.map(f64::from).transpose());
        let mut h = nalgebra::RowSVector::<f64, N>::zeros();
        (h[POSITION], h[12]) = (1.0, -0.5);
        let mut e = ByParameter::zeros();
        e[2] = 0.3;
        let s = (h * p * h.transpose())[0] + 0.2;
        let k = p * h.transpose() / s;
        let a = Covariance::identity() - k * h;
        scalar(&mut state, &[(POSITION, 1.0), (12, -0.5)], 0.7, 0.2, &e);
        let joseph = a * p * a.transpose() + k * 0.2 * k.transpose();
        assert!((state.covariance - joseph).amax() < 1e-9);
        assert_eq!(state.covariance, state.covariance.transpose());
        let corrected = state.sensitivity.map(f64::from).transpose();
        let mut expected = v - k * (h * v + e.transpose());
        expected[(TIME_OFFSET, TIME_OFFSET_ERROR)] = 1.0;
        assert!((corrected - expected).amax() < 1e-6);
        let before = state.clone();
        scalar(&mut state, &[(POSITION, 1.0)], f64::NAN, 0.2, &e);
        assert_eq!(state, before);
    }
}
