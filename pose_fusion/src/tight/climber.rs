//! The climber's encoders correct x, y and turn.
//!
//! A reading of a climber that drives is off by the encoder's step as by white noise (variance step²/12). While the
//! reading stands, its error stands or creeps, and the next one tells little that is new: its variance is multiplied by the
//! number of equal readings so far, up to [`STANDING`]. A climber at rest is therefore never known much better than its
//! encoders' step, and one that drives is smoothed by its own inertia (the jerk is white).

use super::{
    geometry::ClimberRest,
    jolt::Innovation,
    markers::biased_update,
    propagate::{Felt, retime},
    rigid,
    state::{CLIMBER, CLIMBER_RATE, State},
};
use nalgebra::{Vector3, Vector4};
use rig_model::Stamp;

/// One encoder sample as the update needs it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// x, y (m) and turn (rad; any multiple of a full turn).
    pub values: Vector3<f64>,
    /// Variance of each, m², m², rad².
    pub variance: Vector3<f64>,
    /// How many times that of a driving climber's reading it is.
    pub share: Vector3<f64>,
    /// The clock offset (τ_c + d) that placed the reading on the inertial unit's time line, s.
    pub clock: f64,
    /// What the unit felt then.
    pub felt: Felt,
    /// What the encoders do not measure.
    pub rest: ClimberRest,
    /// How fast the climber drove shortly before, per s (see [`super::tie`]).
    pub speed: Option<Vector3<f64>>,
}

/// So long a climber's motion is a parabola but for less than its encoders' step, s.
const SMOOTH: f64 = 0.2;

/// After so many readings the noise is known.
const YOUNG: usize = 50;

/// Equal readings in a row count as one down to this share.
pub const STANDING: f64 = 8.0;

/// Corrects `state` by a reading of a clock that is `offset` seconds off the camera's; returns what it said beyond the expected.
pub fn update(state: &mut State, reading: &Reading, offset: f64, gravity: f64) -> Innovation {
    let late = state.camera_clock + offset - reading.clock;
    let clock = state.camera_clock;
    let mut innovation = Innovation { residual: Vector3::zeros(), nis: Vector3::zeros() };
    if let (false, Some(speed)) = (state.tie.known, &reading.speed) {
        state.tie.by_offset = rigid(state, speed);
        state.tie.known = true;
    }
    for axis in 0..3 {
        // The reading's own instant is `late` after the place that it was given.
        let (rate, more) = (state.climber_rate[axis], state.climber_acceleration[axis]);
        let expected = state.climber[axis] + (rate + more * (late / 2.0)) * late;
        let mut residual = reading.values[axis] - expected;
        if axis == 2 {
            residual = wrapped(residual);
        }
        let h = [(CLIMBER + axis, 1.0), (CLIMBER_RATE + axis, late)];
        innovation.residual[axis] = residual;
        innovation.nis[axis] = biased_update(
            state,
            &h,
            reading.speed.map_or(0.0, |s| s[axis]),
            residual,
            reading.variance[axis],
        );
    }
    let moved = state.camera_clock - clock;
    retime(state, &reading.felt, moved, gravity);
    innovation
}

/// The angle within ±π.
pub fn wrapped(angle: f64) -> f64 {
    let turns = (angle / std::f64::consts::TAU).round();
    angle - turns * std::f64::consts::TAU
}

/// Tells an encoder's noise from its readings: third divided differences cancel any smooth motion, however the readings are spaced
/// (some are lost, or come late), and divided by the norm of their weights they leave the variance of white noise in their square.
#[derive(Clone, Debug)]
pub struct ReadingNoise {
    last: [(Stamp, Vector3<f64>); 4],
    count: usize,
    variance: Vector3<f64>,
    weight: Vector3<f64>,
    floor: Vector3<f64>,
    equal: [f64; 3],
}

impl ReadingNoise {
    /// With the steps of the encoders (m, m, rad) as the floor: step²/12.
    pub fn new(steps: Vector3<f64>) -> Self {
        Self {
            last: [(Stamp::default(), Vector3::zeros()); 4],
            count: 0,
            variance: Vector3::zeros(),
            weight: Vector3::zeros(),
            floor: steps.map(|q| q * q / 12.0),
            equal: [1.0; 3],
        }
    }

    /// Takes a reading in that is newer than those before; returns the variance to be assumed for a driving climber, and for each
    /// value the factor by which standing still makes it count less.
    pub fn take(&mut self, stamp: Stamp, values: &Vector3<f64>) -> (Vector3<f64>, [f64; 3]) {
        let before = self.last[3].1;
        let mut values = *values;
        if self.count > 0 {
            values.z = before.z + wrapped(values.z - before.z);
        }
        self.last.rotate_left(1);
        self.last[3] = (stamp, values);
        self.count = self.count.saturating_add(1);
        for axis in 0..3 {
            let equal = self.count > 1 && values[axis] == before[axis];
            self.equal[axis] = if equal { (self.equal[axis] + 1.0).min(STANDING) } else { 1.0 };
        }
        if let (true, Some(weights)) = (self.count >= 4, self.weights()) {
            let norm = weights.norm_squared();
            for axis in 0..3 {
                let still = (0..3).all(|k| self.last[k].1[axis] == self.last[k + 1].1[axis]);
                if !still {
                    // About the newest value, which is far from zero where the rail is long.
                    let d: f64 = (0..3).map(|k| weights[k] * (self.last[k].1[axis] - values[axis])).sum();
                    // The mean of the first readings, then a memory of a hundred; one jump counts ten times at most.
                    self.weight[axis] = (self.weight[axis] + 1.0).min(100.0);
                    let mut square = d * d / norm;
                    if self.weight[axis] > 10.0 {
                        square = square.min(10.0 * self.variance[axis].max(self.floor[axis]));
                    }
                    self.variance[axis] += (square - self.variance[axis]) / self.weight[axis];
                }
            }
        }
        (self.variance(), self.equal)
    }

    /// What [`Self::take`] says, for a reading that comes after newer ones, `neighbour` being the one before it: it teaches nothing,
    /// and where it equals its neighbour it counts as little as that one.
    pub fn late(&self, values: &Vector3<f64>, neighbour: Option<&Vector3<f64>>) -> (Vector3<f64>, [f64; 3]) {
        let equal = std::array::from_fn(|axis| {
            if neighbour.is_some_and(|n| n[axis] == values[axis]) { STANDING } else { 1.0 }
        });
        (self.variance(), equal)
    }

    /// Of the third divided difference of the last four readings; `None` where they are too far apart for a smooth motion.
    fn weights(&self) -> Option<Vector4<f64>> {
        let newest = self.last[3].0;
        let t = self.last.map(|(at, _)| at.seconds_since(newest));
        if t[0] < -SMOOTH {
            return None;
        }
        // In units of the mean interval, so that the weights stay near one.
        let unit = -t[0] / 3.0;
        Some(Vector4::from_fn(|i, _| {
            (0..4).filter(|j| *j != i).map(|j| unit / (t[i] - t[j])).product::<f64>()
        }))
    }

    /// The variance to be assumed, m², m², rad².
    pub fn variance(&self) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| {
            let (found, count) = (self.variance[axis], self.weight[axis]);
            // The estimate scatters, and most while it has few differences; what may be scatter is the step's own.
            let scatter = if count >= 15.0 { 1.5 } else { 1.0 + 7.5 / count };
            if count > 0.0 && found > scatter * self.floor[axis] { found } else { self.floor[axis] }
        })
    }

    /// The noise is still being found: what it is taken for may yet change by much.
    pub fn is_young(&self) -> bool {
        self.count <= YOUNG
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a bad link makes of the readings of a climber that drives: the same values, less evenly spaced.
    #[test]
    fn readings_that_are_lost_or_late_are_no_noise() {
        let step = 0.001;
        let reading = |i: i32| {
            let t = f64::from(i) * 0.02 + 0.002 * f64::from(i % 3);
            let x = ((0.4 * t.sin()) / step).round() * step;
            (Stamp::default().plus_seconds(t), Vector3::new(x, 0.0, 0.0))
        };
        for lost in [&[][..], &[3], &[2, 3], &[1, 2, 5, 6]] {
            let mut noise = ReadingNoise::new(Vector3::repeat(step));
            for (stamp, values) in (0..400).filter(|i| !lost.contains(&(i % 7))).map(reading) {
                noise.take(stamp, &values);
            }
            let sigma = noise.variance().x.sqrt() * 12.0_f64.sqrt() / step;
            assert!(sigma < 1.25, "{lost:?} lost of each seven: {sigma} steps");
        }
        // One that comes late and equals its neighbour counts as little as that one.
        let noise = ReadingNoise::new(Vector3::repeat(step));
        let (_, share) = noise.late(&Vector3::new(0.3, 0.2, 0.1), Some(&Vector3::new(0.3, 0.1, 0.1)));
        assert_eq!(share, [STANDING, 1.0, STANDING]);
    }

    #[test]
    fn noise_is_told_from_motion_and_a_climber_at_rest_is_not_known_better_than_its_step() {
        let steps = Vector3::new(0.001, 0.001, 0.00087);
        let mut noise = ReadingNoise::new(steps);
        let mut state = 1u64;
        let mut normal = || {
            let mut sum = 0.0;
            for _ in 0..12 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                sum += (state >> 11) as f64 * 2f64.powi(-53);
            }
            sum - 6.0
        };
        let mut found = Vector3::zeros();
        for i in 0..200 {
            let t = f64::from(i) * 0.02;
            let x = 0.4 * t.sin() + 0.002 * normal();
            (found, _) = noise.take(Stamp::default().plus_seconds(t), &Vector3::new(x, 0.3, 0.0));
        }
        assert!((found.x.sqrt() / 0.002 - 1.0).abs() < 0.25, "{}", found.x.sqrt());
        assert!((found.y - 1e-6 / 12.0).abs() < 1e-12);
        let mut s = State::zero();
        s.set_variance(CLIMBER, &Vector3::repeat(0.1));
        let (rest, values) = (
            ClimberRest { height: 2.8, tilt: nalgebra::UnitQuaternion::identity() },
            Vector3::new(0.3, 0.2, 0.1),
        );
        let mut noise = ReadingNoise::new(steps);
        for i in 0..100 {
            let (variance, share) = noise.take(Stamp::default().plus_seconds(f64::from(i) * 0.02), &values);
            let reading = Reading {
                values,
                variance: variance.component_mul(&Vector3::from(share)),
                share: Vector3::from(share),
                clock: 0.0,
                felt: Felt { force: Vector3::zeros(), rate: Vector3::zeros() },
                rest,
                speed: None,
            };
            for axis in 0..3 {
                s.covariance[(CLIMBER + axis, CLIMBER + axis)] += 1e-8;
            }
            update(&mut s, &reading, 0.0, 9.81);
        }
        let sigma = s.covariance[(CLIMBER, CLIMBER)].sqrt();
        assert!(sigma > 0.0001, "{sigma}");
    }
}
