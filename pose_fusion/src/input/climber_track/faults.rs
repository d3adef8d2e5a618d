//! Detection of encoder readings that are stuck or leap.

use super::{ClimberTrack, MOVING_SPAN, MOVING_STEPS, RATE_SPAN, Reading, SPEED, way};
use rig_model::Stamp;

/// Number of equal readings of encoders that stand, and their shortest time, s: at a high rate
/// those of a moving climber repeat as well.
const STANDING: usize = 3;
const SHORTEST: f64 = 0.03;
/// Largest acceleration of a drive (m/s², m/s², rad/s²).
const BRAKES: [f64; 3] = [3.0, 3.0, 2.0];
/// Readings that have been equal for this time may be stuck, s.
const STOOD: f64 = 0.2;
/// Readings leap where they differ by more than this (m, m, rad) beside three sigma of the speed.
const LEAP: f64 = 0.05;

/// Returns whether a climber can have moved from one reading to a later one: by `slack` (m, m, rad)
/// beside three sigma of [`SPEED`].
fn is_in_reach(to: &Reading, from: &Reading, slack: f64) -> bool {
    let way = way(&from.1, &to.1);
    let lasts = to.0.seconds_since(from.0);
    (0..3).all(|i| way[i].abs() <= slack + 3.0 * SPEED[i] * lasts)
}

impl ClimberTrack {
    /// Returns for each axis whether the newest readings are equal: at rest, or stuck.
    pub fn standing(&self) -> [bool; 3] {
        let equal = |i: usize| {
            let newest = || self.readings.iter().rev().take(STANDING).map(|(_, values, _)| values);
            newest().next().is_some_and(|last| newest().all(|values| values[i] == last[i]))
        };
        let newest = self.readings.back().map(|(at, _, _)| *at);
        let lasts =
            |i: usize| newest.is_some_and(|at| at.seconds_since(self.standing_since[i]) > SHORTEST);
        std::array::from_fn(|i| equal(i) && lasts(i))
    }

    /// Returns for each axis whether it moves: it does not stand, and is not stuck.
    pub fn moving(&self) -> [bool; 3] {
        let standing = self.standing();
        std::array::from_fn(|i| !standing[i] && self.stuck[i].is_none())
    }

    /// Returns since when the readings of each axis have been equal.
    pub fn standing_since(&self) -> [Option<Stamp>; 3] {
        self.standing_since.map(|since| self.readings.back().map(|_| since))
    }

    /// Returns since when each axis has stood that may be stuck, encoder time: for [`STOOD`] before
    /// `read`. While another axis moves, one that has never moved is taken for one that the climber
    /// does not use.
    pub fn may_have_stuck(&self, read: Stamp) -> [Option<Stamp>; 3] {
        let since = self.standing_since();
        let stands = since.map(|since| since.filter(|at| read.seconds_since(*at) > STOOD));
        let moves = stands.contains(&None);
        std::array::from_fn(|i| stands[i].filter(|_| self.has_moved[i] || !moves))
    }

    /// Returns since when each axis has stood that moved before, so fast that by now it would have
    /// moved on by several steps.
    pub fn stopped_since(&self) -> [Option<Stamp>; 3] {
        let least = self.steps() * MOVING_STEPS;
        let (since, standing) = (self.standing_since(), self.standing());
        std::array::from_fn(|i| {
            let since = since[i].filter(|_| standing[i])?;
            let (newest, last, _) = self.readings.back()?;
            let before = self.readings.iter().rev().filter(|(at, _, _)| *at < since);
            let recent = before.take_while(|(at, _, _)| since.seconds_since(*at) < MOVING_SPAN);
            let (first, values, _) = recent.last()?;
            let way = way(values, last)[i].abs();
            let missed = way / since.seconds_since(*first) * newest.seconds_since(since);
            (way > least[i] && missed > least[i]).then_some(since)
        })
    }

    /// Notes the axes whose encoders may have been stuck since an instant, until they move.
    pub fn suspect_stuck(&mut self, since: [Option<Stamp>; 3]) {
        self.stuck = std::array::from_fn(|i| self.stuck[i].or(since[i]));
    }

    /// Returns whether two neighboring readings within `RATE_SPAN` of `stamp` differ by more than a
    /// climber moves between them: neither position nor rate can be derived from them.
    pub fn leaps_near(&self, stamp: Stamp) -> bool {
        let near = |at: &Stamp| at.seconds_since(stamp).abs() < RATE_SPAN;
        let pairs = self.readings.iter().zip(self.readings.iter().skip(1));
        pairs.filter(|(a, b)| near(&a.0) || near(&b.0)).any(|(a, b)| !is_in_reach(b, a, LEAP))
    }

    /// Returns whether the newest readings leap.
    pub fn leaps_now(&self) -> bool {
        self.readings.back().is_some_and(|(newest, _, _)| self.leaps_near(*newest))
    }

    /// Returns whether the reading at `stamp` is the first of an axis that differs after equal
    /// ones, by no more than a climber drives (3 sigma of [`SPEED`]) in the time for which they
    /// were equal, and by more than one that sets off.
    pub fn moves_on(&self, stamp: Stamp) -> bool {
        let place = self.place_of(stamp);
        let Some(reading) = self.readings.get(place) else { return false };
        let before = || self.readings.iter().take(place).rev();
        let steps = self.steps();
        (0..3).any(|i| {
            let Some((last, stood, _)) = before().next() else { return false };
            let interval = stamp.seconds_since(*last);
            let sets_off = 2.0 * steps[i] + BRAKES[i] * interval * interval / 2.0;
            let way = way(stood, &reading.1);
            before().take_while(|(_, v, _)| v[i] == stood[i]).last().is_some_and(|first| {
                let lasts = stamp.seconds_since(first.0);
                way[i].abs() > sets_off && lasts > STOOD && is_in_reach(reading, first, 0.0)
            })
        })
    }

    fn place_of(&self, stamp: Stamp) -> usize {
        self.readings.partition_point(|(at, _, _)| at.seconds_since(stamp) < -1e-6)
    }

    /// Returns whether an axis may be stuck.
    pub fn may_be_stuck(&self) -> bool {
        self.stuck.iter().any(Option::is_some)
    }

    /// Forgets that an axis may be stuck: the climber has been seen to stand.
    pub fn clear_stuck(&mut self) {
        self.stuck = [None; 3];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{config::ClimberConfig, measurements::geometry::ClimberHeightTilt};
    use nalgebra::Vector3;
    use rig_model::wrap_angle;

    const START: Stamp = Stamp::from_nanos(1_760_001_000_000_000_000);

    fn rest() -> ClimberHeightTilt {
        ClimberHeightTilt { height: 2.8, tilt: nalgebra::UnitQuaternion::identity() }
    }

    /// Readings every 20 ms.
    fn track(count: i32, values: impl Fn(f64) -> Vector3<f64>) -> ClimberTrack {
        let mut track = ClimberTrack::new(&ClimberConfig::default());
        for t in (0..count).map(|i| f64::from(i) * 0.02) {
            track.add(START.plus_seconds(t), values(t), rest());
        }
        track
    }

    #[test]
    fn an_axis_that_stopped_is_distinguished_from_one_that_stood_and_from_one_that_creeps() {
        let mut track = ClimberTrack::new(&ClimberConfig::default());
        let mut stuck = None;
        for i in 0..60 {
            let t = f64::from(i) * 0.02;
            // x gets stuck after 1 s, y stands, and the turn goes on.
            let x = (0.12 * t.min(1.0) * 1e3).round() * 1e-3;
            track.add(START.plus_seconds(t), Vector3::new(x, 0.5, 0.3 * t), rest());
            let [stopped, stood, turning] = track.stopped_since();
            assert_eq!((stood, turning), (None, None));
            stuck = stuck.or(stopped.map(|at| (t, at.seconds_since(START))));
        }
        let (found, since) = stuck.unwrap();
        assert!((since - 1.0).abs() < 0.021 && found < 1.09, "since {since}, found at {found}");
        assert_eq!(track.standing(), [true, true, false]);
        // At 10 mm/s three readings may be equal.
        let mut creeping = ClimberTrack::new(&ClimberConfig::default());
        for i in 0..200 {
            let t = f64::from(i) * 0.02;
            let x = (0.01 * t * 1e3).round() * 1e-3;
            creeping.add(START.plus_seconds(t), Vector3::new(x, 0.5, 0.3 * t), rest());
            assert_eq!(creeping.stopped_since(), [None; 3]);
        }
    }

    #[test]
    fn repeated_readings_at_a_high_rate_do_not_stand_and_those_that_do_have_since_they_began() {
        let mut track = ClimberTrack::new(&ClimberConfig::default());
        for i in 0..3000 {
            // 0.25 m/s in steps of 1 mm at 1 kHz: four equal readings each, until 1 s.
            let t = f64::from(i) * 1e-3;
            let x = (0.25 * t.min(1.0) * 1e3).floor() * 1e-3;
            track.add(START.plus_seconds(t), Vector3::new(x, 0.0, 0.0), rest());
            assert!(t > 1.0 || !track.standing()[0], "{t}");
        }
        let since = track.standing_since().map(|since| since.unwrap().seconds_since(START));
        assert!(track.standing()[0] && (since[0] - 1.0).abs() < 0.004, "{since:?}");
        assert_eq!(since[1], 0.0, "longer than the readings that are kept");
    }

    #[test]
    fn leaping_readings_are_distinguished_from_a_fast_climber() {
        // Instants near which readings leap.
        let leaps = |values: &dyn Fn(f64) -> Vector3<f64>| {
            let track = track(100, values);
            let found = |i: &i32| track.leaps_near(START.plus_seconds(f64::from(*i) * 0.02));
            (0..100).filter(found).collect::<Vec<_>>()
        };
        let fast = |t: f64| Vector3::new(1.4 * t, -1.4 * t, wrap_angle(3.0 + t));
        assert_eq!(leaps(&fast), Vec::<i32>::new());
        // One reading at 1 s, a step of the turn at 1 s.
        let wrong = |t: f64| if (t - 1.0).abs() < 1e-6 { 100.0 } else { 0.0 };
        assert_eq!(leaps(&|t| fast(t) + Vector3::x() * wrong(t)), (37..=63).collect::<Vec<_>>());
        let step = |t: f64| if t > 0.99 { 0.5 } else { 0.0 };
        assert_eq!(leaps(&|t| fast(t) + Vector3::z() * step(t)), (37..=62).collect::<Vec<_>>());
    }

    #[test]
    fn resumed_readings_are_distinguished_from_a_reset_out_of_reach() {
        // Readings that are equal from `since` until 1 s, then offset by `off`.
        let moves_on = |since: f64, off: f64| {
            let track = track(52, |t| {
                let x = 0.1 * t.min(since) + if t > 0.99 { off } else { 0.0 };
                Vector3::new(x, 0.3, wrap_angle(3.1))
            });
            [0.98, 1.0, 1.02].map(|t| track.moves_on(START.plus_seconds(t)))
        };
        assert_eq!(moves_on(0.5, 0.2), [false, true, false]);
        assert_eq!(moves_on(0.5, 10.0), [false; 3], "out of reach");
        assert_eq!(moves_on(0.9, 0.05), [false; 3], "stood for a moment");
        assert_eq!(moves_on(1.0, 0.05), [false; 3], "a jump while it drove");
    }

    #[test]
    fn an_axis_that_has_never_moved_is_not_stuck_while_another_moves() {
        let may = |values: fn(f64) -> Vector3<f64>| {
            track(50, values).may_have_stuck(START.plus_seconds(1.0)).map(|since| since.is_some())
        };
        assert_eq!(may(|t| Vector3::new(0.1 * t, 0.5, 0.0)), [false; 3]);
        assert_eq!(may(|t| Vector3::new(0.1 * t, t.min(0.5), 0.0)), [false, true, false]);
        assert_eq!(may(|t| Vector3::new(0.1 * t.min(0.5), 0.5, 0.0)), [true; 3]);
        assert_eq!(may(|_| Vector3::zeros()), [true; 3]);
    }
}
