//! Inputs that the node or the estimator rejects, for the diagnostics and the status.

use crate::Warning;
use node_kit::node::Health;

/// Inputs that were rejected in this second and the last one, and why the newest was.
#[derive(Debug, Default)]
pub(super) struct Rejections {
    /// Why `camera_info` is rejected; it is reported until another one is received.
    pub camera: Option<String>,
    count: u64,
    newest: String,
    unusable: Option<String>,
    /// Of the last second.
    last_unusable: Option<String>,
}

impl Rejections {
    /// Notes a message that is unusable, whatever its stamp is.
    pub fn note_message(&mut self, why: String) {
        if why.starts_with("camera_info") {
            self.camera = Some(why);
        } else {
            self.count += 1;
            self.newest.clone_from(&why);
            self.unusable = Some(why);
        }
    }

    /// Notes an input that the estimator rejects.
    pub fn note(&mut self, warning: &Warning) {
        match warning {
            Warning::NotFinite { .. } | Warning::NoStamp { .. } => {
                self.note_message(warning.to_string());
            }
            Warning::Ahead { .. } | Warning::TooOld { .. } => {
                self.count += 1;
                self.newest = warning.to_string();
            }
            _ => {}
        }
    }

    /// Returns why an input of the last second is unusable, whatever its stamp is.
    pub fn unusable(&self) -> Option<&str> {
        self.unusable.as_ref().or(self.last_unusable.as_ref()).map(String::as_str)
    }

    /// Ends a second: what was rejected before it is not reported any more.
    pub fn end_second(&mut self) {
        self.last_unusable = self.unusable.take();
    }

    /// Adds the rejections since the last report to the state of the last second.
    pub fn report(&mut self, health: Health, message: String) -> (Health, String) {
        let (count, newest) = (std::mem::take(&mut self.count), std::mem::take(&mut self.newest));
        if count == 0 {
            return (health, message);
        }
        let report = format!(
            "{message}; {count} inputs of the last second were rejected, the newest: {newest}"
        );
        (health.max(Health::Warn), report)
    }

    /// Drops the rejections since the last report.
    pub fn drop_report(&mut self) {
        (self.count, self.newest) = (0, String::new());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_model::Stamp;

    #[test]
    fn an_unusable_message_is_the_cause_for_two_seconds_and_a_late_one_is_not() {
        let mut rejections = Rejections::default();
        let late =
            Warning::TooOld { from: crate::Source::Image, stamp: Stamp::default(), age_s: 9.0 };
        rejections.note(&late);
        assert_eq!(rejections.unusable(), None);
        rejections.note_message("climber/transform: the frames".to_owned());
        for expected in [Some("climber/transform: the frames"); 2] {
            assert_eq!(rejections.unusable(), expected);
            rejections.end_second();
        }
        rejections.end_second();
        assert_eq!(rejections.unusable(), None);
        let (health, message) = rejections.report(Health::Ok, "fusing".to_owned());
        assert_eq!(health, Health::Warn);
        assert!(message.starts_with("fusing; 2 inputs of the last second were rejected"));
        assert_eq!(rejections.report(Health::Ok, String::new()).0, Health::Ok);
    }
}
