//! A node's timers, on system or simulated time.

use super::clock::Clock;
use crate::inbox::now;
use rig_model::Stamp;
use std::time::{Duration, Instant};

/// Periodic timers that yield inputs.
pub(crate) struct Timers<I>(Vec<Timer<I>>);

struct Timer<I> {
    period: Duration,
    make: Box<dyn FnMut() -> I + Send>,
    /// On the steady clock.
    next: Instant,
    /// On simulated time, ns; set when that is first known.
    next_simulated: Option<i64>,
}

impl<I> Default for Timers<I> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<I> Timers<I> {
    pub fn add(&mut self, period: Duration, make: impl FnMut() -> I + Send + 'static) {
        let period = period.max(Duration::from_micros(100));
        self.0.push(Timer {
            period,
            make: Box::new(make),
            next: now() + period,
            next_simulated: None,
        });
    }

    pub fn clear(&mut self) {
        self.0.clear();
    }

    /// Starts all periods now.
    pub fn restart(&mut self) {
        let now = now();
        for timer in &mut self.0 {
            (timer.next, timer.next_simulated) = (now + timer.period, None);
        }
    }

    /// When the next timer is due; `None` on simulated time, where each `/clock` message wakes the
    /// node.
    pub fn next(&self, clock: &Clock) -> Option<Instant> {
        if clock.is_simulated() { None } else { self.0.iter().map(|t| t.next).min() }
    }

    /// Inputs of the timers that are due, one of each.
    pub fn due(&mut self, clock: &Clock) -> Vec<I> {
        let simulated = clock.is_simulated().then(|| clock.now());
        let steady = now();
        let due = self.0.iter_mut().filter_map(|timer| {
            let due = match simulated {
                Some(stamp) => timer.is_due_simulated(stamp),
                None => timer.is_due(steady),
            };
            due.then(|| (timer.make)())
        });
        due.collect()
    }
}

impl<I> Timer<I> {
    fn is_due_simulated(&mut self, stamp: Stamp) -> bool {
        let period = i64::try_from(self.period.as_nanos()).unwrap_or(i64::MAX);
        let now = stamp.as_nanos();
        let next = *self.next_simulated.get_or_insert(now.saturating_add(period));
        let late = now.saturating_sub(next);
        if late >= 0 {
            // In step with the first time, skipping the missed ones.
            self.next_simulated = Some(now.saturating_add(period - late % period));
        } else if late < -period {
            // A jump back in time (a bag that loops) restarts the period.
            self.next_simulated = Some(now.saturating_add(period));
        }
        late >= 0
    }

    fn is_due(&mut self, steady: Instant) -> bool {
        let Some(late) = steady.checked_duration_since(self.next) else { return false };
        // In step with the first time, skipping the missed ones.
        let over = u64::try_from(late.as_nanos() % self.period.as_nanos()).unwrap_or(0);
        self.next = steady + self.period - Duration::from_nanos(over);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A timer of 0.25 s on a clock of 10 Hz.
    #[test]
    fn a_timer_keeps_its_rate_on_a_coarse_simulated_clock_and_restarts_after_a_jump_back() {
        let clock = Clock::default();
        clock.set_simulated(true);
        let mut timers = Timers::default();
        timers.add(Duration::from_millis(250), || ());
        let mut run = |from: i64, to: i64| {
            let ticks = (from..to).map(|tick| {
                clock.set(Stamp::from_nanos(tick * 100_000_000));
                timers.due(&clock).len()
            });
            ticks.sum::<usize>()
        };
        assert_eq!(run(10_000, 10_100), 39);
        // Skipped periods are one input.
        assert_eq!(run(10_200, 10_201), 1);
        assert_eq!(run(5_000, 5_003), 0);
        assert_eq!(run(5_003, 5_101), 40);
    }
}
