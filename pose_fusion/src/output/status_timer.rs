//! Schedule of the status while there is no odometry that it would follow.

use rig_model::Stamp;

/// Time between two status messages without odometry, s.
pub const STATUS_PERIOD: f64 = 0.1;

/// Schedules the status at 10 Hz of data time.
#[derive(Clone, Debug, Default)]
pub struct StatusTimer {
    last: Option<Stamp>,
}

impl StatusTimer {
    /// Notes a status at an instant.
    pub fn note(&mut self, at: Stamp) {
        self.last = Some(at);
    }

    /// Returns whether a status is due at an instant, and notes it: a period after the last one, and
    /// after a jump of time.
    pub fn is_due(&mut self, now: Stamp) -> bool {
        let due =
            self.last.is_none_or(|last| !(0.0..STATUS_PERIOD).contains(&now.seconds_since(last)));
        if due {
            self.note(now);
        }
        due
    }
}
