//! How long something took, for the summaries of the tools. Nothing of it reaches an estimate.

use std::time::{Duration, Instant};

/// Started, and asked.
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

    /// Runs something and adds its time to a sum.
    pub fn add_to<T>(sum: &mut Duration, work: impl FnOnce() -> T) -> T {
        let watch = Self::start();
        let result = work();
        *sum += watch.elapsed();
        result
    }
}
