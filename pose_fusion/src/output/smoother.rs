//! Fixed-interval smoother: each estimate uses all data, later ones included. Its input is the
//! filter's entries of the time line ([`Entry`]), once late measurements cannot change them any
//! more. Equations: `docs/src/equations.md`, "Output".

use crate::{
    ekf::{
        calibration::Calibration,
        consider,
        propagation::{propagate, transition},
        state::{Covariance, Error, N, State, TIME_OFFSET},
    },
    timeline::history::{Entry, Event},
};
use nalgebra::{Cholesky, Const};

/// Length of a batch of smoothed odometry, s.
const BATCH: f64 = 60.0;
/// Shortest time of later data that a smoothed estimate uses, s: biases and time offset converge
/// faster.
const LAG: f64 = 20.0;

/// Entries that are still to be smoothed; `None` until [`Archive::enable`].
#[derive(Clone, Debug, Default)]
pub struct Archive(Option<Vec<Entry>>);

impl Archive {
    /// Keeps entries from now on: about 1 MB per second.
    pub fn enable(&mut self) {
        self.0.get_or_insert_default();
    }

    /// Keeps an entry that nothing changes any more.
    pub fn add(&mut self, entry: Option<&Entry>) {
        if let Some(entries) = &mut self.0 {
            entries.extend(entry.cloned());
        }
    }

    /// Returns `output` of each IMU sample with its smoothed state: at the `end` of all samples,
    /// before that of those with at least `LAG` seconds of later data. `gravity` in m/s².
    pub fn smoothed<T>(
        &mut self,
        end: bool,
        gravity: f64,
        output: impl Fn(&Entry, &State) -> T,
    ) -> Vec<T> {
        let entries = self.0.as_deref().unwrap_or_default();
        let (Some(first), Some(last)) = (entries.first(), entries.last()) else {
            return Vec::new();
        };
        // A clock that was set back is no reason to wait.
        let (span, last) = (last.stamp.seconds_since(first.stamp), last.stamp);
        if !end && (0.0..=BATCH + LAG).contains(&span) {
            return Vec::new();
        }
        let states = smooth(entries, gravity);
        let until = if end { last } else { last.plus_seconds(-LAG) };
        let later = entries.iter().rev().take_while(|e| e.stamp > until && e.stamp <= last);
        let ready = entries.len() - later.count();
        let smoothed = entries.iter().zip(&states).take(ready).filter(|(e, _)| e.is_imu());
        let smoothed = smoothed.map(|(entry, state)| output(entry, state)).collect();
        if let Some(entries) = &mut self.0 {
            entries.drain(..ready);
        }
        smoothed
    }
}

/// Returns the smoothed states of entries in the order of time. Data after a state that was set do
/// not change the states before it. `gravity` in m/s².
fn smooth(entries: &[Entry], gravity: f64) -> Vec<State> {
    let mut states: Vec<State> = Vec::with_capacity(entries.len());
    let Some(calibration) = entries.last().map(|entry| entry.state.calibration) else {
        return states;
    };
    for (i, entry) in entries.iter().enumerate().rev() {
        let state = with_calibration(&entry.state, calibration);
        let smoothed = match (entries.get(i + 1), states.last()) {
            (Some(next), Some(later)) if !matches!(next.event, Event::Set) => {
                step(entry, &state, next, later, gravity)
            }
            _ => None,
        };
        states.push(smoothed.unwrap_or(state));
    }
    states.reverse();
    states
}

/// Returns the filter's state with the constants known in the end, to first order.
fn with_calibration(state: &State, calibration: Calibration) -> State {
    let mut moved = state.clone();
    let change = calibration.constants() - state.calibration.constants();
    moved.add(&(consider::of_constants(&state.sensitivity) * change));
    moved.calibration = calibration;
    moved
}

/// One step back from the state `now`; `None` where the covariance is not positive definite.
fn step(entry: &Entry, now: &State, next: &Entry, later: &State, gravity: f64) -> Option<State> {
    let dt = next.stamp.seconds_since(entry.stamp);
    let f = transition(now, &entry.reading, &next.reading, dt, &next.noise);
    let mut prediction = now.clone();
    propagate(&mut prediction, &entry.reading, &next.reading, dt, gravity, &next.noise);
    let mut later_there = later.clone();
    later_there.shift_time(&next.reading, prediction.time_offset - later.time_offset, gravity);
    let error = later_there.minus(&prediction);

    let scale = Error::from_fn(|i, _| {
        let variance = prediction.covariance[(i, i)];
        if variance > 0.0 { variance.sqrt() } else { 1.0 }
    });
    let mut scaled =
        Covariance::from_fn(|i, j| prediction.covariance[(i, j)] / (scale[i] * scale[j]));
    for i in 0..N {
        // What is known exactly stays so; the rest is far above rounding.
        scaled[(i, i)] = scaled[(i, i)].max(1.0) + 1e-12;
    }
    let cholesky = Cholesky::<f64, Const<N>>::new(scaled)?;
    let mut shared = f * now.covariance;
    for i in 0..N {
        shared.row_mut(i).unscale_mut(scale[i]);
    }
    let mut gain = cholesky.solve(&shared);
    for i in 0..N {
        gain.row_mut(i).unscale_mut(scale[i]);
    }
    let gain = gain.transpose();
    let correction = gain * error;
    let mut state = now.clone();
    state.add(&correction);
    state.shift_time(&entry.reading, correction[TIME_OFFSET], gravity);
    let covariance =
        now.covariance + gain * (later.covariance - prediction.covariance) * gain.transpose();
    state.covariance = (covariance + covariance.transpose()) * 0.5;
    state.is_finite().then_some(state)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::adaptation::imu_noise::Densities;
    use crate::ekf::{
        consider::ByParameter,
        propagation::{ImuReading, ProcessNoise},
        state::{ACCELEROMETER_BIAS, POSITION, VELOCITY},
        update,
    };
    use nalgebra::Vector3;
    use rig_model::Stamp;

    /// In a linear problem the smoothed first state is the batch solution.
    #[test]
    fn the_smoothed_state_is_the_batch_solution() {
        let reading = ImuReading {
            specific_force: Vector3::new(0.0, 0.0, 9.81),
            angular_velocity: Vector3::zeros(),
        };
        let noise = ProcessNoise {
            force: 1e-4,
            rate: 1e-8,
            accelerometer_bias: 1e-8,
            gyroscope_bias: 1e-10,
            jerk: Vector3::repeat(1e-3),
            ..ProcessNoise::default()
        };
        let mut first = State::zero();
        for i in 0..24 {
            first.covariance[(i, i)] = 1e-2;
        }
        first.covariance[(VELOCITY, VELOCITY)] = 0.25;
        first.covariance[(ACCELEROMETER_BIAS, ACCELEROMETER_BIAS)] = 1e-4;
        let truth = |t: f64| 0.05 + 0.3 * t;
        let (n, dt, none) = (40, 0.01, ByParameter::zeros());
        let entry = |t: f64, event: Event, state: State| {
            let (stamp, motion) = (Stamp::from_nanos(0).plus_seconds(t), reading.into());
            Entry { stamp, event, reading, motion, noise, state, unseen: 0.0 }
        };
        let mut entries = vec![entry(0.0, Event::Set, first.clone())];
        for i in 1..=n {
            let mut state = entries[i - 1].state.clone();
            propagate(&mut state, &reading, &reading, dt, 9.81, &noise);
            if i % 4 == 0 {
                let residual = truth(i as f64 * dt) - state.position.x;
                update::scalar(&mut state, &[(POSITION, 1.0)], residual, 1e-6, &none);
            }
            let event = Event::Imu {
                noise: Densities::default(),
                doubt: Densities::default(),
                at_rest: None,
            };
            entries.push(entry(i as f64 * dt, event, state));
        }
        let smoothed = smooth(&entries, 9.81);
        // The same by augmenting the first state, whose cross-covariance is carried along.
        let (mut mean, mut own) = (Error::zeros(), first.covariance);
        let (mut now, mut shared) = (first.clone(), first.covariance);
        for i in 1..=n {
            let f = transition(&now, &reading, &reading, dt, &noise);
            propagate(&mut now, &reading, &reading, dt, 9.81, &noise);
            shared *= f.transpose();
            if i % 4 == 0 {
                let spread = now.covariance[(POSITION, POSITION)] + 1e-6;
                let residual = truth(i as f64 * dt) - now.position.x;
                let gain = shared.column(POSITION) / spread;
                mean += gain * residual;
                own -= gain * gain.transpose() * spread;
                let row = now.covariance.column(POSITION).transpose();
                shared -= gain * row;
                update::scalar(&mut now, &[(POSITION, 1.0)], residual, 1e-6, &none);
            }
        }
        let error = smoothed[0].minus(&first);
        assert!((error - mean).amax() < 1e-6, "{}", (error - mean).amax());
        let error = (smoothed[0].covariance - own).amax();
        assert!(error < 1e-7, "{error}");
        assert!((smoothed[0].velocity.x - 0.3).abs() < 0.01);
        assert!(smoothed[0].covariance[(VELOCITY, VELOCITY)] < 1e-3);
    }
}
