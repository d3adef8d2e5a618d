//! Update of the climber's x, y and turn by its encoders. While a reading does not change, its
//! error does not either: a climber at rest is never known much better than its encoders' step.
//! Equations: `docs/src/equations.md`, "Encoders".

use super::{Innovation, Outcome};
use crate::ekf::{
    consider::{ByParameter, CLIMBER_OFFSET, ENCODER_SCALE},
    propagation::ImuReading,
    state::{CLIMBER, CLIMBER_RATE, State},
    update,
};
use nalgebra::{Matrix3, Vector3};
use rig_model::wrap_angle;

/// Largest acceleration of a climber: m/s², m/s², rad/s² (simulated end stop: 36 m/s²).
const END_STOP_ACCELERATION: f64 = 40.0;
/// No climber is faster, m/s and rad/s.
const FASTEST: f64 = 3.0;
/// Beyond this span the images decide where the climber went, s.
const LONGEST: f64 = 0.1;
/// NIS (one degree of freedom) above which a reading contradicts the model of the motion (5 sigma).
pub const CONTRADICTION: f64 = 25.0;

/// Encoder reading as the update needs it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EncoderReading {
    /// x, y (m) and turn (rad, any multiple of a full turn).
    pub values: Vector3<f64>,
    /// Variance of each, m², m², rad².
    pub variance: Vector3<f64>,
    /// Rates by the readings before this one, per s: others would correlate with its error.
    pub rates: Vector3<f64>,
    /// Factor on the variance of a moving climber's reading, already contained in `variance`.
    pub multiplicity: Vector3<f64>,
    /// Time offset with which the reading was placed on the IMU's time line, s.
    pub time_offset: f64,
}

/// Returns the innovation of a reading without changing the state.
///
/// `climber_offset` is the configured offset of the climber's stamps against the camera's, s.
pub fn innovation(state: &State, reading: &EncoderReading, climber_offset: f64) -> Innovation<3> {
    // The reading's own instant is `late` after the place it was given on the time line.
    let late = state.time_offset + climber_offset - reading.time_offset;
    innovation_at(state, reading, late)
}

fn innovation_at(state: &State, reading: &EncoderReading, late: f64) -> Innovation<3> {
    let predicted = state.climber
        + state.climber_rate * late
        + state.climber_acceleration * (late * late / 2.0);
    let mut residual = reading.values - predicted;
    residual.z = wrap_angle(residual.z);
    let mut covariance = Matrix3::zeros();
    for axis in 0..3 {
        let (p, r) = (CLIMBER + axis, CLIMBER_RATE + axis);
        let spread = state.covariance[(p, p)]
            + 2.0 * late * state.covariance[(p, r)]
            + late * late * state.covariance[(r, r)];
        covariance[(axis, axis)] = spread + reading.variance[axis];
    }
    let nis = (0..3).map(|i| residual[i] * residual[i] / covariance[(i, i)]).fold(0.0, f64::max);
    Innovation { residual, covariance, nis, outcome: Outcome::Used }
}

/// Corrects `state` by a reading, with the IMU's reading at that time; `gravity` in m/s².
pub fn update(
    state: &mut State,
    reading: &EncoderReading,
    imu: &ImuReading,
    climber_offset: f64,
    gravity: f64,
) {
    let late = state.time_offset + climber_offset - reading.time_offset;
    let before = state.time_offset;
    for axis in 0..3 {
        let residual = innovation_at(state, reading, late).residual[axis];
        let h = [(CLIMBER + axis, 1.0), (CLIMBER_RATE + axis, late)];
        // Readings that leapt give no rate.
        let given = Some(reading.rates[axis]).filter(|rate| rate.abs() < FASTEST);
        let rate = given.unwrap_or(state.climber_rate[axis]);
        let by = by_parameter(axis, reading.values[axis], rate);
        update::scalar(state, &h, residual, reading.variance[axis], &by);
    }
    state.shift_time(imu, state.time_offset - before, gravity);
}

/// Returns the derivative of an encoder's value by the consider parameters.
pub fn by_parameter(axis: usize, value: f64, rate: f64) -> ByParameter {
    let mut by = ByParameter::zeros();
    if axis < 2 {
        by[ENCODER_SCALE] = value;
    }
    by[CLIMBER_OFFSET] = rate;
    by
}

/// Returns whether no climber can have caused the innovation within `span` seconds: its distance,
/// less five sigma, asks for more than `END_STOP_ACCELERATION`.
pub fn is_impossible(innovation: &Innovation<3>, span: f64) -> bool {
    let reach = END_STOP_ACCELERATION * span.min(LONGEST).powi(2) / 2.0;
    (0..3).any(|i| {
        let sigma = innovation.covariance[(i, i)].sqrt();
        let distance = innovation.residual[i].abs();
        distance.is_nan() || distance > reach + 5.0 * sigma
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> (State, EncoderReading) {
        let mut state = State::zero();
        state.climber = Vector3::new(0.3, -0.2, 3.1);
        state.climber_rate = Vector3::new(0.2, 0.0, 0.1);
        state.set_sigmas(CLIMBER, &Vector3::repeat(1e-3));
        let reading = EncoderReading {
            values: Vector3::new(0.31, -0.2, 3.1 - std::f64::consts::TAU),
            variance: Vector3::repeat(1e-6),
            rates: Vector3::zeros(),
            multiplicity: Vector3::repeat(1.0),
            time_offset: 0.0,
        };
        (state, reading)
    }

    #[test]
    fn a_reading_moves_the_climber_and_a_full_turn_makes_no_difference() {
        let (mut state, reading) = example();
        let i = innovation(&state, &reading, 0.0);
        assert!((i.residual - Vector3::new(0.01, 0.0, 0.0)).norm() < 1e-9, "{i:?}");
        // An offset of the stamps moves the prediction along the motion.
        let i = innovation(&state, &reading, 0.05);
        assert!((i.residual - Vector3::new(0.0, 0.0, -0.005)).norm() < 1e-9, "{i:?}");
        update(&mut state, &reading, &ImuReading::default(), 0.0, 9.81);
        let error = state.climber - Vector3::new(0.305, -0.2, 3.1);
        assert!(error.norm() < 1e-9, "{error}");
    }

    #[test]
    fn a_jump_beyond_40_m_s2_is_impossible_and_an_end_stop_is_not() {
        let (state, mut reading) = example();
        reading.values.x = 0.3 + 1.0;
        assert!(is_impossible(&innovation(&state, &reading, 0.0), 0.04));
        reading.values.x = 0.3 + 0.02;
        assert!(!is_impossible(&innovation(&state, &reading, 0.0), 0.04));
        reading.values.x = f64::NAN;
        assert!(is_impossible(&innovation(&state, &reading, 0.0), 0.04));
    }
}
