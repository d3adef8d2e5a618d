//! Evaluation of the estimates in one bag against the `ground_truth/odometry` of another. The truth
//! is interpolated at each estimate's stamp. The first second after the start of both bags is
//! skipped. `volant/fused_pose` is inverted first, so that all errors are those of the platform in
//! the world frame.

mod page;
mod report;

pub use page::page;
pub use report::{csv, table};

use crate::{
    replay::{TopicNames, summarize},
    report::Track,
};
use anyhow::bail;
use bag::{BagReader, recording::read_truth};
use nalgebra::{Isometry3, Matrix6, Vector3};
use node_kit::convert;
use rig_model::{
    Stamp,
    score::{Score, Spread, SpreadSum, Truth, TruthSample, inverse},
    topics,
};
use serde::Serialize;
use std::path::PathBuf;
use volant_msgs::{
    cdr,
    geometry_msgs::msg::{PoseWithCovariance, PoseWithCovarianceStamped},
    nav_msgs::msg::Odometry,
    std_msgs::msg::Header,
};

/// Shortest gap that is counted, s.
const GAP: f64 = 0.030;
/// Relative topics of the estimates; `replay --smooth` adds the last one.
const ESTIMATES: [&str; 4] =
    [topics::ODOMETRY, topics::FUSED_POSE, topics::VISUAL_POSE, topics::SMOOTHED_ODOMETRY];
const TRUTH: &str = topics::GROUND_TRUTH;

/// Options of an evaluation.
#[derive(Clone, Debug)]
pub struct EvaluateOptions {
    /// Bag with the estimates.
    pub estimates: PathBuf,
    /// Bag with the truth.
    pub truth: PathBuf,
    /// Skipped time at the start, s.
    pub skip: f64,
    /// Namespace and remaps.
    pub names: TopicNames,
}

/// Errors and rates of one estimate: a flat record, since each field is a column of the CSV and a
/// key of the JSON.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Quality {
    /// Relative topic.
    pub estimate: String,
    /// Number of compared poses.
    pub count: u64,
    /// Norm of the position error, mm.
    pub position_mm: Spread,
    /// Norm of the rotation vector of the error, deg.
    pub rotation_deg: Spread,
    /// RMSE of the position in x, y, z, mm.
    pub axes_mm: [Spread; 3],
    /// RMSE of roll, pitch, yaw, deg.
    pub angles_deg: [Spread; 3],
    /// Mean NEES of the position, expected 3; `None` without a usable covariance.
    pub nees_position: Option<f64>,
    /// Mean NEES of the rotation, expected 3.
    pub nees_rotation: Option<f64>,
    /// Mean NEES of the pose, expected 6.
    pub nees_pose: Option<f64>,
    /// RMSE of the velocity, mm/s, where estimate and truth have one.
    pub velocity_mm_s: Option<Spread>,
    /// RMSE of the angular velocity, deg/s.
    pub turn_deg_s: Option<Spread>,
    /// Estimates per second, Hz.
    pub rate_hz: f64,
    /// Number of gaps of more than 30 ms.
    pub gaps_over_30_ms: u64,
    /// Longest gap, ms.
    pub longest_gap_ms: f64,
    /// Time of the first estimate, s after the start.
    pub first_s: f64,
    /// Time of the last estimate, s after the start.
    pub last_s: f64,
    /// Number of non-finite poses and undecodable messages.
    pub unusable: u64,
    /// Number of covariances that are not positive definite.
    pub without_covariance: u64,
    /// Number of estimates at times without truth.
    pub without_truth: u64,
    /// The poses, `world_from_volant`, for figures.
    #[serde(skip)]
    pub track: Track,
}

/// Result of an evaluation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// One entry per estimate in the bag.
    pub estimates: Vec<Quality>,
    /// Losses in the bags, one sentence each.
    pub losses: Vec<String>,
    /// Start of the run: the first stamp that both bags cover.
    #[serde(skip)]
    pub began: Stamp,
    /// The truth.
    #[serde(skip)]
    pub truth: Truth,
}

struct Estimate {
    stamp: Stamp,
    pose: Isometry3<f64>,
    covariance: Matrix6<f64>,
    twist: Option<(Vector3<f64>, Vector3<f64>)>,
}

/// Evaluates a bag's estimates.
///
/// # Errors
/// A bag is unreadable, has no truth or no estimate, or no estimate is within the truth's time.
pub fn evaluate(options: &EvaluateOptions) -> anyhow::Result<Evaluation> {
    let mut losses = vec![];
    for bag in [&options.truth, &options.estimates] {
        summarize(bag, &mut vec![])?;
    }
    let truth = read_truth(&options.truth, &options.names.resolve(TRUTH), &mut losses)?;
    let Some((from, to)) = truth.span() else {
        bail!(
            "{}: no usable nav_msgs/msg/Odometry on {}; give the bag with the truth to --truth, or \
             name its topic with --remap {TRUTH}:=OTHER{}",
            options.truth.display(),
            options.names.resolve(TRUTH),
            also(&losses)
        );
    };
    let topics: Vec<String> = ESTIMATES.iter().map(|name| options.names.resolve(name)).collect();
    let mut collected: [(Vec<Estimate>, u64); ESTIMATES.len()] = Default::default();
    let (mut first_logged, mut logged_early) = (None, None);
    let mut bag = BagReader::open(&options.estimates)?;
    while let Some(message) = bag.next_message()? {
        let logged = i64::try_from(message.log_time).unwrap_or(0);
        first_logged.get_or_insert(logged);
        let Some(which) = topics.iter().position(|t| *t == message.topic.name) else { continue };
        let estimate = match which {
            0 | 3 => read_odometry(&message.data),
            1 => read_pose(&message.data).map(|mut e| {
                (e.pose, e.covariance) = inverse(&e.pose, &e.covariance);
                e
            }),
            _ => read_pose(&message.data),
        };
        match estimate {
            Some(estimate) => {
                logged_early.get_or_insert(estimate.stamp.as_nanos().saturating_sub(logged));
                collected[which].0.push(estimate);
            }
            None => collected[which].1 += 1,
        }
    }
    losses.extend_from_slice(bag.losses());
    if collected.iter().all(|(estimates, unusable)| estimates.is_empty() && *unusable == 0) {
        bail!(
            "{}: no estimate on {}; give the bag that `volant replay --out` wrote{}",
            options.estimates.display(),
            topics.join(", "),
            also(&losses)
        );
    }
    // The bag's start in the time of the stamps: a played bag is recorded at another time.
    let began = first_logged.zip(logged_early);
    let began = began.map_or(from, |(at, early)| Stamp::from_nanos(at.saturating_add(early)));
    let began = began.max(from);
    let estimates: Vec<Quality> = ESTIMATES
        .iter()
        .zip(&mut collected)
        .filter(|(_, (estimates, unusable))| !estimates.is_empty() || *unusable > 0)
        .map(|(name, (estimates, unusable))| {
            estimates.sort_by_key(|e| e.stamp);
            let quality = quality(name, estimates, &truth, began, options.skip);
            Quality { unusable: *unusable, ..quality }
        })
        .collect();
    if estimates.iter().all(|q| q.count == 0) {
        let path = options.estimates.display();
        let stamps = estimates.iter().flat_map(|q| &q.track).map(|(stamp, _)| *stamp);
        if let Some(last) = stamps.filter(|stamp| truth.at(*stamp).is_some()).max() {
            bail!(
                "{path}: --skip {} leaves out all of the run, which lasts {:.1} s; give a shorter \
                 time",
                options.skip,
                last.seconds_since(began).max(0.0)
            );
        }
        bail!(
            "{path}: none of its estimates lies within the truth's time ({from} to {to}); check \
             that both bags are of one run"
        );
    }
    Ok(Evaluation { estimates, losses, began, truth })
}

/// What the bags lost, for the end of an error.
fn also(losses: &[String]) -> String {
    losses.iter().map(|loss| format!("; {loss}")).collect()
}

fn quality(name: &str, estimates: &[Estimate], truth: &Truth, began: Stamp, skip: f64) -> Quality {
    let mut sums = Sums::default();
    let mut without_truth = 0;
    let mut longest: f64 = 0.0;
    let mut gaps = 0;
    let mut span: Option<(Stamp, Stamp)> = None;
    for estimate in estimates {
        if estimate.stamp.seconds_since(began) < skip {
            continue;
        }
        if let Some((_, last)) = span {
            let gap = estimate.stamp.seconds_since(last);
            longest = longest.max(gap);
            gaps += u64::from(gap > GAP);
        }
        span = Some((span.map_or(estimate.stamp, |(first, _)| first), estimate.stamp));
        match truth.at(estimate.stamp) {
            Some(true_one) => sums.add(estimate, &true_one),
            None => without_truth += 1,
        }
    }
    let (first, last) = span.unwrap_or((began, began));
    let duration = last.seconds_since(first);
    let considered = sums.pose.count() + without_truth;
    let nees = sums.pose.mean_nees();
    let degrees = 1f64.to_degrees();
    let twist = sums.velocity_known && estimates.iter().any(|e| e.twist.is_some());
    Quality {
        estimate: name.to_owned(),
        count: sums.pose.count(),
        position_mm: sums.pose.position.spread(1e3),
        rotation_deg: sums.pose.rotation.spread(degrees),
        axes_mm: sums.axes.map(|s| s.spread(1e3)),
        angles_deg: sums.angles.map(|s| s.spread(degrees)),
        nees_position: nees.map(|n| n.position),
        nees_rotation: nees.map(|n| n.rotation),
        nees_pose: nees.map(|n| n.pose),
        velocity_mm_s: twist.then(|| sums.velocity.spread(1e3)),
        turn_deg_s: twist.then(|| sums.turn.spread(degrees)),
        rate_hz: if duration > 0.0 { considered.saturating_sub(1) as f64 / duration } else { 0.0 },
        gaps_over_30_ms: gaps,
        longest_gap_ms: longest * 1e3,
        first_s: first.seconds_since(began),
        last_s: last.seconds_since(began),
        unusable: 0,
        without_covariance: sums.pose.without_covariance(),
        without_truth,
        track: estimates.iter().map(|e| (e.stamp, e.pose)).collect(),
    }
}

#[derive(Default)]
struct Sums {
    pose: Score,
    axes: [SpreadSum; 3],
    angles: [SpreadSum; 3],
    velocity: SpreadSum,
    turn: SpreadSum,
    velocity_known: bool,
}

impl Sums {
    fn add(&mut self, estimate: &Estimate, truth: &TruthSample) {
        let error = self.pose.add(&estimate.pose, &estimate.covariance, &truth.world_from_volant);
        for axis in 0..3 {
            self.axes[axis].add(error.position[axis]);
            self.angles[axis].add(error.roll_pitch_yaw[axis]);
        }
        if let Some((linear, angular)) = estimate.twist {
            self.velocity.add((linear - truth.linear_velocity).norm());
            self.turn.add((angular - truth.angular_velocity).norm());
            // An all-zero twist means that the truth has none.
            self.velocity_known |= truth.linear_velocity != Vector3::zeros();
        }
    }
}

fn read_odometry(data: &[u8]) -> Option<Estimate> {
    let Odometry { header, pose, twist, .. } = cdr::from_bytes(data).ok()?;
    let (v, w) = (twist.twist.linear, twist.twist.angular);
    let twist = (Vector3::new(v.x, v.y, v.z), Vector3::new(w.x, w.y, w.z));
    Some(Estimate { twist: Some(twist), ..estimate(&header, &pose)? })
}

fn read_pose(data: &[u8]) -> Option<Estimate> {
    let PoseWithCovarianceStamped { header, pose } = cdr::from_bytes(data).ok()?;
    estimate(&header, &pose)
}

/// An estimate without a twist; `None` where the pose is invalid.
fn estimate(header: &Header, pose: &PoseWithCovariance) -> Option<Estimate> {
    let (stamp, covariance) =
        (convert::stamp(&header.stamp), convert::covariance6(&pose.covariance));
    let pose = convert::pose(&pose.pose, "pose").ok()?;
    let is_finite = pose.translation.vector.iter().all(|x| x.is_finite());
    is_finite.then_some(Estimate { stamp, pose, covariance, twist: None })
}

#[cfg(test)]
mod tests;
