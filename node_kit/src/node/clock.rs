//! The node's clock: the system's, or `/clock` where `use_sim_time` is set.

use crate::inbox::now;
use rig_model::Stamp;
use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicI64, Ordering},
};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// Time of the stamps. Clones share it.
#[derive(Clone, Debug, Default)]
pub struct Clock(Arc<State>);

#[derive(Debug, Default)]
struct State {
    simulated: AtomicBool,
    nanos: AtomicI64,
}

impl Clock {
    /// The current time. Simulated time is zero until the first `/clock` message.
    pub fn now(&self) -> Stamp {
        if self.is_simulated() {
            Stamp::from_nanos(self.0.nanos.load(Ordering::Acquire))
        } else {
            system_now()
        }
    }

    /// Returns whether the time comes from `/clock`.
    pub fn is_simulated(&self) -> bool {
        self.0.simulated.load(Ordering::Acquire)
    }

    /// Starts to watch for steps of the clock.
    pub fn watch(&self) -> ClockWatch {
        let mut watch = ClockWatch { clock: self.clone(), began: now(), shown_at_began: None };
        watch.set_by();
        watch
    }

    pub(crate) fn set_simulated(&self, simulated: bool) {
        self.0.simulated.store(simulated, Ordering::Release);
    }

    pub(crate) fn set(&self, stamp: Stamp) {
        self.0.nanos.store(stamp.as_nanos(), Ordering::Release);
    }
}

/// Detects steps of the system's clock by comparing it with the steady clock.
#[derive(Clone, Debug)]
pub struct ClockWatch {
    clock: Clock,
    began: Instant,
    /// Reading at `began` extrapolated from the latest one, ns.
    shown_at_began: Option<i64>,
}

impl ClockWatch {
    /// Uncertainty of reading two clocks, ns.
    const SLACK: i64 = 50_000;
    /// Time between two readings from which this thread counts as held up, ns.
    const HELD_UP: i64 = 100_000;

    /// Step of the clock since the last call, ns; `None` without one. Simulated time has no steps.
    pub fn set_by(&mut self) -> Option<i64> {
        let mut narrowest: Option<(i64, i64)> = None;
        for _ in 0..5 {
            let before = self.elapsed();
            let shown = self.clock.now().as_nanos();
            let after = self.elapsed();
            if self.clock.is_simulated() {
                self.shown_at_began = None;
                return None;
            }
            // The clock was read at some instant between the two.
            let (least, most) = (shown - after, shown - before);
            let known = self.shown_at_began;
            if known
                .is_some_and(|known| (least - Self::SLACK..=most + Self::SLACK).contains(&known))
            {
                return None;
            }
            if narrowest.is_none_or(|(least, most)| after - before < most - least) {
                narrowest = Some((least, most));
            }
            if after - before < Self::HELD_UP {
                break;
            }
        }
        // The lower bound, if the thread was held up each time: an arrival that seems late is an
        // outlier, one that seems early would be used. The next call corrects it.
        let (least, _) = narrowest?;
        self.shown_at_began.replace(least).map(|known| least - known)
    }

    fn elapsed(&self) -> i64 {
        i64::try_from(self.began.elapsed().as_nanos()).unwrap_or(i64::MAX)
    }
}

/// The system's time, whatever `use_sim_time` is.
#[allow(clippy::disallowed_methods, reason = "the clock of the shells")]
pub(crate) fn system_now() -> Stamp {
    let nanos = match SystemTime::now().duration_since(UNIX_EPOCH) {
        Ok(after) => i64::try_from(after.as_nanos()).unwrap_or(i64::MAX),
        Err(before) => i64::try_from(before.duration().as_nanos()).map_or(i64::MIN, |n| -n),
    };
    Stamp::from_nanos(nanos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_detected_to_a_tenth_of_a_millisecond() {
        let clock = Clock::default();
        let mut watch = clock.watch();
        let mut detected = 0;
        for by in [
            0,
            200_000,
            30_000_000,
            5_000_000_000,
            -5_000_000_000,
            -300_000,
            1_700_000_000_000_000_000,
        ] {
            // A step of the clock changes the extrapolated reading.
            watch.shown_at_began = watch.shown_at_began.map(|shown| shown - by);
            detected = (0..100).filter_map(|_| watch.set_by()).sum::<i64>();
            assert!((detected - by).abs() < 100_000, "{by}: {detected}");
        }
        assert!(detected > 0);
        // After simulated time, the first reading of the system's clock is the new reference.
        clock.set_simulated(true);
        assert_eq!(watch.set_by(), None);
        clock.set_simulated(false);
        assert_eq!(watch.set_by(), None);
        assert_eq!(watch.set_by(), None);
    }
}
