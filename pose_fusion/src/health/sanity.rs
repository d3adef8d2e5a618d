//! Soundness of a state: a state beyond physical bounds is never published.

use crate::{config::TightConfig, ekf::state::State, initialization::time_offset::REACH};

/// Largest accelerometer (m/s²) and gyroscope bias (rad/s) of a working IMU.
const LARGEST_BIAS: [f64; 2] = [5.0, 1.0];
/// Latency that the history must hold beside the time offset, s.
const LATENCY: f64 = 0.1;

/// Returns the largest camera time offset that the history can hold, s.
pub fn largest_offset(config: &TightConfig) -> f64 {
    (config.history - LATENCY).clamp(REACH, REACH + 0.1)
}

/// Returns whether every number of a state is finite and within physical bounds.
pub fn is_sound(state: &State, config: &TightConfig) -> bool {
    let from_climber = (state.position.xy() - state.climber.xy()).norm();
    let offset = state.time_offset - config.clock.camera_offset;
    state.is_finite()
        && from_climber <= config.limits.max_range
        && state.velocity.norm() <= config.limits.max_speed
        && state.accelerometer_bias.amax() <= LARGEST_BIAS[0]
        && state.gyroscope_bias.amax() <= LARGEST_BIAS[1]
        && offset.abs() <= largest_offset(config)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bound_is_checked() {
        let config = TightConfig::default();
        assert!(is_sound(&State::zero(), &config));
        let spoil: [fn(&mut State); 6] = [
            |s| s.position.x = 100.0,
            |s| s.velocity.z = 20.0,
            |s| s.accelerometer_bias.y = 8.0,
            |s| s.gyroscope_bias.y = 2.0,
            |s| s.time_offset = 0.5,
            |s| s.climber.x = f64::NAN,
        ];
        for change in spoil {
            let mut state = State::zero();
            change(&mut state);
            assert!(!is_sound(&state, &config), "{state:?}");
        }
    }
}
