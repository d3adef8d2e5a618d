//! Stopwatch for the tools; no estimate depends on it.

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
