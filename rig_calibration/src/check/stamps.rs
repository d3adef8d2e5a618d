//! Stamps: two publishers on one topic, clocks that jump, and clocks without a common time.

use super::findings::{Finding, Verdict};
use crate::Samples;
use nalgebra::Vector3;
use rig_model::{Stamp, median, topics};

/// Share of repeated or backward stamps above which a topic has two publishers; a network reorders
/// less.
const TWICE: f64 = 0.05;
/// Readings of two publishers differ from their neighbors by this factor more than from the next
/// but one.
const ALTERNATING: f64 = 5.0;
/// A gap longer than this, s, is reported.
const GAP: f64 = 1.0;
/// Both ends of a topic are off those of the images by more than this, s, and by the same: so are
/// the clocks. Smaller offsets are estimated.
const SHIFTED: f64 = 2.0;
/// Share of the images' time that a topic may lack.
const LACKING: f64 = 0.1;
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
    let [(_, imu), (_, climber), (_, images)] = &topics;
    let whole = found.is_empty();
    for (key, topic, readings) in [
        ("clock.imu", topics::IMU, imu),
        (topics::CLIMBER_TRANSFORM, topics::CLIMBER_TRANSFORM, climber),
    ] {
        // A step of the stamps moves an end, too.
        found.extend(beside_images(key, topic, readings, images).filter(|f| f.blocks || whole));
    }
    found
}

/// Removes the readings without a stamp, which the filter rejects.
fn unset(topic: &str, readings: &mut Vec<(Stamp, Vector3<f64>)>) -> Option<Finding> {
    let all = readings.len();
    readings.retain(|(stamp, _)| !stamp.is_unset());
    let count = all - readings.len();
    let text = format!("the stamps of {count} of {all} messages on {topic} are zero");
    let finding = Finding::wrong(topic, text, "set header.stamp in its publisher");
    (count > 0).then(|| Finding { blocks: 2 * count > all, ..finding })
}

/// First and last stamp.
fn ends(readings: &[(Stamp, Vector3<f64>)]) -> Option<(Stamp, Stamp)> {
    Some((readings.first()?.0, readings.last()?.0))
}

/// Time from the first stamp to the last, s.
fn span(readings: &[(Stamp, Vector3<f64>)]) -> f64 {
    ends(readings).map_or(0.0, |(first, last)| last.seconds_since(first))
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
    if not_later > TWICE || alternating {
        let what = if alternating {
            "neighboring messages contradict each other"
        } else {
            "stamps repeat or go backwards"
        };
        let remedy = format!(
            "stop one of them (`ros2 topic info -v {topic}` lists both), or give each rig a \
             namespace of its own"
        );
        let text = format!("two publishers on {topic}: {what}");
        return vec![Finding { blocks: alternating, ..Finding::wrong(topic, text, remedy) }];
    }
    let period = median(steps.clone()).unwrap_or(0.0);
    let back = |at: usize| {
        let before = readings[at.saturating_sub(STAY - 1)..=at].iter().map(|r| r.0).min();
        let behind = |r: &(Stamp, Vector3<f64>)| Some(r.0) < before;
        at + 1 >= STAY
            && steps[at] < -PERIODS * period
            && readings[at + 1..].iter().take(STAY).all(behind)
    };
    let Some(at) = (0..steps.len()).find(|at| steps[*at].abs() > GAP || back(*at)) else {
        return vec![];
    };
    let (jump, since) = (steps[at], readings[at].0.seconds_since(readings[0].0));
    // Lost messages do not make a topic longer than the others.
    let ahead = others > 0.0 && span(readings) - others > 0.5 * jump.abs();
    let clock = back(at) || jump > 0.0 && ahead;
    let text =
        format!("the stamps of {topic} step by {jump:+.3} s, {since:.1} s after their start");
    let remedy = if clock {
        "let the clocks be slewed, not stepped, while the rig runs, and record again"
    } else {
        "let the clocks be slewed, not stepped, while the rig runs; where messages were lost, look \
         at the network or the recorder"
    };
    vec![Finding {
        verdict: if clock || jump < 0.0 { Verdict::Wrong } else { Verdict::Suspect },
        // No time offset holds for all of the recording.
        blocks: clock,
        ..Finding::wrong(topic, text, remedy)
    }]
}

/// Compares a topic's stamps with the images': clocks without a common time, and a topic that lacks
/// a part of the recording.
fn beside_images(
    key: &str,
    topic: &str,
    readings: &[(Stamp, Vector3<f64>)],
    images: &[(Stamp, Vector3<f64>)],
) -> Option<Finding> {
    let ((a0, a1), (b0, b1)) = (ends(readings)?, ends(images)?);
    let (begin, end) = (a0.seconds_since(b0), a1.seconds_since(b1));
    let shifted = begin.abs().min(end.abs()) > SHIFTED && (end - begin).abs() < GAP;
    let common = a1.min(b1).seconds_since(a0.max(b0));
    let all = span(images);
    if shifted || common < 0.5 * all.min(span(readings)) {
        let text = format!(
            "the stamps of {topic} begin {begin:+.3} s and end {end:+.3} s after those of the \
             images: their clocks are not synchronized"
        );
        let remedy = "synchronize the two computers' clocks (chrony or PTP)";
        return Some(Finding { blocks: true, ..Finding::wrong(key, text, remedy) });
    }
    let text =
        format!("{topic} covers {common:.1} s of the images' {all:.1} s; the others are not used");
    let remedy = "record again, with all nodes running from the beginning to the end";
    let finding = Finding { verdict: Verdict::Suspect, ..Finding::wrong(topic, text, remedy) };
    (all - common > LACKING * all).then_some(finding)
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
}
