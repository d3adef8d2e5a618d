//! Detects when a RustDDS participant has become unusable, which RustDDS does not report.

use super::clock::{Clock, ClockWatch};
use crate::inbox::now;
use parking_lot::Mutex;
use std::{
    fmt,
    time::{Duration, Instant},
};

/// Why a participant has become unusable.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    /// Its threads are gone. RustDDS 0.15.1 ends them when one of their system calls is
    /// interrupted: after the process was stopped and continued (a shell's ^Z, a debugger, `docker
    /// pause`), or when the computer wakes up from sleep.
    Ended,
    /// The system's clock was set back. RustDDS 0.15.1 delivers samples in the order of that clock
    /// and none that is older than the last delivered one: set back by an hour, it delivers nothing
    /// for an hour.
    ClockSetBack {
        /// By how much, s.
        seconds: f64,
    },
}

impl fmt::Display for Loss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ended => f.write_str(
                "the DDS middleware had ended: its process was stopped, or the computer was \
                 suspended",
            ),
            Self::ClockSetBack { seconds } => {
                write!(
                    f,
                    "the system's clock was set back by {seconds:.3} s, and the DDS middleware \
                     receives nothing until the clock has caught up"
                )
            }
        }
    }
}

/// Steps of the clock that are ignored, ns: a smaller one is over before an image is missed.
const SET_BACK: i64 = 20_000_000;
/// Part of the time by which a clock is slewed at most: chrony's `maxslewrate` is 83333 ppm.
/// Samples keep their order then.
const SLEW: i64 = 10;

/// Watches a participant of this process.
#[derive(Debug)]
pub struct MiddlewareWatch {
    threads: Vec<u32>,
    clock: ClockWatch,
    /// When the clock was last checked.
    checked: Instant,
}

impl MiddlewareWatch {
    /// Builds a participant and identifies the threads that it starts.
    pub(super) fn of<T>(build: impl FnOnce() -> T) -> (T, Self) {
        // Threads belong to the process and RustDDS gives no handles to its own, so participants
        // are built one at a time for the whole process.
        static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
        let _one = ONE_AT_A_TIME.lock();
        let before = rustdds_threads();
        let clock = Clock::default().watch();
        let built = build();
        let threads = rustdds_threads().into_iter().filter(|id| !before.contains(id)).collect();
        (built, Self { threads, clock, checked: now() })
    }

    /// Returns why the participant has become unusable, if it has; it must be replaced then.
    /// Without `/proc`, ended threads are not detected.
    pub fn loss(&mut self) -> Option<Loss> {
        let by = self.clock.set_by().unwrap_or(0);
        let before = std::mem::replace(&mut self.checked, now());
        let since = self.checked.saturating_duration_since(before);
        if is_step_back(by, since) {
            return Some(Loss::ClockSetBack { seconds: -(by as f64) * 1e-9 });
        }
        self.threads.iter().any(|id| !is_rustdds(*id)).then_some(Loss::Ended)
    }
}

/// Whether a change of the clock within some time, ns, is a step back rather than slewing.
fn is_step_back(by: i64, within: Duration) -> bool {
    let slewed = i64::try_from(within.as_nanos()).unwrap_or(i64::MAX) / SLEW;
    by < -(SET_BACK.saturating_add(slewed))
}

fn rustdds_threads() -> Vec<u32> {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return Vec::new() };
    let ids = tasks.filter_map(|t| t.ok()?.file_name().to_str()?.parse().ok());
    ids.filter(|id| is_rustdds(*id)).collect()
}

fn is_rustdds(id: u32) -> bool {
    std::fs::read_to_string(format!("/proc/self/task/{id}/comm"))
        .is_ok_and(|name| name.starts_with("RustDDS"))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The heartbeat of a node checks every 250 ms.
    #[test]
    fn a_slewed_clock_is_no_step_back() {
        let beat = Duration::from_millis(250);
        // chrony's fastest, in 250 ms and in a check that was late.
        assert!(!is_step_back(-20_833_250, beat));
        assert!(!is_step_back(-200_000_000, 8 * beat));
        assert!(is_step_back(-50_000_000, beat));
        assert!(is_step_back(-21_000_000, Duration::ZERO));
        assert!(!is_step_back(3_600_000_000_000, beat));
    }
}
