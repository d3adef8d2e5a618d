//! Stamps of IMU samples that a driver stamps on arrival. A USB–serial adapter collects bytes (16
//! ms by default) and hands over several samples at once, so that they get nearly one stamp, which
//! is right for the last only. They are taken as equally spaced, none later than its arrival.

use rig_model::Stamp;
use std::collections::VecDeque;

/// Number of stamps that are looked at …
const KEPT: usize = 200;
/// … and the fewest that say anything.
const FEWEST: usize = 24;
/// An interval below this multiple of the mean is one within a burst …
const SHORT: f64 = 0.25;
/// … and one above this multiple is one between two.
const LONG: f64 = 1.5;
/// Share of short intervals from which on the samples come in bursts, for good.
const BURSTS: f64 = 0.3;
/// Share of the last sample's earliness, after a lost one, that the next burst makes up for.
const CATCH_UP: f64 = 0.5;
/// A burst is at most this much longer than the mean one.
const LONGEST: f64 = 1.5;
/// A longer interval starts afresh, s.
const INTERRUPTED: f64 = 1.0;

/// Bursts of samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bursts {
    /// Time between two samples, s.
    pub period: f64,
    /// Mean number of samples of a burst.
    pub samples: f64,
}

/// Newest stamps, as they arrived and as they count.
#[derive(Clone, Debug, Default)]
pub struct ImuStamps {
    arrived: VecDeque<Stamp>,
    newest: Stamp,
    /// Bursts in which the samples come, if they do.
    pub bursts: Option<Bursts>,
    /// By how much the last sample of the newest complete burst counts too early, s.
    early: f64,
}

impl ImuStamps {
    /// Returns the stamp with which a sample counts: its own unless the samples come in bursts.
    /// `repeated`: it has the values of the newest one.
    pub fn add(&mut self, stamp: Stamp, repeated: bool) -> Stamp {
        let interval = self.arrived.back().map(|last| stamp.seconds_since(*last));
        let early = self.arrived.back().map_or(0.0, |last| last.seconds_since(self.newest));
        match interval {
            Some(0.0) if repeated => return self.newest,
            Some(late) if (-INTERRUPTED..0.0).contains(&late) => return stamp,
            Some(next) if next.abs() < INTERRUPTED => self.arrived.push_back(stamp),
            _ => self.arrived = VecDeque::from([stamp]),
        }
        if self.arrived.len() > KEPT {
            self.arrived.pop_front();
        }
        // The sample before the first of a burst has the right stamp.
        let mean = self.mean_interval();
        if interval.is_some_and(|interval| interval > LONG * mean) {
            (self.bursts, self.early) = (self.find(mean).or(self.bursts), early);
        }
        self.newest = match self.bursts {
            Some(Bursts { period, samples }) => {
                let earliest = stamp.plus_seconds(-LONGEST * samples * period);
                let step = period + CATCH_UP * self.early / samples;
                self.newest.plus_seconds(step).max(earliest).min(stamp)
            }
            None => stamp,
        };
        self.newest
    }

    fn mean_interval(&self) -> f64 {
        match (self.arrived.front(), self.arrived.back()) {
            (Some(first), Some(last)) if self.arrived.len() > 1 => {
                last.seconds_since(*first) / (self.arrived.len() - 1) as f64
            }
            _ => 0.0,
        }
    }

    /// Returns the bursts of the stamps that are kept. `mean` is their mean interval, s.
    fn find(&self, mean: f64) -> Option<Bursts> {
        let count = self.arrived.len() - 1;
        if count < FEWEST {
            return None;
        }
        let intervals = || {
            self.arrived.iter().zip(self.arrived.iter().skip(1)).map(|(a, b)| b.seconds_since(*a))
        };
        let short = intervals().filter(|interval| *interval < SHORT * mean).count();
        if self.bursts.is_none() && (short as f64) < BURSTS * count as f64 {
            return None;
        }
        // From the end of one burst to the end of another.
        let mut ends = intervals().enumerate().filter(|(_, interval)| *interval > LONG * mean);
        let between = ends.clone().count();
        let (first, last) = (ends.next()?.0, ends.next_back()?.0);
        let span = self.arrived.get(last)?.seconds_since(*self.arrived.get(first)?);
        let samples = (last - first) as f64;
        Some(Bursts { period: span / samples, samples: samples / (between - 1) as f64 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_simulator::random::Random;

    const PERIOD: f64 = 0.01;

    /// Largest difference of a stamp from the time of its sample after 3 s, where samples arrive in
    /// bursts of `burst`, stamped `apart` (s) from each other, and those that `lost` names do not.
    fn largest_error(burst: usize, apart: f64, jitter: f64, lost: impl Fn(usize) -> bool) -> f64 {
        let (mut stamps, mut random) = (ImuStamps::default(), Random::new(3));
        let (start, mut previous, mut worst) = (Stamp::from_nanos(1), Stamp::default(), 0.0f64);
        let mut delay = 0.0;
        for k in 0..1000 {
            let taken = k as f64 * PERIOD;
            if k % burst == 0 {
                delay = jitter * random.unit();
            }
            let arrives = (k / burst * burst + burst - 1) as f64 * PERIOD
                + apart * (k % burst) as f64
                + delay;
            if lost(k) {
                continue;
            }
            let counts = stamps.add(start.plus_seconds(arrives), false);
            assert!(counts > previous || apart == 0.0 && counts == previous, "{k}");
            previous = counts;
            if k > 300 && !(600..680).contains(&k) {
                worst = worst.max((counts.seconds_since(start) - taken).abs());
            }
        }
        assert_eq!(stamps.bursts.is_some(), burst > 1);
        worst
    }

    #[test]
    fn samples_of_a_burst_are_equally_spaced_and_others_keep_their_stamps() {
        assert!(largest_error(1, 1e-4, 0.0, |_| false) < 1e-9);
        // One that is stamped with jitter, but singly.
        assert!(largest_error(1, 1e-4, 0.005, |_| false) < 0.0051);
        for (burst, apart) in [(2, 1e-4), (5, 1e-4), (8, 1e-4), (2, 0.0), (5, 0.0), (8, 0.0)] {
            let error = largest_error(burst, apart, 0.0, |_| false);
            assert!(error < 0.0025, "{burst}: {error}");
            let error = largest_error(burst, apart, 0.003, |_| false);
            assert!(error < 0.005, "{burst}, jitter: {error}");
            let error = largest_error(burst, apart, 0.0, |k| k == 500 || (600..630).contains(&k));
            assert!(error < 0.04, "{burst}, lost: {error}");
        }
    }

    /// Bursts that stop and come again: the filter identifies everything again once, not each time.
    #[test]
    fn bursts_that_stop_stay_known_and_single_samples_keep_their_stamps() {
        let mut stamps = ImuStamps::default();
        let (mut found, mut worst) = (0, 0.0f64);
        for k in 0..3000 {
            let burst = if k / 500 % 2 == 0 { 5 } else { 1 };
            let arrives = (k / burst * burst + burst - 1) as f64 * PERIOD;
            let at = Stamp::from_nanos(1).plus_seconds(arrives + 1e-4 * (k % burst) as f64);
            let known = stamps.bursts.is_some();
            let counts = stamps.add(at, false);
            found += usize::from(!known && stamps.bursts.is_some());
            if k % 500 > 300 && k > 500 {
                worst = worst
                    .max((counts.seconds_since(Stamp::from_nanos(1)) - k as f64 * PERIOD).abs());
            }
        }
        assert_eq!(found, 1);
        assert!(worst < 0.0025, "{worst}");
    }

    #[test]
    fn duplicates_and_late_samples_are_left_to_the_filter() {
        let at = |ms: i64| Stamp::from_nanos(ms * 1_000_000);
        let mut stamps = ImuStamps::default();
        for k in 0..200 {
            assert_eq!(stamps.add(at(10 * k), false), at(10 * k));
            assert_eq!(stamps.add(at(10 * k), true), at(10 * k), "the same sample twice");
            assert_eq!(stamps.add(at(10 * k - 5), false), at(10 * k - 5), "late");
        }
        assert_eq!(stamps.bursts, None);
    }
}
