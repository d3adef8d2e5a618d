//! Estimates against the truth: a bag with estimates and a bag with `ground_truth/odometry` flow in, errors flow out.
//!
//! The truth is taken at each estimate's own stamp. The first second is left out, counted from where both bags have
//! begun. `volant/fused_pose` is turned round first, so that all errors are those of the platform in the room.

mod many;
mod page;
mod report;
mod statistics;
mod truth;

pub use many::{RunFiles, RunResult, csv_of_many, evaluate_many, pairs, table_of_many};
pub use page::{page, page_of_many};
pub use report::{csv, table};
pub use statistics::{Nees, PoseError, Spread, inverse};
pub use truth::{Truth, TruthSample};

use crate::{
    bag::{BagError, BagReader},
    replay::TopicNames,
    report::Track,
};
use nalgebra::{Isometry3, Matrix6, Vector3};
use node_kit::convert;
use rig_model::Stamp;
use serde::Serialize;
use statistics::SpreadSum;
use std::path::{Path, PathBuf};
use thiserror::Error;
use volant_msgs::{Message, cdr, geometry_msgs::msg::PoseWithCovarianceStamped, nav_msgs::msg::Odometry};

/// A gap longer than this counts (s).
const GAP: f64 = 0.030;
/// The estimates, by their relative topic; the last one is what `replay --smooth` adds.
pub const ESTIMATES: [&str; 4] =
    ["volant/odometry", "volant/fused_pose", "volant/visual_pose", "volant/smoothed_odometry"];
const TRUTH: &str = "ground_truth/odometry";

/// What is compared, and how.
#[derive(Clone, Debug)]
pub struct EvaluateOptions {
    /// The bag with the estimates.
    pub estimates: PathBuf,
    /// The bag with the truth.
    pub truth: PathBuf,
    /// How much of the beginning is left out, s.
    pub skip: f64,
    /// Namespace and remaps.
    pub names: TopicNames,
}

/// How good one estimate is.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Quality {
    /// Its relative topic.
    pub estimate: String,
    /// How many were compared.
    pub count: u64,
    /// 3-D norm, mm.
    pub position_mm: Spread,
    /// Length of the rotation vector, deg.
    pub rotation_deg: Spread,
    /// x, y, z, mm.
    pub axes_mm: [Spread; 3],
    /// Roll, pitch, yaw, deg.
    pub angles_deg: [Spread; 3],
    /// Mean, 3 at best; `None` where no covariance can be used.
    pub nees_position: Option<f64>,
    /// Mean, 3 at best.
    pub nees_rotation: Option<f64>,
    /// Mean over all six, 6 at best.
    pub nees_pose: Option<f64>,
    /// Of the velocity, mm/s, where the estimate and the truth have one.
    pub velocity_mm_s: Option<Spread>,
    /// Of the rate of turn, deg/s.
    pub turn_deg_s: Option<Spread>,
    /// Per second.
    pub rate_hz: f64,
    /// Times without a new one for more than 30 ms.
    pub gaps_over_30_ms: u64,
    /// Longest time without a new one, ms.
    pub longest_gap_ms: f64,
    /// The first one, s after the run's beginning.
    pub first_s: f64,
    /// The last one, s after the run's beginning.
    pub last_s: f64,
    /// Poses that are not finite, and messages that could not be read.
    pub unusable: u64,
    /// Covariances that are not positive definite.
    pub without_covariance: u64,
    /// Estimates at times without truth.
    pub without_truth: u64,
}

/// What an evaluation found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// One for each estimate that the bag holds.
    pub estimates: Vec<Quality>,
    /// What the bags lost, one sentence each.
    pub losses: Vec<String>,
    /// The poses themselves, for pictures.
    #[serde(skip)]
    pub tracks: Tracks,
}

/// The poses that were compared.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tracks {
    /// Where both bags have begun.
    pub began: Stamp,
    /// Topic and poses, `world_from_volant`, as in [`Evaluation::estimates`].
    pub estimates: Vec<(String, Track)>,
    /// The truth.
    pub truth: Truth,
}

/// Why nothing can be said.
#[derive(Debug, Error)]
pub enum EvaluateError {
    /// A bag cannot be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// No truth.
    #[error("{}: no usable nav_msgs/msg/Odometry on {topic}; give the bag with the truth to --truth, or name its topic with --remap {TRUTH}:=OTHER", path.display())]
    NoTruth {
        /// The bag.
        path: PathBuf,
        /// The topic.
        topic: String,
    },
    /// No estimate.
    #[error("{}: no estimate on {}; give the bag that `volant replay --out` wrote", path.display(), topics.join(", "))]
    NoEstimate {
        /// The bag.
        path: PathBuf,
        /// The topics.
        topics: Vec<String>,
    },
    /// A folder of runs.
    #[error("{}: {reason}", path.display())]
    Folder {
        /// Which.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// Estimates and truth of different times.
    #[error("{}: none of its estimates lies within the truth's time ({from} to {to}, without the first {skip} s); check that both bags are of one run", path.display())]
    Apart {
        /// The bag with the estimates.
        path: PathBuf,
        /// The truth's beginning.
        from: Stamp,
        /// The truth's end.
        to: Stamp,
        /// What is left out, s.
        skip: f64,
    },
}

struct Estimate {
    stamp: Stamp,
    pose: Isometry3<f64>,
    covariance: Matrix6<f64>,
    twist: Option<(Vector3<f64>, Vector3<f64>)>,
}

/// Compares.
///
/// # Errors
/// See [`EvaluateError`].
pub fn evaluate(options: &EvaluateOptions) -> Result<Evaluation, EvaluateError> {
    let mut losses = vec![];
    let truth = read_truth(&options.truth, &options.names.resolve(TRUTH), &mut losses)?;
    let Some((from, to)) = truth.span() else {
        return Err(EvaluateError::NoTruth {
            path: options.truth.clone(),
            topic: options.names.resolve(TRUTH),
        });
    };
    let topics: Vec<String> = ESTIMATES.iter().map(|name| options.names.resolve(name)).collect();
    let mut collected: [(Vec<Estimate>, u64); ESTIMATES.len()] = Default::default();
    let mut began: Option<Stamp> = None;
    let mut bag = BagReader::open(&options.estimates)?;
    while let Some(message) = bag.next_message()? {
        began.get_or_insert(Stamp::from_nanos(i64::try_from(message.log_time).unwrap_or(0)));
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
            Some(estimate) => collected[which].0.push(estimate),
            None => collected[which].1 += 1,
        }
    }
    losses.extend_from_slice(bag.losses());
    if collected.iter().all(|(estimates, unusable)| estimates.is_empty() && *unusable == 0) {
        return Err(EvaluateError::NoEstimate { path: options.estimates.clone(), topics });
    }
    let began = began.unwrap_or(from).max(from);
    let mut tracks = Tracks { began, estimates: Vec::new(), truth: truth.clone() };
    let estimates: Vec<Quality> = ESTIMATES
        .iter()
        .zip(&mut collected)
        .filter(|(_, (estimates, unusable))| !estimates.is_empty() || *unusable > 0)
        .map(|(name, (estimates, unusable))| {
            estimates.sort_by_key(|e| e.stamp);
            let mut quality = quality(name, estimates, &truth, began, options.skip);
            quality.unusable = *unusable;
            tracks
                .estimates
                .push(((*name).to_owned(), estimates.iter().map(|e| (e.stamp, e.pose)).collect()));
            quality
        })
        .collect();
    if estimates.iter().all(|q| q.count == 0) {
        let path = options.estimates.clone();
        return Err(EvaluateError::Apart { path, from, to, skip: options.skip });
    }
    Ok(Evaluation { estimates, losses, tracks })
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
    let considered = sums.count + without_truth;
    let mean = |sum: f64| (sums.with_covariance > 0).then(|| sum / sums.with_covariance as f64);
    let degrees = 1f64.to_degrees();
    let twist = sums.velocity_known && estimates.iter().any(|e| e.twist.is_some());
    Quality {
        estimate: name.to_owned(),
        count: sums.count,
        position_mm: sums.position.spread(1e3),
        rotation_deg: sums.rotation.spread(degrees),
        axes_mm: sums.axes.map(|s| s.spread(1e3)),
        angles_deg: sums.angles.map(|s| s.spread(degrees)),
        nees_position: mean(sums.nees[0]),
        nees_rotation: mean(sums.nees[1]),
        nees_pose: mean(sums.nees[2]),
        velocity_mm_s: twist.then(|| sums.velocity.spread(1e3)),
        turn_deg_s: twist.then(|| sums.turn.spread(degrees)),
        rate_hz: if duration > 0.0 { considered.saturating_sub(1) as f64 / duration } else { 0.0 },
        gaps_over_30_ms: gaps,
        longest_gap_ms: longest * 1e3,
        first_s: first.seconds_since(began),
        last_s: last.seconds_since(began),
        unusable: 0,
        without_covariance: sums.count - sums.with_covariance,
        without_truth,
    }
}

#[derive(Default)]
struct Sums {
    count: u64,
    position: SpreadSum,
    rotation: SpreadSum,
    axes: [SpreadSum; 3],
    angles: [SpreadSum; 3],
    nees: [f64; 3],
    with_covariance: u64,
    velocity: SpreadSum,
    turn: SpreadSum,
    velocity_known: bool,
}

impl Sums {
    fn add(&mut self, estimate: &Estimate, truth: &TruthSample) {
        let error = PoseError::new(&estimate.pose, &truth.world_from_volant);
        self.count += 1;
        self.position.add(error.position.norm());
        self.rotation.add(error.rotation.norm());
        for axis in 0..3 {
            self.axes[axis].add(error.position[axis]);
            self.angles[axis].add(error.roll_pitch_yaw[axis]);
        }
        if let Some(nees) = Nees::new(&error, &estimate.covariance) {
            self.nees[0] += nees.position;
            self.nees[1] += nees.rotation;
            self.nees[2] += nees.pose;
            self.with_covariance += 1;
        }
        if let Some((linear, angular)) = estimate.twist {
            self.velocity.add((linear - truth.linear_velocity).norm());
            self.turn.add((angular - truth.angular_velocity).norm());
            // A truth that leaves its twist empty has none.
            self.velocity_known |= truth.linear_velocity != Vector3::zeros();
        }
    }
}

fn read_truth(path: &Path, topic: &str, losses: &mut Vec<String>) -> Result<Truth, BagError> {
    let mut bag = BagReader::open(path)?;
    let mut samples = vec![];
    while let Some(message) = bag.next_message()? {
        if message.topic.name != topic || message.topic.type_name != Odometry::TYPE_NAME {
            continue;
        }
        let Some(estimate) = read_odometry(&message.data) else { continue };
        let (linear_velocity, angular_velocity) = estimate.twist.unwrap_or_default();
        samples.push(TruthSample {
            stamp: estimate.stamp,
            world_from_volant: estimate.pose,
            linear_velocity,
            angular_velocity,
        });
    }
    losses.extend_from_slice(bag.losses());
    Ok(Truth::new(samples))
}

fn read_odometry(data: &[u8]) -> Option<Estimate> {
    let message: Odometry = cdr::from_bytes(data).ok()?;
    let twist = &message.twist.twist;
    finite(Estimate {
        stamp: convert::stamp(&message.header.stamp),
        pose: convert::pose(&message.pose.pose, "odometry").ok()?,
        covariance: convert::covariance6(&message.pose.covariance),
        twist: Some((
            Vector3::new(twist.linear.x, twist.linear.y, twist.linear.z),
            Vector3::new(twist.angular.x, twist.angular.y, twist.angular.z),
        )),
    })
}

fn read_pose(data: &[u8]) -> Option<Estimate> {
    let message: PoseWithCovarianceStamped = cdr::from_bytes(data).ok()?;
    finite(Estimate {
        stamp: convert::stamp(&message.header.stamp),
        pose: convert::pose(&message.pose.pose, "pose").ok()?,
        covariance: convert::covariance6(&message.pose.covariance),
        twist: None,
    })
}

fn finite(estimate: Estimate) -> Option<Estimate> {
    estimate.pose.translation.vector.iter().all(|x| x.is_finite()).then_some(estimate)
}
