//! Limit of the rate at which the estimate is published: a network link need not carry the estimate
//! of every IMU sample.

use super::Output;
use rig_model::Stamp;

/// Jitter of the stamps for which an estimate does not wait for the next one, s.
const JITTER: f64 = 5e-4;

/// Passes odometry, status, prediction and swing at a limited rate, those of one state together.
#[derive(Clone, Debug, Default)]
pub struct RateLimit {
    /// Newest stamp, and whether it passed.
    newest: Option<(Stamp, bool)>,
    due: Option<Stamp>,
}

impl RateLimit {
    /// Returns whether an output is published at `rate` (Hz; 0: all). Everything but odometry,
    /// status, prediction and swing is.
    pub fn passes(&mut self, output: &Output, rate: f64) -> bool {
        if rate <= 0.0 {
            return true;
        }
        let stamp = match output {
            Output::Odometry(odometry) => odometry.stamp,
            Output::Status(status) => status.stamp,
            // They follow the odometry of the same state.
            Output::Predicted(_) | Output::Swing(_) => {
                return self.newest.is_none_or(|(_, passed)| passed);
            }
            _ => return true,
        };
        if let Some((newest, passed)) = self.newest
            && newest == stamp
        {
            return passed;
        }
        let period = 1.0 / rate;
        // After a gap or a jump of time the next period begins with this stamp.
        let wait = self.due.map(|due| due.seconds_since(stamp)).filter(|w| w.abs() <= period);
        let passes = wait.is_none_or(|wait| wait <= JITTER);
        if passes {
            let due = self.due.filter(|_| wait.is_some()).unwrap_or(stamp);
            self.due = Some(due.plus_seconds(period));
        }
        self.newest = Some((stamp, passes));
        passes
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::PoseStatus;

    fn status(ms: i64) -> Output {
        let stamp = Stamp::from_nanos(ms * 1_000_000);
        Output::Status(PoseStatus::initializing(stamp, 0.0, String::new()))
    }

    #[test]
    fn the_rate_holds_on_average_and_after_jumps_of_time() {
        let count = |rate: f64, stamps: &mut dyn Iterator<Item = i64>| {
            let mut limit = RateLimit::default();
            stamps.filter(|ms| limit.passes(&status(*ms), rate)).count()
        };
        assert_eq!(count(0.0, &mut (0..100).map(|i| 10 * i)), 100);
        assert_eq!(count(20.0, &mut (0..100).map(|i| 10 * i)), 20);
        // No multiple of the sampling period: 30 of 100 per second.
        assert_eq!(count(30.0, &mut (0..1000).map(|i| 10 * i)), 300);
        // Faster than the samples: all.
        assert_eq!(count(200.0, &mut (0..100).map(|i| 10 * i)), 100);
        // A jump back, and a gap.
        assert_eq!(count(20.0, &mut (500..600).chain(0..100)), 4);
        assert_eq!(count(20.0, &mut [0, 1000, 1010, 1050].into_iter()), 3);
    }

    #[test]
    fn what_has_one_stamp_stays_together() {
        let mut limit = RateLimit::default();
        for (ms, passes) in [(0, true), (0, true), (10, false), (10, false), (50, true), (50, true)]
        {
            assert_eq!(limit.passes(&status(ms), 20.0), passes, "{ms}");
        }
    }
}
