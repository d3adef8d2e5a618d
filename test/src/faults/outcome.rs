//! What became of a row: figures from the published messages, and whether they are as they must be.

use super::{Flow, LENGTH, Notes, Row, WINDOW};
use crate::{
    accuracy::{Track, distance},
    live::{Ended, Received, Scenario},
};
use nalgebra::Isometry3;
use rig_model::{Stamp, topics};
use std::path::Path;
use volant_msgs::{diagnostic_msgs::msg::DiagnosticStatus, msg::MarkerObservation};

#[derive(Clone, Debug)]
pub struct Outcome {
    /// Odometry per IMU sample that was due while the fault lasted.
    pub rate: f64,
    /// Longest time without odometry while it lasted, s.
    pub longest_gap: f64,
    /// Largest error while it lasted, mm.
    pub worst_position: f64,
    /// Largest error while it lasted, degrees.
    pub worst_rotation: f64,
    /// Line of the diagnostics that reports the fault.
    pub report: Option<String>,
    /// From the fault's end until the pose was back to stay, s.
    pub back_after: Option<f64>,
    /// What does not hold.
    pub failures: Vec<String>,
}

/// Back is who is nearer than this, mm and degrees.
const NEAR: [f64; 2] = [10.0, 1.0];
/// The 0.9999 quantile of χ² with 3 degrees of freedom.
const NEES_LIMIT: f64 = 21.1;
/// Largest share of the odometry whose NEES may exceed it.
pub(crate) const NEES_SHARE: f64 = 0.02;

pub fn judge(
    row: &Row,
    scenario: &Scenario,
    epoch: Stamp,
    ended: &Ended,
    folder: &Path,
    notes: Notes,
) -> Outcome {
    let received = &ended.received.by_the_time_as_it_is(row.clock_ahead);
    let at = |t: f64| epoch.plus_seconds(t);
    let truth = |s: Stamp| scenario.motion.world_from_volant(s.seconds_since(epoch));
    let fused = received.fused();
    let (rate, longest_gap) = flow(&fused, at(WINDOW[0]), at(WINDOW[1]));
    let (worst_position, worst_rotation) = worst(&fused, at(WINDOW[0]), at(WINDOW[1]), truth);
    let back_after = back(&fused, at(WINDOW[1]), at(LENGTH - 0.4), truth)
        .map(|s| s.seconds_since(at(WINDOW[1])));
    let report =
        row.diagnostics.and_then(|(node, words)| report(received, node, words, at(WINDOW[0])));

    // The folder of the logs is this machine's own.
    let report =
        report.or(notes.report).map(|line| line.replace(&format!("{}/", folder.display()), ""));

    let mut failures = notes.failures;
    match row.flow {
        Flow::Unbroken if rate < 0.97 || longest_gap > 0.06 => {
            failures.push(format!(
                "the odometry broke: {:.0} %, a gap of {:.0} ms",
                rate * 1e2,
                longest_gap * 1e3
            ));
        }
        Flow::Stops if rate > 0.5 => {
            failures.push("odometry was published though no pose can be estimated".to_owned());
        }
        _ => {}
    }
    if let (Some((node, words)), None) = (row.diagnostics, &report) {
        failures.push(format!("the diagnostics of {node} reported none of {words:?}"));
    }
    match back_after {
        Some(s) if s <= row.back_within => {}
        Some(s) => failures.push(format!("back after {s:.2} s instead of {}", row.back_within)),
        None => failures.push("not back before the end".to_owned()),
    }
    failures.extend(not_a_number(received));
    failures.extend(contradicted(received, at(0.5), at(LENGTH - 0.4), truth));
    failures.extend(ends(ended, folder));
    Outcome { rate, longest_gap, worst_position, worst_rotation, report, back_after, failures }
}

/// Share of the 100 Hz that came, and the longest gap.
pub(crate) fn flow(track: &Track, from: Stamp, to: Stamp) -> (f64, f64) {
    let stamps: Vec<Stamp> =
        track.iter().map(|(s, _)| *s).filter(|s| *s >= from && *s <= to).collect();
    let mut last = from;
    let mut gap: f64 = 0.0;
    for s in stamps.iter().chain([&to]) {
        gap = gap.max(s.seconds_since(last));
        last = *s;
    }
    (stamps.len() as f64 / (100.0 * to.seconds_since(from)), gap)
}

pub(crate) fn worst(
    track: &Track,
    from: Stamp,
    to: Stamp,
    truth: impl Fn(Stamp) -> Isometry3<f64>,
) -> (f64, f64) {
    track.iter().filter(|(s, _)| *s >= from && *s <= to).fold((0.0, 0.0), |(p, r), (s, pose)| {
        let [position, rotation] = distance(pose, &truth(*s));
        (f64::max(p, position), f64::max(r, rotation))
    })
}

/// When the pose was back to stay: from then on it is near the truth and without gaps.
pub(crate) fn back(
    track: &Track,
    from: Stamp,
    to: Stamp,
    truth: impl Fn(Stamp) -> Isometry3<f64>,
) -> Option<Stamp> {
    let mut since: Option<Stamp> = None;
    let mut last: Option<Stamp> = None;
    for (s, pose) in track.iter().filter(|(s, _)| *s >= from && *s <= to) {
        let [position, rotation] = distance(pose, &truth(*s));
        let near = position <= NEAR[0] && rotation <= NEAR[1];
        let gap = last.is_some_and(|l| s.seconds_since(l) > 0.06);
        since = match (near, gap, since) {
            (false, ..) => None,
            (true, false, Some(since)) => Some(since),
            (true, ..) => Some(*s),
        };
        last = Some(*s);
    }
    since.filter(|_| last.is_some_and(|l| to.seconds_since(l) < 0.2))
}

/// First line at WARN or above with one of the words: the message, not the values beside it.
fn report(received: &Received, node: &str, words: &[&str], from: Stamp) -> Option<String> {
    let lines = received
        .diagnostics
        .iter()
        .filter(|(received, _)| *received >= from)
        .flat_map(|(_, m)| &m.status);
    lines
        .filter(|s| s.level >= DiagnosticStatus::WARN && s.name.starts_with(node))
        .map(|s| format!("{}: {}", s.name, s.message))
        .find(|line| words.iter().any(|word| line.contains(word)))
}

/// Every number that must be one is one.
pub(crate) fn not_a_number(received: &Received) -> Option<String> {
    let finite = |values: &[f64]| values.iter().all(|v| v.is_finite());
    let pose = |p: &volant_msgs::geometry_msgs::msg::PoseWithCovariance| {
        let (t, q) = (&p.pose.position, &p.pose.orientation);
        finite(&[t.x, t.y, t.z, q.x, q.y, q.z, q.w]) && finite(&p.covariance)
    };
    let vector = |v: &volant_msgs::geometry_msgs::msg::Vector3| finite(&[v.x, v.y, v.z]);
    let checks = [
        (
            "odometry",
            received.odometry.iter().all(|(_, m)| {
                pose(&m.pose)
                    && vector(&m.twist.twist.linear)
                    && vector(&m.twist.twist.angular)
                    && finite(&m.twist.covariance)
            }),
        ),
        ("fused_pose", received.fused_pose.iter().all(|(_, m)| pose(&m.pose))),
        ("visual_pose", received.visual_pose.iter().all(|(_, m)| pose(&m.pose))),
        (
            "imu/data",
            received
                .imu
                .iter()
                .all(|(_, m)| vector(&m.linear_acceleration) && vector(&m.angular_velocity)),
        ),
        (
            topics::CLIMBER_TRANSFORM,
            received.climber.iter().all(|(_, m)| {
                let (t, q) = (&m.transform.translation, &m.transform.rotation);
                vector(t) && finite(&[q.x, q.y, q.z, q.w])
            }),
        ),
        (
            topics::MARKERS,
            received.markers.iter().flat_map(|(_, m)| &m.markers).all(|o| {
                o.state == MarkerObservation::LOST || finite(&[o.x, o.y]) && finite(&o.covariance)
            }),
        ),
    ];
    let bad: Vec<&str> = checks.iter().filter(|(_, fine)| !fine).map(|(name, _)| *name).collect();
    (!bad.is_empty()).then(|| format!("a non-finite number on {}", bad.join(", ")))
}

/// Those whose NEES of position or rotation exceeds its limit.
pub(crate) fn beyond(nees: &[(Stamp, [f64; 2])]) -> Vec<&(Stamp, [f64; 2])> {
    nees.iter().filter(|(_, n)| n[0] > NEES_LIMIT || n[1] > NEES_LIMIT).collect()
}

/// A covariance that the truth contradicts.
pub(crate) fn contradicted(
    received: &Received,
    from: Stamp,
    to: Stamp,
    truth: impl Fn(Stamp) -> Isometry3<f64> + Copy,
) -> Option<String> {
    let nees = received.nees(from, to, truth);
    let beyond = beyond(&nees);
    let share = beyond.len() as f64 / nees.len().max(1) as f64;
    let [(first, _), .., (last, _)] = beyond[..] else { return None };
    (share > NEES_SHARE).then(|| {
        let worst = beyond.iter().flat_map(|(_, n)| n).fold(0.0_f64, |a, b| a.max(*b));
        format!(
            "the truth contradicts the covariance in {:.1} % of the odometry (NEES up to \
             {worst:.0}, between {:.1} and {:.1} s)",
            share * 100.0,
            first.seconds_since(from),
            last.seconds_since(from)
        )
    })
}

/// Every process ended as it was asked to, and none panicked.
pub(crate) fn ends(ended: &Ended, folder: &Path) -> Vec<String> {
    let mut failures: Vec<String> = ended
        .ends
        .iter()
        .filter(|(_, status)| !status.success())
        .map(|(name, status)| format!("{name} ended with {status}"))
        .collect();
    for (name, _) in &ended.ends {
        let log = std::fs::read_to_string(folder.join(format!("{name}.log"))).unwrap_or_default();
        if log.contains("panicked at") {
            failures.push(format!("{name} panicked"));
        }
    }
    failures
}
