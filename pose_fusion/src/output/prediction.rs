//! Odometry ahead of the newest one: the motion goes on with the last IMU reading.
//!
//! The uncertainty grows with the motion that the last reading misses
//! ([`crate::timeline::dropout::extrapolated`]).

use super::{
    Odometry,
    odometry::{Settings, odometry},
};
use crate::{
    ekf::{
        propagation::{ImuReading, ProcessNoise, propagate},
        state::State,
    },
    measurements::geometry::Geometry,
    timeline::dropout,
};
use rig_model::Stamp;

/// Length of an integration step, s.
const STEP: f64 = 0.01;

/// Returns the odometry `horizon` seconds after `stamp`, where the state is `state` and the IMU
/// reads `reading`.
pub fn predicted(
    stamp: Stamp,
    state: &State,
    reading: &ImuReading,
    horizon: f64,
    noise: &ProcessNoise,
    geometry: &Geometry,
    settings: &Settings,
) -> Odometry {
    let noise = dropout::extrapolated(noise, horizon);
    let mut ahead = state.clone();
    let steps = (horizon / STEP).ceil().max(1.0);
    for _ in 0..steps as usize {
        propagate(&mut ahead, reading, reading, horizon / steps, settings.gravity, &noise);
    }
    odometry(stamp.plus_seconds(horizon), &ahead, reading, geometry, settings)
}
