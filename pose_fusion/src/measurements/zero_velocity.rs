//! Zero-velocity update: a platform at rest has no velocity and no angular velocity. A slow swing
//! that hides in the IMU's noise (`adaptation::stationary`) contradicts the state by its velocity.

use crate::ekf::{
    consider::ByParameter,
    state::{CLIMBER_RATE, GYROSCOPE_BIAS, State, VELOCITY},
    update,
};
use nalgebra::Vector3;

/// Angular velocity of a platform at rest, (rad/s)²: 0.1°/s.
const REST_RATE: f64 = 3e-6;

/// Applies the update to `state` and returns whether it was consistent with it. `mean_rate` is the
/// mean gyroscope reading of the window (rad/s, IMU axes), `sigma` the velocity of a platform at
/// rest (m/s), `rate_variance` the variance of `mean_rate`, (rad/s)².
pub fn update(state: &mut State, mean_rate: &Vector3<f64>, sigma: f64, rate_variance: f64) -> bool {
    let consistent = (0..3).all(|i| {
        let velocity_sigma = state.sigma(VELOCITY + i).hypot(sigma);
        let rate_sigma =
            (state.covariance[(GYROSCOPE_BIAS + i, GYROSCOPE_BIAS + i)] + rate_variance).sqrt();
        state.velocity[i].abs() < 3.0 * velocity_sigma
            && state.climber_rate[i].abs() < 3.0 * state.sigma(CLIMBER_RATE + i) + 0.002
            && (mean_rate[i] - state.gyroscope_bias[i]).abs() < 3.0 * rate_sigma + 1e-3
    });
    if !consistent {
        return false;
    }
    let (none, rate_variance) = (ByParameter::zeros(), rate_variance + REST_RATE);
    for i in 0..3 {
        let residual = -state.velocity[i];
        update::scalar(state, &[(VELOCITY + i, 1.0)], residual, sigma * sigma, &none);
        let residual = mean_rate[i] - state.gyroscope_bias[i];
        update::scalar(state, &[(GYROSCOPE_BIAS + i, 1.0)], residual, rate_variance, &none);
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_finds_the_gyroscope_bias_and_leaves_a_moving_platform_alone() {
        let mut state = State::zero();
        state.set_sigmas(VELOCITY, &Vector3::repeat(0.01));
        state.set_sigmas(GYROSCOPE_BIAS, &Vector3::repeat(0.05));
        state.velocity = Vector3::new(0.01, 0.0, 0.0);
        let bias = Vector3::new(0.02, -0.01, 0.03);
        assert!(update(&mut state, &bias, 0.002, 1e-6));
        assert!((state.gyroscope_bias - bias).norm() < 1e-3 && state.velocity.norm() < 1e-3);
        state.velocity.x = 0.2;
        let before = state.clone();
        assert!(!update(&mut state, &bias, 0.002, 1e-6));
        assert_eq!(state, before);
    }
}
