//! Stamps: two publishers on one topic, clocks that jump, and clocks without a common time.

use super::findings::{Finding, Verdict};
use crate::{Samples, median::median};
use nalgebra::Vector3;
use rig_model::{Stamp, topics};

/// Share of repeated or backward stamps above which a topic has two publishers; a network reorders
/// less.
const TWICE: f64 = 0.05;
/// Readings of two publishers differ from their neighbors by this factor more than from the next
/// but one.
const ALTERNATING: f64 = 5.0;
/// A gap longer than this, s, is reported.
const GAP: f64 = 1.0;
/// A step back by more sample periods is one of the clock, where the messages after it stay behind:
/// a network reorders less.
const PERIODS: f64 = 5.0;
const STAY: usize = 3;

/// Examines the stamps of each topic.
pub fn examine(samples: &Samples) -> Vec<Finding> {
    let imu: Vec<_> = samples.imu.iter().map(|s| (s.stamp, s.specific_force)).collect();
    let climber: Vec<_> = samples
        .climber
        .iter()
        .map(|s| (s.stamp, s.world_from_climber.translation.vector))
        .collect();
    let images: Vec<_> = samples.markers.iter().map(|m| (m.stamp, Vector3::zeros())).collect();
    let mut topics = [
        (topics::IMU, imu),
        (topics::CLIMBER_TRANSFORM, climber),
        (topics::COMPRESSED_IMAGE, images),
    ];
    let mut found: Vec<Finding> =
        topics.iter_mut().filter_map(|(topic, readings)| unset(topic, readings)).collect();
    let spans = topics.each_ref().map(|(_, readings)| span(readings));
    for (i, (topic, readings)) in topics.iter().enumerate() {
        let others = (0..3).filter(|k| *k != i).map(|k| spans[k]).fold(0.0, f64::max);
        found.extend(of_topic(topic, readings, others));
    }
    let [(_, imu), _, (_, images)] = &topics;
    found.extend(disjoint(imu, images));
    found
}

/// Removes the readings without a stamp, which the filter rejects.
fn unset(topic: &str, readings: &mut Vec<(Stamp, Vector3<f64>)>) -> Option<Finding> {
    let all = readings.len();
    readings.retain(|(stamp, _)| !stamp.is_unset());
    let count = all - readings.len();
    (count > 0).then(|| Finding {
        key: topic.to_owned(),
        verdict: Verdict::Wrong,
        text: format!("the stamps of {count} of {all} messages on {topic} are zero"),
        remedy: "set header.stamp in its publisher".to_owned(),
        blocks: 2 * count > all,
    })
}

/// Time from the first stamp to the last, s.
fn span(readings: &[(Stamp, Vector3<f64>)]) -> f64 {
    match readings {
        [first, .., last] => last.0.seconds_since(first.0),
        _ => 0.0,
    }
}

/// Examines one topic; `others` is the longest span of the other ones, s.
fn of_topic(topic: &str, readings: &[(Stamp, Vector3<f64>)], others: f64) -> Vec<Finding> {
    if readings.len() < 20 {
        return vec![];
    }
    let steps: Vec<f64> = readings.windows(2).map(|w| w[1].0.seconds_since(w[0].0)).collect();
    let not_later = steps.iter().filter(|dt| **dt < 1e-6).count() as f64 / steps.len() as f64;
    let apart = |n: usize| {
        let steps = readings.iter().zip(&readings[n..]).map(|(a, b)| (b.1 - a.1).norm());
        median(steps.collect()).unwrap_or(0.0)
    };
    let alternating = apart(1) > ALTERNATING * apart(2) && apart(1) > 0.01;
    let mut found = vec![];
    if not_later > TWICE || alternating {
        let what = if alternating {
            "neighboring messages contradict each other"
        } else {
            "stamps repeat or go backwards"
        };
        found.push(Finding {
            key: topic.to_owned(),
            verdict: Verdict::Wrong,
            text: format!("two publishers on {topic}: {what}"),
            remedy: format!(
                "stop one of them (`ros2 topic info -v {topic}` lists both), or give each rig a \
                 namespace of its own"
            ),
            blocks: alternating,
        });
        return found;
    }
    let period = median(steps.clone()).unwrap_or(0.0);
    let back = |at: usize| {
        let before = readings[at.saturating_sub(STAY - 1)..=at].iter().map(|r| r.0).min();
        let behind = |r: &(Stamp, Vector3<f64>)| Some(r.0) < before;
        at + 1 >= STAY
            && steps[at] < -PERIODS * period
            && readings[at + 1..].iter().take(STAY).all(behind)
    };
    let step = (0..steps.len()).find(|at| steps[*at].abs() > GAP || back(*at));
    if let Some(at) = step {
        let (jump, since) = (steps[at], readings[at].0.seconds_since(readings[0].0));
        // Lost messages do not make a topic longer than the others.
        let ahead = others > 0.0 && span(readings) - others > 0.5 * jump.abs();
        let clock = back(at) || jump > 0.0 && ahead;
        found.push(Finding {
            key: topic.to_owned(),
            verdict: if clock || jump < 0.0 { Verdict::Wrong } else { Verdict::Suspect },
            text: format!(
                "the stamps of {topic} step by {jump:+.3} s, {since:.1} s after their start"
            ),
            remedy: if clock {
                "let the clocks be slewed, not stepped, while the rig runs, and record again"
            } else {
                "let the clocks be slewed, not stepped, while the rig runs; where messages were \
                 lost, look at the network or the recorder"
            }
            .to_owned(),
            // No time offset holds for all of the recording.
            blocks: clock,
        });
    }
    found
}

/// The clocks of IMU and camera have no common time.
fn disjoint(imu: &[(Stamp, Vector3<f64>)], images: &[(Stamp, Vector3<f64>)]) -> Option<Finding> {
    let span = |list: &[(Stamp, Vector3<f64>)]| Some((list.first()?.0, list.last()?.0));
    let ((a0, a1), (b0, b1)) = (span(imu)?, span(images)?);
    let common = a1.min(b1).seconds_since(a0.max(b0));
    let shorter = a1.seconds_since(a0).min(b1.seconds_since(b0));
    (common < 0.5 * shorter).then(|| Finding {
        key: "clock.imu".to_owned(),
        verdict: Verdict::Wrong,
        text: format!(
            "the IMU's stamps begin {:+.3} s after the images': their clocks are not synchronized",
            a0.seconds_since(b0)
        ),
        remedy: "synchronize the two computers' clocks (chrony or PTP)".to_owned(),
        blocks: true,
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test")]
mod tests {
    use super::*;

    fn readings(count: i64, place: impl Fn(i64) -> f64) -> Vec<(Stamp, Vector3<f64>)> {
        let at = |i: i64| Stamp::from_nanos(i * 20_000_000);
        (0..count).map(|i| (at(i), Vector3::new(place(i), 0.0, 0.0))).collect()
    }

    #[test]
    fn two_publishers_are_found_by_their_stamps_or_by_their_contradictions() {
        let one = readings(100, |i| i as f64 * 1e-3);
        assert!(of_topic("t", &one, 2.0).is_empty());
        let twice: Vec<_> = one.iter().flat_map(|r| [*r, *r]).collect();
        let found = of_topic("t", &twice, 2.0);
        assert!(found[0].text.contains("two publishers") && !found[0].blocks, "{found:?}");
        let two = readings(100, |i| i as f64 * 1e-3 + if i % 2 == 0 { 0.0 } else { 2.0 });
        let found = of_topic("t", &two, 2.0);
        assert!(found[0].text.contains("contradict") && found[0].blocks, "{found:?}");
    }

    #[test]
    fn zero_stamps_are_named_as_such() {
        let mut all: Vec<_> = readings(100, |i| i as f64 * 1e-3);
        all.iter_mut().for_each(|r| r.0 = r.0.plus_seconds(1.0));
        assert!(unset("t", &mut all.clone()).is_none());
        all[1..].iter_mut().for_each(|r| r.0 = Stamp::default());
        let found = unset("t", &mut all).unwrap();
        assert_eq!(found.text, "the stamps of 99 of 100 messages on t are zero");
        assert!(found.blocks && all.len() == 1);
    }

    #[test]
    fn a_step_of_the_clock_is_wrong_and_a_gap_suspect() {
        let after = |seconds: f64| {
            let mut stepped = readings(100, |i| i as f64 * 1e-3);
            stepped[50..].iter_mut().for_each(|r| r.0 = r.0.plus_seconds(seconds));
            stepped
        };
        let judge = |readings: &[_], others| {
            of_topic("t", readings, others).first().map(|f| (f.verdict, f.blocks))
        };
        for seconds in [-3.0, -0.3, -0.15] {
            assert_eq!(judge(&after(seconds), 2.0), Some((Verdict::Wrong, true)), "{seconds}");
        }
        // The other topics last as long, or not.
        assert_eq!(judge(&after(2.0), 4.0), Some((Verdict::Suspect, false)));
        assert_eq!(judge(&after(2.0), 2.0), Some((Verdict::Wrong, true)));
        // Messages that overtook others, and one stamp that is far ahead.
        let mut reordered = after(0.0);
        reordered[40..44].reverse();
        assert_eq!(judge(&reordered, 2.0), None);
        reordered[60].0 = reordered[60].0.plus_seconds(0.5);
        assert_eq!(judge(&reordered, 2.0), None);
    }

    #[test]
    fn clocks_without_a_common_time_are_found() {
        let (a, mut b) = (readings(500, |_| 0.0), readings(500, |_| 0.0));
        assert!(disjoint(&a, &b).is_none());
        b.iter_mut().for_each(|r| r.0 = r.0.plus_seconds(3600.0));
        assert!(disjoint(&a, &b).is_some_and(|f| f.text.contains("-3600.000 s")));
    }
}
