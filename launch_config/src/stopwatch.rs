//! How long something took, for the summaries of the tools. Nothing of it reaches an estimate.

use rustix::time::{ClockId, clock_gettime};
use std::time::{Duration, Instant};

/// Time on the wall.
#[derive(Clone, Copy, Debug)]
pub struct Stopwatch(Instant);

impl Stopwatch {
    /// Starts now.
    #[allow(clippy::disallowed_methods)] // a tool's own cost, not a core's time
    pub fn start() -> Self {
        Self(Instant::now())
    }

    /// Since the start.
    pub fn elapsed(&self) -> Duration {
        self.0.elapsed()
    }
}

/// Time that this thread has worked: what other programs take does not count.
#[derive(Clone, Copy, Debug)]
pub struct WorkWatch(Duration);

impl WorkWatch {
    /// Starts now.
    pub fn start() -> Self {
        Self(thread_time())
    }

    /// Since the start; only on the thread that started it.
    pub fn elapsed(&self) -> Duration {
        thread_time().saturating_sub(self.0)
    }

    /// Runs something and adds its work to a sum.
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
