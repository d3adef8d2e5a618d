//! Jitter of the image stamps (milliseconds on USB, where a driver stamps on arrival), identified
//! from the stamps: a camera exposes at equal intervals. A single late stamp does not count: the
//! gates reject it. Equations: `docs/src/equations.md`, "Markers".

use rig_model::Stamp;
use std::collections::VecDeque;

/// Number of stamps kept: two seconds at 30 Hz.
pub const KEPT: usize = 64;
/// Fewest intervals that say anything.
const FEWEST: usize = 8;
/// Intervals that measure the period, in median intervals; others are duplicates and gaps.
const MEASURES: std::ops::Range<f64> = 0.5..3.5;
/// Smaller jitter may be that of the exposures themselves, which the stamps report correctly, s.
const SMALLEST: f64 = 0.5e-3;
/// Median of the absolute value of a normal distribution, in standard deviations.
const MEDIAN: f64 = 0.6745;

/// Returns the standard deviation of the stamps, s; 0 below 0.5 ms and of too few.
pub fn sigma(stamps: &VecDeque<Stamp>) -> f64 {
    // In the order of the stamps: images may arrive late.
    let mut sorted = [Stamp::default(); KEPT];
    let count = stamps.len().min(KEPT);
    sorted.iter_mut().zip(stamps).for_each(|(to, stamp)| *to = *stamp);
    let sorted = &mut sorted[..count];
    sorted.sort_unstable();
    if count <= FEWEST {
        return 0.0;
    }
    let mut intervals = [0.0; KEPT];
    let intervals = &mut intervals[..count - 1];
    for (interval, pair) in intervals.iter_mut().zip(sorted.windows(2)) {
        *interval = pair[1].seconds_since(pair[0]);
    }
    let typical = median(intervals);
    if typical <= 0.0 {
        return 0.0;
    }
    // The mean: of stamps that are cut off to a grid (30, 30, 40 ms) most intervals are equal.
    let periods = |interval: f64| (interval / typical).round().max(1.0);
    let (time, count) = intervals
        .iter()
        .filter(|interval| MEASURES.contains(&(**interval / typical)))
        .fold((0.0, 0.0), |(time, count), interval| (time + interval, count + periods(*interval)));
    let period = time / count;
    for interval in intervals.iter_mut() {
        *interval = (*interval - periods(*interval) * period).abs();
    }
    let sigma = median(intervals) / (MEDIAN * std::f64::consts::SQRT_2);
    if sigma < SMALLEST { 0.0 } else { sigma }
}

fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_simulator::random::Random;

    fn stamps(offset: impl Fn(usize) -> f64, kept: impl Fn(usize) -> bool) -> VecDeque<Stamp> {
        let at = |k: usize| Stamp::from_nanos(1_000_000_000).plus_seconds(k as f64 / 30.0);
        (0..KEPT).filter(|k| kept(*k)).map(|k| at(k).plus_seconds(offset(k))).collect()
    }

    #[test]
    fn jitter_is_found_and_lost_images_or_one_late_stamp_are_none() {
        let exact = stamps(|_| 0.0, |_| true);
        assert!(sigma(&exact) < 1e-6);
        assert_eq!(sigma(&exact.iter().take(5).copied().collect()), 0.0);
        let lost = stamps(|_| 0.0, |k| k % 5 != 0 && k % 7 != 0);
        assert!(sigma(&lost) < 1e-6);
        let late = stamps(|k| if k == 30 { 0.012 } else { 0.0 }, |_| true);
        assert!(sigma(&late) < 1e-6);
        let mut twice = exact.clone();
        twice.extend(exact.iter().step_by(5).map(|stamp| stamp.plus_seconds(1e-6)));
        twice.drain(..twice.len() - KEPT);
        assert!(sigma(&twice) < 1e-6, "{}", sigma(&twice));
        for grid in [0.01, 0.004] {
            let cut = |k: usize| -((k as f64 / 30.0) % grid);
            let found = sigma(&stamps(cut, |k| k % 9 != 0));
            let jitter = grid / 12f64.sqrt();
            assert!((found / jitter - 1.0).abs() < 0.5, "cut off to {grid} s: {found}");
        }
        let mut random = Random::new(1);
        let noise: Vec<f64> = (0..KEPT).map(|_| random.normal()).collect();
        assert_eq!(sigma(&stamps(|k| 1e-4 * noise[k], |_| true)), 0.0);
        for jitter in [0.001, 0.005] {
            let mut jittered = stamps(|k| jitter * noise[k], |k| k % 9 != 0);
            let found = sigma(&jittered);
            assert!((found / jitter - 1.0).abs() < 0.4, "{jitter}: {found}");
            jittered.make_contiguous().swap(20, 22);
            assert_eq!(sigma(&jittered), found, "the order of arrival does not count");
        }
    }
}
