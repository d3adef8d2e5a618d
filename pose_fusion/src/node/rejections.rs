//! Inputs that the node or the estimator rejects, for the diagnostics and the status.

use crate::{Source, Warning};
use node_kit::node::Health;
use rig_model::topics;
use std::collections::BTreeMap;

/// Inputs that were rejected in this second and the last one, and why the newest was.
#[derive(Debug, Default)]
pub(super) struct Rejections {
    /// Why `camera_info` is rejected; it is reported until another one is received.
    pub camera: Option<String>,
    /// Number and newest reason by topic, since the last report.
    rejected: BTreeMap<String, (u64, String)>,
    unusable: Option<String>,
    /// Of the last second, and of markers where they were unusable in the second before it too.
    last_unusable: Option<String>,
    /// Why a marker was unusable in this second. The others of its image are used.
    marker: Option<String>,
    /// Whether one was in the last second.
    was_marker_unusable: bool,
}

impl Rejections {
    /// Notes a message that is unusable, whatever its stamp is.
    pub fn note_message(&mut self, topic: &str, why: String) {
        if topic == topics::CAMERA_INFO {
            self.camera = Some(why);
            return;
        }
        self.count(topic, &why);
        // The filter waits for no pose of an operator.
        if topic != topics::SET_POSE {
            self.unusable = Some(why);
        }
    }

    fn count(&mut self, topic: &str, why: &str) {
        let (count, newest) = self.rejected.entry(topic.to_owned()).or_default();
        *count += 1;
        why.clone_into(newest);
    }

    /// Notes an input that the estimator rejects.
    pub fn note(&mut self, warning: &Warning) {
        let Some(topic) = warning.origin().map(|source| source.to_string()) else { return };
        match warning {
            Warning::NotFinite { from: Source::Image, .. } => {
                self.count(&topic, &warning.to_string());
                self.marker = Some(warning.to_string());
            }
            Warning::NotFinite { .. } | Warning::NoStamp { .. } => {
                self.note_message(&topic, warning.to_string());
            }
            Warning::Duplicate { .. } => {}
            _ => self.count(&topic, &warning.to_string()),
        }
    }

    /// Returns why an input of the last second is unusable, whatever its stamp is.
    pub fn unusable(&self) -> Option<&str> {
        self.unusable.as_ref().or(self.last_unusable.as_ref()).map(String::as_str)
    }

    /// Ends a second: what was rejected before it is not reported any more.
    pub fn end_second(&mut self) {
        let marker = self.marker.take();
        let was = std::mem::replace(&mut self.was_marker_unusable, marker.is_some());
        self.last_unusable = self.unusable.take().or(marker.filter(|_| was));
    }

    /// Adds the rejections since the last report to the state of the last second.
    pub fn report(&mut self, health: Health, message: String) -> (Health, String) {
        let rejected = std::mem::take(&mut self.rejected);
        let health = if rejected.is_empty() { health } else { health.max(Health::Warn) };
        let report = rejected.into_iter().fold(message, |report, (topic, (count, newest))| {
            format!(
                "{report}; {count} of {topic} rejected in the last second, the newest: {newest}"
            )
        });
        (health, report)
    }

    /// Drops the rejections since the last report.
    pub fn drop_report(&mut self) {
        self.rejected.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_model::Stamp;

    #[test]
    fn an_unusable_message_is_the_cause_for_two_seconds_and_a_late_one_is_not() {
        let mut rejections = Rejections::default();
        let late = Warning::TooOld { from: Source::Image, stamp: Stamp::default(), age_s: 9.0 };
        rejections.note(&late);
        assert_eq!(rejections.unusable(), None);
        let set = "volant/set_pose: the frame";
        rejections.note_message(topics::SET_POSE, set.to_owned());
        assert_eq!(rejections.unusable(), None);
        let frames = "climber/transform: the frames";
        rejections.note_message(topics::CLIMBER_TRANSFORM, frames.to_owned());
        rejections.note_message(topics::CLIMBER_TRANSFORM, frames.to_owned());
        for expected in [Some(frames); 2] {
            assert_eq!(rejections.unusable(), expected);
            rejections.end_second();
        }
        rejections.end_second();
        assert_eq!(rejections.unusable(), None);
        let (health, message) = rejections.report(Health::Ok, "fusing".to_owned());
        assert_eq!(health, Health::Warn);
        assert!(message.starts_with("fusing; 1 of climber/markers rejected"), "{message}");
        assert!(message.contains("; 2 of climber/transform rejected"), "{message}");
        assert!(message.ends_with(set), "{message}");
        assert_eq!(rejections.report(Health::Ok, String::new()).0, Health::Ok);
    }
    #[test]
    fn one_marker_makes_images_unusable_only_where_it_lasts() {
        let mut rejections = Rejections::default();
        let (from, stamp) = (Source::Image, Stamp::default());
        let red = Warning::NotFinite { from, stamp, what: "red" };
        rejections.note(&red);
        rejections.end_second();
        assert_eq!(rejections.unusable(), None);
        let (_, message) = rejections.report(Health::Ok, "fusing".to_owned());
        assert!(message.starts_with("fusing; 1 of climber/markers rejected"), "{message}");
        rejections.note(&red);
        rejections.end_second();
        assert!(rejections.unusable().is_some_and(|why| why.contains("red")));
        rejections.end_second();
        assert_eq!(rejections.unusable(), None);
    }
}
