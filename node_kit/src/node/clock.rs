//! The node's clock: the system's, or `/clock` where `use_sim_time` is set.

use rig_model::Stamp;
use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicI64, Ordering},
};
use std::time::{SystemTime, UNIX_EPOCH};

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

    pub(crate) fn set_simulated(&self, simulated: bool) {
        self.0.simulated.store(simulated, Ordering::Release);
    }

    pub(crate) fn set(&self, stamp: Stamp) {
        self.0.nanos.store(stamp.as_nanos(), Ordering::Release);
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
