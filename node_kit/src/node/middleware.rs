//! Is RustDDS still of use? Two things make a participant deaf for good, or for long, without a word.

use super::clock::{Clock, ClockWatch};
use std::{
    fmt,
    sync::{Mutex, PoisonError},
};

/// Why a participant is of no use any more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Loss {
    /// Its threads are gone: RustDDS 0.15.1 ends them when a system call of theirs is interrupted, after the process was stopped and
    /// continued (a shell's ^Z, a debugger, `docker pause`) or when the computer wakes up from sleep.
    Ended,
    /// The system's clock was set back by so many seconds. RustDDS 0.15.1 gives out what it receives in the order of that clock, and
    /// nothing that is older by it than what it gave out last: set back by an hour, it is deaf for an hour.
    ClockSetBack {
        /// s.
        seconds: f64,
    },
}

impl fmt::Display for Loss {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Ended => {
                f.write_str("the DDS middleware had ended: its process was stopped, or the computer slept")
            }
            Self::ClockSetBack { seconds } => {
                write!(
                    f,
                    "the system's clock was set back by {seconds:.3} s, and the DDS middleware is deaf for as long"
                )
            }
        }
    }
}

/// A smaller step of the clock is over before an image is missed, ns.
const SET_BACK: i64 = 20_000_000;

/// Watches a participant of this process.
#[derive(Debug)]
pub struct MiddlewareWatch {
    threads: Vec<u32>,
    clock: ClockWatch,
}

impl MiddlewareWatch {
    /// Builds a participant, and finds the threads that it started.
    pub fn of<T>(build: impl FnOnce() -> T) -> (T, Self) {
        // Participants are built one after the other, so that each finds its own.
        static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());
        let _one = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
        let before = all();
        let clock = Clock::default().watch();
        let built = build();
        let threads = all().into_iter().filter(|id| !before.contains(id)).collect();
        (built, Self { threads, clock })
    }

    /// Why the participant is of no use any more, where that is so; another is to be built then. (Where the system does not tell of
    /// threads, none ever is gone.)
    pub fn loss(&mut self) -> Option<Loss> {
        let set_back = self.clock.set_by().filter(|by| *by <= -SET_BACK);
        if let Some(by) = set_back {
            return Some(Loss::ClockSetBack { seconds: -(by as f64) * 1e-9 });
        }
        self.threads.iter().any(|id| !is_one(*id)).then_some(Loss::Ended)
    }
}

fn all() -> Vec<u32> {
    let Ok(tasks) = std::fs::read_dir("/proc/self/task") else { return Vec::new() };
    let ids = tasks.filter_map(|t| t.ok()?.file_name().to_str()?.parse().ok());
    ids.filter(|id| is_one(*id)).collect()
}

fn is_one(id: u32) -> bool {
    std::fs::read_to_string(format!("/proc/self/task/{id}/comm"))
        .is_ok_and(|name| name.starts_with("RustDDS"))
}
