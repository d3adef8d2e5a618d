//! Limit on the bytes of replies that a service has outstanding.

use crate::inbox::now;
use std::time::Instant;

/// Token bucket over the bytes of one service's replies.
///
/// RustDDS 0.15.1 bounds a reliable writer by its number of *unacknowledged* samples and frees the
/// acknowledged ones every 4 s only. A client that sends thousands of requests would make it hold
/// hundreds of megabytes of replies. This bucket bounds what the writer can hold: its capacity,
/// and 4 s of its rate (50 s, the longest lease, for a client that was killed).
#[derive(Debug)]
pub(super) struct ReplyBudget {
    available: f64,
    at: Instant,
}

/// Bytes that may be sent at once: sixteen dumps of all parameters of a node.
const CAPACITY: f64 = 1024.0 * 1024.0;
/// Refill, bytes per second: four such dumps.
const RATE: f64 = 256.0 * 1024.0;

impl ReplyBudget {
    pub fn new() -> Self {
        Self { available: CAPACITY, at: now() }
    }

    /// Takes `bytes` out of the bucket at time `at`; false while the bucket is empty.
    ///
    /// A reply larger than what is left still passes and leaves a debt, so that a single reply of
    /// any size is sent.
    pub fn take(&mut self, bytes: usize, at: Instant) -> bool {
        let elapsed = at.saturating_duration_since(self.at).as_secs_f64();
        self.available = (self.available + elapsed * RATE).min(CAPACITY);
        self.at = self.at.max(at);
        if self.available <= 0.0 {
            return false;
        }
        self.available -= bytes as f64;
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn a_flood_gets_the_capacity_once_and_then_the_rate() {
        let mut budget = ReplyBudget::new();
        let start = budget.at;
        let passed = |budget: &mut ReplyBudget, at: Instant| {
            (0..1000).filter(|_| budget.take(64 * 1024, at)).count()
        };
        assert_eq!(passed(&mut budget, start), 16);
        assert_eq!(passed(&mut budget, start + Duration::from_secs(1)), 4);
        assert_eq!(passed(&mut budget, start + Duration::from_secs(1000)), 16);
    }

    #[test]
    fn one_reply_larger_than_the_capacity_passes() {
        let mut budget = ReplyBudget::new();
        let start = budget.at;
        assert!(budget.take(3 << 20, start));
        assert!(!budget.take(1, start + Duration::from_secs(7)));
        assert!(budget.take(1, start + Duration::from_secs(9)));
    }
}
