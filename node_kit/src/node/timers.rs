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
    /// On simulated time; set when that is first known.
    next_simulated: Option<Stamp>,
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
        let period = self.period.as_secs_f64();
        let next = *self.next_simulated.get_or_insert_with(|| stamp.plus_seconds(period));
        let due = stamp >= next;
        // A jump back in time (a bag that loops) restarts the period.
        if due || next.seconds_since(stamp) > period {
            self.next_simulated = Some(stamp.plus_seconds(period));
        }
        due
    }

    fn is_due(&mut self, steady: Instant) -> bool {
        let due = steady >= self.next;
        if due {
            // In step with the first time, skipping the missed ones.
            let missed = steady.duration_since(self.next).as_nanos() / self.period.as_nanos();
            let steps = u32::try_from(missed).unwrap_or(u32::MAX - 1) + 1;
            self.next = self
                .period
                .checked_mul(steps)
                .and_then(|d| self.next.checked_add(d))
                .unwrap_or(steady + self.period);
        }
        due
    }
}
