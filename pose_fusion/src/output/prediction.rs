//! Odometry ahead of the newest one: the motion goes on with the last IMU reading.
//!
//! The prediction misses how the motion changes within the horizon `T`. [`Changes`] measures by how
//! much specific force and angular velocity changed within `T` until now, in the mean square `d²`
//! of an axis. A change that grows linearly is missed by `d/2` in the mean, which acts as white
//! noise of the density `(d/2)² T`. Until that is measured, a fast swing is assumed
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

/// Memory of the changes, s: the period of a slow swing.
const MEMORY: f64 = 2.0;
/// Changes measured for this long replace the assumed ones, s.
const MEASURED: f64 = 0.5;

/// By how much the IMU's readings change within the horizon.
#[derive(Clone, Copy, Debug, Default)]
pub struct Changes {
    newest: Option<Stamp>,
    measured: f64,
    /// Mean square of an axis: (m/s²)².
    force: f64,
    /// Mean square of an axis: (rad/s)².
    rate: f64,
}

impl Changes {
    /// Adds the reading at `stamp` and the one a horizon earlier.
    pub fn add(&mut self, stamp: Stamp, reading: &ImuReading, earlier: &ImuReading) {
        let step = self.newest.map_or(0.0, |newest| stamp.seconds_since(newest));
        self.newest = Some(stamp);
        if !(0.0..MEASURED).contains(&step) {
            *self = Self { newest: Some(stamp), ..Self::default() };
            return;
        }
        self.measured += step;
        let share = step / self.measured.clamp(step, MEMORY).max(f64::MIN_POSITIVE);
        let force = (reading.specific_force - earlier.specific_force).norm_squared() / 3.0;
        let rate = (reading.angular_velocity - earlier.angular_velocity).norm_squared() / 3.0;
        self.force += (force - self.force) * share;
        self.rate += (rate - self.rate) * share;
    }

    /// Returns the process noise of a motion that keeps the last reading for `horizon` seconds;
    /// `silent`: without an IMU there is no reading to keep.
    fn noise(&self, usual: &ProcessNoise, horizon: f64, silent: bool) -> ProcessNoise {
        if silent || self.measured < MEASURED {
            return dropout::extrapolated(usual, horizon);
        }
        usual.plus(self.force / 4.0 * horizon, self.rate / 4.0 * horizon)
    }
}

/// Returns the odometry `horizon` seconds after `stamp`, where the state is `state` and the IMU
/// reads `reading`. `changes` is what the motion changed within the horizon before.
#[expect(clippy::too_many_arguments, reason = "a pure function of what the filter holds")]
pub fn predicted(
    stamp: Stamp,
    state: &State,
    reading: &ImuReading,
    horizon: f64,
    noise: &ProcessNoise,
    changes: &Changes,
    geometry: &Geometry,
    settings: &Settings,
) -> Odometry {
    let changing = changes.noise(noise, horizon, settings.silent);
    // The variance of the change itself, from the density (d/2)² T.
    let changed = 4.0 * (changing.rate - noise.rate) / horizon;
    let settings = &Settings { rate_variance: settings.rate_variance + changed, ..*settings };
    let noise = changing;
    let mut ahead = state.clone();
    let steps = (horizon / STEP).ceil().max(1.0);
    for _ in 0..steps as usize {
        propagate(&mut ahead, reading, reading, horizon / steps, settings.gravity, &noise);
    }
    odometry(stamp.plus_seconds(horizon), &ahead, reading, geometry, settings)
}
