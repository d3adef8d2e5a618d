//! Soundness of a state: a state beyond physical bounds is never published.

use crate::{config::TightConfig, ekf::state::State, initialization::time_offset::REACH};

/// Largest accelerometer (m/s²) and gyroscope bias (rad/s) of a working IMU.
const LARGEST_BIAS: [f64; 2] = [5.0, 1.0];
/// Latency that the history must hold beside the time offset, s.
const LATENCY: f64 = 0.1;

/// Returns the first bound of finite numbers and physics that a state violates. `camera_offset`, s,
/// is the configured time offset with what steps of the clocks added.
pub fn violation(state: &State, config: &TightConfig, camera_offset: f64) -> Option<&'static str> {
    let from_climber = (state.position.xy() - state.climber.xy()).norm();
    let offset = state.time_offset - camera_offset;
    let largest_offset = (config.history - LATENCY).clamp(REACH, REACH + 0.1);
    if !state.is_finite() {
        Some("a number is not finite")
    } else if from_climber > config.limits.max_range {
        Some("the horizontal distance from the climber exceeds limits.max_range")
    } else if state.velocity.norm() > config.limits.max_speed {
        Some("the speed exceeds limits.max_speed")
    } else if state.accelerometer_bias.amax() > LARGEST_BIAS[0] {
        Some("the accelerometer bias exceeds 5 m/s^2")
    } else if state.gyroscope_bias.amax() > LARGEST_BIAS[1] {
        Some("the gyroscope bias exceeds 1 rad/s")
    } else if offset.abs() > largest_offset {
        Some("the camera time offset is further from clock.camera_offset than history allows")
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    type Spoil = fn(&mut State);

    #[test]
    fn every_bound_is_checked_and_named() {
        let config = TightConfig::default();
        assert_eq!(violation(&State::zero(), &config, 0.0), None);
        let spoil: [(Spoil, &str); 6] = [
            (|s| s.position.x = 100.0, "limits.max_range"),
            (|s| s.velocity.z = 20.0, "limits.max_speed"),
            (|s| s.accelerometer_bias.y = 8.0, "accelerometer bias"),
            (|s| s.gyroscope_bias.y = 2.0, "gyroscope bias"),
            (|s| s.time_offset = 0.5, "clock.camera_offset"),
            (|s| s.climber.x = f64::NAN, "not finite"),
        ];
        for (change, name) in spoil {
            let mut state = State::zero();
            change(&mut state);
            let what = violation(&state, &config, 0.0);
            assert!(what.is_some_and(|what| what.contains(name)), "{name}: {what:?}");
        }
    }
}
