//! Stopwatches for the summaries of the tools; no estimate depends on them.

use rustix::time::{ClockId, clock_gettime};
use std::time::{Duration, Instant};

/// Wall-clock stopwatch.
#[derive(Clone, Copy, Debug)]
pub struct Stopwatch(Instant);

impl Stopwatch {
    /// Starts the stopwatch.
    #[allow(clippy::disallowed_methods)] // a tool's own cost, not a core's time
    pub fn start() -> Self {
        Self(Instant::now())
    }

    /// Elapsed time.
    pub fn elapsed(&self) -> Duration {
        self.0.elapsed()
    }
}

/// Stopwatch of this thread's CPU time, which other programs do not affect.
#[derive(Clone, Copy, Debug)]
pub struct WorkWatch(Duration);

impl WorkWatch {
    /// Starts the stopwatch.
    pub fn start() -> Self {
        Self(thread_time())
    }

    /// Elapsed CPU time; only valid on the thread that started it.
    pub fn elapsed(&self) -> Duration {
        thread_time().saturating_sub(self.0)
    }

    /// Runs `work` and adds its CPU time to a sum.
    pub fn add_to<T>(sum: &mut Duration, work: impl FnOnce() -> T) -> T {
        let watch = Self::start();
        let result = work();
        *sum += watch.elapsed();
        result
    }
}

fn thread_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(u64::try_from(time.tv_sec).unwrap_or(0), u32::try_from(time.tv_nsec).unwrap_or(0))
}
