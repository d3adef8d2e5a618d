//! Newest encoder readings: the climber at any instant between them and shortly beyond.

pub mod faults;

use crate::{
    adaptation::encoder_noise::EncoderNoise, config::ClimberConfig,
    measurements::geometry::ClimberHeightTilt,
};
use nalgebra::Vector3;
use rig_model::{Stamp, wrap_angle};
use std::collections::VecDeque;

/// Number of readings kept: 0.4 s at 1 kHz, more than encoders must stand to be tried without.
const KEPT: usize = 400;
/// Readings within this time of an instant give the rates, s.
const RATE_SPAN: f64 = 0.25;
/// Readings that are less than this apart are interpolated without more uncertainty, s.
const READINGS_INTERPOLATED: f64 = 0.1;
/// Readings are missing after this many of the usual intervals of the last [`RECENT`].
const MISSED: f64 = 2.0;
const RECENT: usize = 32;
/// Share of a reading's latency in the running mean.
const LATENCY_SHARE: f64 = 0.1;
/// Shortest span of readings that gives rates, s.
const SHORTEST_RATE_SPAN: f64 = 0.03;
/// No climber is faster than this (x, y, m/s; turn, rad/s; 1 sigma) …
pub const SPEED: [f64; 3] = [0.5, 0.5, 0.4];
/// … or accelerated by more than this (m/s², rad/s²; 1 sigma).
pub const DRIVE_ACCELERATION: [f64; 3] = [0.5, 0.5, 0.3];
/// A climber that moves by more than this many encoder steps within [`MOVING_SPAN`] is driving.
const MOVING_STEPS: f64 = 3.0;
const MOVING_SPAN: f64 = 0.2;
/// NIS above which the climber's jerk is larger than assumed.
const LARGE_JERK: f64 = 10.0;
/// Factor on the jerk of a climber that stands: it will set off.
const SETTING_OFF: f64 = 25.0;
/// Largest factor on the jerk: that of a climber whose encoders are silent or not trusted.
pub const JERK_LIMIT: f64 = 250.0;

/// Encoder reading: its stamp; x, y (m) and turn (rad); height and tilt.
type Reading = (Stamp, Vector3<f64>, ClimberHeightTilt);

/// Returns the displacement from one reading's values to another's, m, m, rad.
fn way(from: &Vector3<f64>, to: &Vector3<f64>) -> Vector3<f64> {
    let mut way = to - from;
    way.z = wrap_angle(way.z);
    way
}

/// Climber at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClimberAt {
    /// x, y (m) and turn (rad).
    pub values: Vector3<f64>,
    /// Their rates, per s.
    pub rates: Vector3<f64>,
    /// Standard deviations of a reading: m, m, rad.
    pub noise: Vector3<f64>,
    /// Growth of the standard deviations outside the readings: m, m, rad.
    pub growth: Vector3<f64>,
    /// Standard deviations of the rates.
    pub rate_sigmas: Vector3<f64>,
    /// Time to the nearest reading, 0 between two readings, s.
    pub distance: f64,
    /// Height and tilt.
    pub rest: ClimberHeightTilt,
}

impl ClimberAt {
    /// Returns the sigmas of the values, m, m, rad; a quantized value is off by a step at most.
    pub fn sigmas(&self) -> Vector3<f64> {
        self.noise * 12f64.sqrt() + self.growth
    }
}

/// The newest readings in the order of their stamps, with the noise and jerk identified from them.
#[derive(Clone, Debug)]
pub struct ClimberTrack {
    readings: VecDeque<Reading>,
    /// Noise of the readings.
    pub noise: EncoderNoise,
    /// Variance with which the readings on the time line were weighed, m², m², rad².
    pub assumed_variance: Vector3<f64>,
    /// Factor on the configured jerk density.
    pub jerk_factor: f64,
    /// Running mean of the readings' latency, s.
    latency: f64,
    /// Per axis, the first of the readings that equal the newest one.
    standing_since: [Stamp; 3],
    /// Per axis, whether the readings have ever differed.
    has_moved: [bool; 3],
    /// Per axis, since when it may be stuck.
    stuck: [Option<Stamp>; 3],
}

impl ClimberTrack {
    /// Creates an empty track.
    pub fn new(config: &ClimberConfig) -> Self {
        let steps = Vector3::new(config.quantum, config.quantum, config.turn_quantum);
        let noise = EncoderNoise::new(steps);
        Self {
            readings: VecDeque::with_capacity(KEPT + 1),
            assumed_variance: noise.variance(),
            noise,
            jerk_factor: SETTING_OFF,
            latency: 0.0,
            standing_since: [Stamp::default(); 3],
            has_moved: [false; 3],
            stuck: [None; 3],
        }
    }

    /// Adds a reading. Returns its variance (m², m², rad²) as a moving climber's and the factor for
    /// equal readings; `None` for a stamp that is there already.
    pub fn add(
        &mut self,
        stamp: Stamp,
        values: Vector3<f64>,
        rest: ClimberHeightTilt,
    ) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let place = self.readings.partition_point(|(at, _, _)| *at < stamp);
        if self.readings.get(place).is_some_and(|(at, _, _)| *at == stamp) {
            return None;
        }
        let (variance, equal) = if place == self.readings.len() {
            for axis in 0..3 {
                let last = self.readings.back();
                if last.is_none_or(|(_, last, _)| last[axis] != values[axis]) {
                    self.has_moved[axis] |= last.is_some();
                    self.standing_since[axis] = stamp;
                    // One that moves again shows that the encoders read again.
                    if self.stuck[axis].is_some() {
                        self.stuck = [None; 3];
                    }
                }
            }
            self.noise.add(stamp, &values)
        } else {
            let neighbor = place.checked_sub(1).and_then(|p| self.readings.get(p));
            self.noise.late(&values, neighbor.map(|(_, values, _)| values))
        };
        // A reading older than all that are kept is not needed.
        if place > 0 || self.readings.is_empty() {
            self.readings.insert(place, (stamp, values, rest));
        }
        if self.readings.len() > KEPT {
            self.readings.pop_front();
        }
        Some((variance, Vector3::from(equal)))
    }

    /// Notes how much older a reading is than the end of the time line when it comes, s.
    pub fn note_latency(&mut self, latency: f64) {
        self.latency += LATENCY_SHARE * (latency.clamp(0.0, RATE_SPAN) - self.latency);
    }

    /// Returns the age at an instant of the last reading before it, where readings that were due
    /// are missing, s: where it is older than [`MISSED`] times their usual interval, and than their
    /// latency explains.
    pub fn missing_for(&self, stamp: Stamp) -> Option<f64> {
        let after = self.readings.partition_point(|(at, _, _)| *at <= stamp);
        let last = after.checked_sub(1).and_then(|last| self.readings.get(last))?;
        let age = stamp.seconds_since(last.0);
        // Not searched at each step.
        if age <= SHORTEST_RATE_SPAN {
            return None;
        }
        let due = (MISSED * self.interval(after)?).max(SHORTEST_RATE_SPAN) + 2.0 * self.latency;
        (age > due).then_some(age)
    }

    /// Returns the usual interval of the [`RECENT`] readings before a place, s: the second longest.
    /// Readings may come in bursts, and one interval may be a dropout.
    fn interval(&self, end: usize) -> Option<f64> {
        let (mut longest, mut second) = (0.0, 0.0);
        for i in end.saturating_sub(RECENT).max(1)..end {
            let interval = self.readings[i].0.seconds_since(self.readings[i - 1].0);
            if interval > longest {
                (longest, second) = (interval, longest);
            } else if interval > second {
                second = interval;
            }
        }
        (longest > 0.0).then_some(if second > 0.0 { second } else { longest })
    }

    /// Returns how many readings come in a time of seconds, at least one.
    pub fn readings_in(&self, seconds: f64) -> f64 {
        let (Some(first), Some(last)) = (self.readings.front(), self.readings.back()) else {
            return 1.0;
        };
        let span = last.0.seconds_since(first.0).max(seconds);
        (seconds * self.readings.len() as f64 / span).max(1.0)
    }

    /// Returns the newest reading: stamp; x, y, turn; height and tilt.
    pub fn newest(&self) -> Option<&Reading> {
        self.readings.back()
    }

    /// Adapts the jerk to the NIS of a reading that was used: fast upwards, slowly back.
    pub fn adapt_jerk(&mut self, nis: f64) {
        let change = if nis > LARGE_JERK { 1.6 } else { 0.985 };
        let least = if self.is_moving() { 1.0 } else { SETTING_OFF };
        self.jerk_factor = (self.jerk_factor * change).clamp(least, JERK_LIMIT);
    }

    fn is_moving(&self) -> bool {
        let Some((newest, last, _)) = self.readings.back() else { return false };
        let limit = self.steps() * MOVING_STEPS;
        let readings = self.readings.iter().rev();
        let mut recent = readings.take_while(|(at, ..)| newest.seconds_since(*at) < MOVING_SPAN);
        recent.any(|(_, values, _)| {
            let moved = way(values, last);
            (0..3).any(|i| moved[i].abs() > limit[i])
        })
    }

    /// Returns the encoders' steps that their noise amounts to, m, m, rad.
    fn steps(&self) -> Vector3<f64> {
        self.noise.variance().map(|v| (12.0 * v).sqrt())
    }

    /// Returns the climber at an instant: interpolated between two readings, else moved on with its
    /// rates. `None` without readings.
    pub fn at(&self, stamp: Stamp) -> Option<ClimberAt> {
        let after = self.readings.partition_point(|(at, _, _)| *at < stamp);
        let before = after.checked_sub(1).and_then(|i| self.readings.get(i));
        let next = self.readings.get(after);
        let (nearest, distance) = match (before, next) {
            (Some(a), Some(b)) => {
                let (since, until) = (stamp.seconds_since(a.0), b.0.seconds_since(stamp));
                (a, if since + until < READINGS_INTERPOLATED { 0.0 } else { since.min(until) })
            }
            (Some(a), None) => (a, stamp.seconds_since(a.0)),
            (None, Some(b)) => (b, b.0.seconds_since(stamp)),
            (None, None) => return None,
        };
        let noise = self.noise.variance().map(f64::sqrt);
        let (rates, rate_sigmas) = self.rates(stamp, &noise);
        let values = match (before, next) {
            (Some(a), Some(b)) => {
                let span = b.0.seconds_since(a.0);
                let share = if span > 0.0 { stamp.seconds_since(a.0) / span } else { 0.0 };
                a.1 + way(&a.1, &b.1) * share
            }
            _ => nearest.1 + rates * stamp.seconds_since(nearest.0),
        };
        Some(ClimberAt {
            values,
            rates,
            noise,
            growth: rate_sigmas * distance,
            rate_sigmas,
            distance,
            rest: nearest.2,
        })
    }

    /// Rates from the readings around an instant, with their standard deviations.
    fn rates(&self, stamp: Stamp, noise: &Vector3<f64>) -> (Vector3<f64>, Vector3<f64>) {
        let fastest = Vector3::from(SPEED);
        let recent =
            || self.readings.iter().filter(|(s, _, _)| s.seconds_since(stamp).abs() < RATE_SPAN);
        let (Some(first), Some(last)) = (recent().next(), recent().next_back()) else {
            return (Vector3::zeros(), fastest);
        };
        let span = last.0.seconds_since(first.0);
        if span <= SHORTEST_RATE_SPAN {
            return (Vector3::zeros(), fastest);
        }
        let rates = way(&first.1, &last.1);
        let step = noise * 12f64.sqrt();
        let sigmas = (step / span + Vector3::from(DRIVE_ACCELERATION) * span).inf(&fastest);
        ((rates / span).map(|r| if r.is_finite() { r } else { 0.0 }), sigmas)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readings_are_missing_after_two_of_their_intervals_however_they_come() {
        let rest = ClimberHeightTilt { height: 2.8, tilt: nalgebra::UnitQuaternion::identity() };
        let start = Stamp::from_nanos(1_760_001_000_000_000_000);
        // Readings in a burst, interval of the bursts (s), latency (s), age that is missing (s).
        for (burst, interval, latency, due) in [
            (1, 0.1, 0.0, 0.2),
            (1, 0.02, 0.0, 0.04),
            (1, 0.02, 0.05, 0.14),
            (1, 0.001, 0.0, 0.03),
            (20, 0.1, 0.0, 0.2),
        ] {
            let mut track = ClimberTrack::new(&ClimberConfig::default());
            for i in 0..100 {
                // The last interval is a dropout of 2 s.
                let gap = if i < 99 { 0.0 } else { 2.0 };
                let t = f64::from(i / burst) * interval + f64::from(i % burst) * 3e-4 + gap;
                track.add(start.plus_seconds(t), Vector3::zeros(), rest);
                track.note_latency(latency);
            }
            let last = track.newest().unwrap().0;
            let missing = |age: f64| track.missing_for(last.plus_seconds(age)).is_some();
            let found = [missing(0.9 * due), missing(1.1 * due)];
            assert_eq!(found, [false, true], "{burst} every {interval} s, {latency} s old");
        }
    }

    #[test]
    fn an_instant_beyond_the_readings_is_where_the_climber_has_moved_to() {
        let mut track = ClimberTrack::new(&ClimberConfig::default());
        let rest = ClimberHeightTilt { height: 2.8, tilt: nalgebra::UnitQuaternion::identity() };
        let start = Stamp::from_nanos(1_760_001_000_000_000_000);
        let truth = |t: f64| Vector3::new(0.3 * t + 0.05 * t * t, -0.2 * t, 3.1 + 0.15 * t);
        for i in 0..100 {
            let t = f64::from(i) * 0.02;
            let mut reading = truth(t).map(|x| (x * 1e3).round() * 1e-3);
            reading.z = wrap_angle(reading.z);
            assert!(track.add(start.plus_seconds(t), reading, rest).is_some());
            assert!(track.add(start.plus_seconds(t), reading, rest).is_none());
            if i < 10 {
                continue;
            }
            for ahead in [-0.01, 0.0, 0.007, 0.019] {
                let at = track.at(start.plus_seconds(t + ahead)).unwrap();
                let mut error = at.values - truth(t + ahead);
                error.z = wrap_angle(error.z);
                assert!(error.amax() < 3e-3, "{t} {ahead}: {error}");
                assert_eq!(at.distance > 0.0, ahead > 0.0);
            }
        }
        assert!(track.at(start.plus_seconds(4.0)).unwrap().growth.x > 0.3);
    }

    #[test]
    fn between_readings_far_apart_the_climber_may_have_moved() {
        let mut track = ClimberTrack::new(&ClimberConfig::default());
        let rest = ClimberHeightTilt { height: 2.8, tilt: nalgebra::UnitQuaternion::identity() };
        let at = |t: f64| Stamp::from_nanos(1_760_001_000_000_000_000).plus_seconds(t);
        for t in (0..20).map(|k| f64::from(k) * 0.02).chain([1.4]) {
            assert!(track.add(at(t), Vector3::zeros(), rest).is_some());
        }
        let near = track.at(at(0.37)).unwrap();
        assert_eq!((near.distance, near.growth), (0.0, Vector3::zeros()));
        let far = track.at(at(0.88)).unwrap();
        assert!((far.distance - 0.5).abs() < 1e-6 && far.growth.x > 0.01, "{far:?}");
    }

    #[test]
    fn jerk_grows_with_surprises_and_a_standing_climber_keeps_room_to_set_off() {
        let mut track = ClimberTrack::new(&ClimberConfig::default());
        track.adapt_jerk(30.0);
        assert!(track.jerk_factor > SETTING_OFF);
        (0..1000).for_each(|_| track.adapt_jerk(1.0));
        assert_eq!(track.jerk_factor, SETTING_OFF);
    }
}
