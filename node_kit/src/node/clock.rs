//! The node's clock: the system's, or `/clock` where `use_sim_time` is set.

use crate::inbox::now;
use rig_model::Stamp;
use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicI64, Ordering},
};
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// Tells the time that stamps are made of. Clones tell the same.
#[derive(Clone, Debug, Default)]
pub struct Clock(Arc<State>);

#[derive(Debug, Default)]
struct State {
    simulated: AtomicBool,
    nanos: AtomicI64,
}

impl Clock {
    /// Now. Simulated time is zero until the first `/clock` message.
    pub fn now(&self) -> Stamp {
        if self.is_simulated() {
            Stamp::from_nanos(self.0.nanos.load(Ordering::Acquire))
        } else {
            system_now()
        }
    }

    /// Does the time come from `/clock`?
    pub fn is_simulated(&self) -> bool {
        self.0.simulated.load(Ordering::Acquire)
    }

    /// Notices from now on when somebody sets it.
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

/// Notices when the system's clock is set, by the one that nobody can set and that runs at the same rate beside it.
#[derive(Clone, Debug)]
pub struct ClockWatch {
    clock: Clock,
    began: Instant,
    /// What it would have shown at `began`, had it always been what it is now, ns.
    shown_at_began: Option<i64>,
}

impl ClockWatch {
    /// So much is reading two clocks, ns.
    const SLACK: i64 = 50_000;
    /// Between two readings so far apart this thread was held up, ns.
    const HELD_UP: i64 = 100_000;

    /// By how much the clock was set since the last call, ns. Simulated time runs as it likes: nobody sets that.
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
            // It was read at some instant between the two.
            let (least, most) = (shown - after, shown - before);
            let known = self.shown_at_began;
            if known.is_some_and(|known| (least - Self::SLACK..=most + Self::SLACK).contains(&known)) {
                return None;
            }
            if narrowest.is_none_or(|(least, most)| after - before < most - least) {
                narrowest = Some((least, most));
            }
            if after - before < Self::HELD_UP {
                break;
            }
        }
        // The least, where the thread was held up each time: an arrival that seems late is one of many, one that seems early would
        // be believed. The next call mends it.
        let (least, _) = narrowest?;
        self.shown_at_began.replace(least).map(|known| least - known)
    }

    fn elapsed(&self) -> i64 {
        i64::try_from(self.began.elapsed().as_nanos()).unwrap_or(i64::MAX)
    }
}

/// The system's time, whatever `use_sim_time` says: for lines of the log before a node is there.
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
    fn a_clock_that_is_set_is_noticed_to_a_tenth_of_a_millisecond() {
        let clock = Clock::default();
        let mut watch = clock.watch();
        let mut told = 0;
        for by in [0, 200_000, 30_000_000, 5_000_000_000, -5_000_000_000, -300_000, 1_700_000_000_000_000_000]
        {
            // As if it had been set: what it would have shown is another.
            watch.shown_at_began = watch.shown_at_began.map(|shown| shown - by);
            told = (0..100).filter_map(|_| watch.set_by()).sum::<i64>();
            assert!((told - by).abs() < 100_000, "{by}: {told}");
        }
        assert!(told > 0);
        // Simulated time runs as it likes; afterwards nothing is known of the system's.
        clock.set_simulated(true);
        assert_eq!(watch.set_by(), None);
        clock.set_simulated(false);
        assert_eq!(watch.set_by(), None);
        assert_eq!(watch.set_by(), None);
    }
}
