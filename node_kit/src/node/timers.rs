//! A node's timers, and the `/clock` that may drive them.

use super::{NodeError, handle::NodeHandle, kit::Kit};
use crate::{inbox::now, qos::Qos};
use rig_model::Stamp;
use std::{
    sync::Arc,
    time::{Duration, Instant},
};

/// A timer that becomes due again and again.
pub(crate) struct Timer<I> {
    pub(super) period: Duration,
    make: Box<dyn FnMut() -> I + Send>,
    /// On the steady clock.
    pub(crate) next: Instant,
    /// On simulated time; set when that is first known.
    pub(super) next_simulated: Option<Stamp>,
}

impl<I: Send + 'static> Kit<I> {
    /// An input every `period`, of the node's clock (simulated where `use_sim_time` is set). A node that is late gets one
    /// for all that it missed.
    pub fn timer(&mut self, period: Duration, make: impl FnMut() -> I + Send + 'static) {
        let period = period.max(Duration::from_micros(100));
        self.timers.push(Timer { period, make: Box::new(make), next: now() + period, next_simulated: None });
    }

    /// When the loop must look at the timers next.
    pub(crate) fn next_timer(&self) -> Option<Instant> {
        // On simulated time each /clock message wakes the loop.
        if self.clock.is_simulated() { None } else { self.timers.iter().map(|t| t.next).min() }
    }

    /// An input from a timer that is due.
    pub(crate) fn due_timer(&mut self) -> Option<I> {
        let (steady, stamp, simulated) = (now(), self.clock.now(), self.clock.is_simulated());
        self.timers.iter_mut().find_map(|timer| {
            let due = if simulated {
                let next = *timer
                    .next_simulated
                    .get_or_insert_with(|| stamp.plus_seconds(timer.period.as_secs_f64()));
                // A jump back in time (a bag that loops) starts the period anew.
                let jumped = next.seconds_since(stamp) > timer.period.as_secs_f64();
                let due = stamp >= next;
                if due || jumped {
                    timer.next_simulated = Some(stamp.plus_seconds(timer.period.as_secs_f64()));
                }
                due
            } else {
                let due = steady >= timer.next;
                if due {
                    // In step with the first time, skipping what was missed.
                    let missed = steady.duration_since(timer.next).as_nanos() / timer.period.as_nanos();
                    let steps = u32::try_from(missed).unwrap_or(u32::MAX - 1) + 1;
                    timer.next = timer
                        .period
                        .checked_mul(steps)
                        .and_then(|d| timer.next.checked_add(d))
                        .unwrap_or(steady + timer.period);
                }
                due
            };
            due.then(|| (timer.make)())
        })
    }
}

impl NodeHandle {
    /// Takes up `/clock` where `use_sim_time` says so, or lets it go.
    pub(crate) fn follow_use_sim_time(&mut self) -> Result<(), NodeError> {
        use rig_model::parameters::ParameterValue::Bool;
        use volant_msgs::rosgraph_msgs::msg::Clock as ClockMessage;
        let simulated = matches!(self.parameter_store().get("use_sim_time"), Some(Bool(true)));
        self.clock.set_simulated(simulated);
        if !simulated {
            self.kit_subscriptions.clear();
        } else if self.kit_subscriptions.is_empty() {
            let (clock, sources) = (self.clock.clone(), Arc::clone(&self.sources));
            let wake = sources.add_control("clock", 1);
            let qos = Qos { reliable: false, transient_local: false, depth: 1, max_samples: 1 };
            let subscription =
                self.raw_subscription("/clock", qos, true, move |source, _, m: &Arc<ClockMessage>| {
                    clock.set(Stamp::from_sec_nanosec(m.clock.sec, m.clock.nanosec));
                    sources.touch(source);
                    sources.wake(wake);
                })?;
            self.kit_subscriptions.push(subscription);
        }
        Ok(())
    }
}
