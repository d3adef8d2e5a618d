//! The estimators behind one interface.

use crate::{
    config::{FusionConfig, Model},
    filter::Filter,
    health::{
        pose_status::{PoseState, PoseStatus},
        status::{Counts, InputCounts, Status},
    },
    initialization::checkpoint::{Checkpoint, Refusal},
    output::{Odometry, Output, PoseEstimate, Warning, rate_limit::RateLimit},
    reference::{paper::Paper, single_image::SingleImagePose},
};
/// One input, in the order of arrival.
pub use rig_model::Sample as Input;
use rig_model::{Rig, Stamp, topics};
use std::collections::VecDeque;

/// Length of a batch of smoothed odometry, s.
const SMOOTHED: f64 = 60.0;
/// Later data that a smoothed estimate knows at least, s: biases and time offset are found in less.
const LAG: f64 = 20.0;
/// Without images the published filter reports its status this often, s.
const STATUS_PERIOD: f64 = 0.1;

/// Topic of an input whose stamp is zero.
fn without_stamp(input: &Input) -> Option<&'static str> {
    let (stamp, topic) = match input {
        Input::Imu(sample) => (sample.stamp, topics::IMU),
        Input::Markers(markers) => (markers.stamp, topics::MARKERS),
        Input::Climber(sample) => (sample.stamp, topics::CLIMBER_TRANSFORM),
        Input::Camera(_) => return None,
    };
    stamp.is_unset().then_some(topic)
}

#[derive(Debug)]
#[allow(clippy::large_enum_variant)] // there is one
enum Estimator {
    TightlyCoupled(Filter),
    Paper(Paper),
}

/// Estimator of the platform's pose: inputs in the order of arrival in, estimates out.
#[derive(Debug)]
pub struct Fusion {
    estimator: Estimator,
    single_image: SingleImagePose,
    config: FusionConfig,
    outputs: VecDeque<Output>,
    rate_limit: RateLimit,
    /// Newest status of the published filter.
    last_status: Option<Stamp>,
    /// Inputs of the published filter.
    inputs: InputCounts,
}

impl Fusion {
    /// Creates an estimator without an estimate.
    pub fn new(rig: Rig, config: FusionConfig) -> Self {
        Self {
            single_image: SingleImagePose::new(rig.clone(), &config),
            estimator: match config.model {
                Model::Tight => Estimator::TightlyCoupled(Filter::new(
                    rig,
                    config.tight.clone(),
                    config.status.clone(),
                )),
                Model::Paper => {
                    Estimator::Paper(Paper::new(&rig, config.paper.clone(), config.tight.gravity))
                }
            },
            config,
            outputs: VecDeque::with_capacity(256),
            rate_limit: RateLimit::default(),
            last_status: None,
            inputs: InputCounts::default(),
        }
    }

    /// Takes in one input.
    pub fn handle(&mut self, input: Input) {
        if let Some(source_name) = without_stamp(&input) {
            if let Estimator::TightlyCoupled(filter) = &mut self.estimator {
                let rejected = filter.rejected_counts();
                match input {
                    Input::Imu(_) => rejected.imu += 1,
                    Input::Markers(_) => rejected.images += 1,
                    Input::Climber(_) => rejected.climber += 1,
                    Input::Camera(_) => {}
                }
            }
            self.outputs.push_back(Output::Warning(Warning::NoStamp { source_name }));
            return;
        }
        let out = &mut self.outputs;
        let stamp = match &input {
            Input::Imu(sample) => {
                self.single_image.imu(sample);
                match &mut self.estimator {
                    Estimator::TightlyCoupled(filter) => filter.imu(sample, out),
                    Estimator::Paper(paper) => paper.imu(sample),
                }
                self.inputs.imu += 1;
                sample.stamp
            }
            Input::Markers(markers) => {
                let visual = self.single_image.estimate(markers);
                match &mut self.estimator {
                    Estimator::TightlyCoupled(filter) => filter.markers(markers, out),
                    Estimator::Paper(paper) => {
                        if let Some(odometry) = paper.image(markers.stamp, visual.as_ref()) {
                            let status = paper_status(paper, markers.stamp, &self.config);
                            out.push_back(Output::Odometry(odometry));
                            out.push_back(Output::Status(status));
                            self.last_status = Some(markers.stamp);
                        }
                    }
                }
                self.inputs.images += 1;
                out.extend(visual.map(|v| Output::VisualPose(v.pose)));
                markers.stamp
            }
            Input::Climber(sample) => {
                self.single_image.climber(sample);
                if let Estimator::TightlyCoupled(filter) = &mut self.estimator {
                    filter.climber(sample, out);
                }
                sample.stamp
            }
            Input::Camera(camera) => {
                self.single_image.camera(camera);
                if let Estimator::TightlyCoupled(filter) = &mut self.estimator {
                    filter.camera(camera);
                }
                return;
            }
        };
        match &mut self.estimator {
            Estimator::TightlyCoupled(filter) => filter.publish_initializing(stamp, out),
            Estimator::Paper(paper) => {
                let since =
                    |last: Option<Stamp>| last.map_or(f64::INFINITY, |l| stamp.seconds_since(l));
                let silent = since(paper.stamp());
                let starved = silent > self.config.status.max_image_age;
                if starved && !(0.0..STATUS_PERIOD).contains(&since(self.last_status)) {
                    self.last_status = Some(stamp);
                    let mut status = paper_status(paper, stamp, &self.config);
                    if paper.stamp().is_some() {
                        (status.state, status.valid) = (PoseState::Lost, false);
                        status.reason = format!(
                            "no climber/markers for {silent:.1} s: the published filter gives a \
                             pose with images only"
                        );
                    }
                    out.push_back(Output::Status(status));
                }
            }
        }
    }

    /// Returns the next output, if any.
    pub fn poll(&mut self) -> Option<Output> {
        let rate = self.config.publish_rate;
        loop {
            let output = self.outputs.pop_front()?;
            if self.rate_limit.passes(&output, rate) {
                return Some(output);
            }
        }
    }

    /// Discards the estimate; the next image initializes it.
    pub fn reset(&mut self) {
        self.single_image.reset();
        match &mut self.estimator {
            Estimator::TightlyCoupled(filter) => filter.reset(),
            Estimator::Paper(paper) => paper.reset(),
        }
    }

    /// Puts the platform at a pose `world_from_volant` with its covariance (error-state filter), at
    /// a stamp within the history.
    ///
    /// # Errors
    /// See [`Refusal`]; nothing is changed then.
    pub fn set_pose(&mut self, pose: &PoseEstimate) -> Result<(), Refusal> {
        match &mut self.estimator {
            Estimator::TightlyCoupled(filter) => filter.set_pose(pose, &mut self.outputs),
            Estimator::Paper(_) => Err(NOT_OF_THE_PAPER),
        }
    }

    /// Returns everything that the error-state filter knows now.
    ///
    /// # Errors
    /// There is no estimate, or the published filter runs.
    pub fn checkpoint(&self) -> Result<Checkpoint, Refusal> {
        match &self.estimator {
            Estimator::TightlyCoupled(filter) => filter.checkpoint(),
            Estimator::Paper(_) => Err(NOT_OF_THE_PAPER),
        }
    }

    /// Restores a checkpoint: all of it where the next IMU sample follows within 0.4 s, else time
    /// offset and biases, and the next image gives the pose.
    ///
    /// # Errors
    /// The checkpoint is invalid, or the published filter runs; nothing is changed then.
    pub fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), Refusal> {
        match &mut self.estimator {
            Estimator::TightlyCoupled(filter) => filter.restore(checkpoint),
            Estimator::Paper(_) => Err(NOT_OF_THE_PAPER),
        }
    }

    /// Stops or resumes using markers (error-state filter): what is not used is still compared and
    /// recorded.
    pub fn freeze(&mut self, frozen: bool) {
        if let Estimator::TightlyCoupled(filter) = &mut self.estimator {
            filter.freeze(frozen);
        }
    }

    /// Keeps from now on what [`Fusion::smoothed`] needs.
    pub fn keep_for_smoothing(&mut self) {
        if let Estimator::TightlyCoupled(filter) = &mut self.estimator {
            filter.keep_archive();
        }
    }

    /// Returns the smoothed odometry that later data no longer change (error-state filter); at the
    /// `end` of the run all of it.
    ///
    /// A minute at a time with the knowledge of 20 s more, so that memory is bounded however long
    /// the run is.
    pub fn smoothed(&mut self, end: bool) -> Vec<Odometry> {
        let Estimator::TightlyCoupled(filter) = &mut self.estimator else { return Vec::new() };
        if !end && filter.archived() <= SMOOTHED + LAG {
            return Vec::new();
        }
        if end {
            filter.archive_all();
        }
        filter.smoothed(if end { 0.0 } else { LAG })
    }

    /// Returns why there is no estimate yet; empty where there is one.
    pub fn missing(&self) -> String {
        match &self.estimator {
            Estimator::TightlyCoupled(filter) if filter.state().is_some() => String::new(),
            Estimator::TightlyCoupled(filter) => filter.missing(),
            Estimator::Paper(paper) => paper.missing().to_owned(),
        }
    }

    /// Whether the published filter runs with an IMU that outputs no attitude, so that it is
    /// computed from the samples.
    pub fn computes_attitude(&self) -> bool {
        matches!(&self.estimator, Estimator::Paper(paper) if paper.computes_attitude())
    }

    /// Returns counters and insights for diagnostics.
    pub fn status(&self) -> Status {
        match &self.estimator {
            Estimator::TightlyCoupled(filter) => filter.status(),
            Estimator::Paper(paper) => Status {
                initialized: paper.stamp().is_some(),
                newest_imu: paper.newest_imu(),
                last_used_image: paper.last_visual().map(|(stamp, _)| stamp),
                position_sigma: sigmas(paper).0,
                counts: Counts { inputs: self.inputs, ..Counts::default() },
                ..Status::default()
            },
        }
    }
}

const NOT_OF_THE_PAPER: Refusal =
    Refusal::Invalid { what: "the request", why: "the published filter runs (parameter `model`)" };

/// Status of the published filter at an instant.
fn paper_status(paper: &Paper, now: Stamp, config: &FusionConfig) -> PoseStatus {
    if paper.stamp().is_none() {
        return PoseStatus::initializing(now, paper.missing().to_owned());
    }
    let since =
        |stamp: Option<Stamp>| stamp.map_or(f64::INFINITY, |s| now.seconds_since(s).max(0.0));
    let (position_sigma, rotation_sigma) = sigmas(paper);
    let image_age = since(paper.last_visual().map(|(stamp, _)| stamp));
    let imu_age = since(paper.newest_imu());
    let mut status = PoseStatus {
        position_sigma,
        rotation_sigma,
        image_age,
        imu_age,
        // A visual pose rests on an encoder reading of its instant.
        climber_age: image_age,
        markers_used: paper.last_visual().map_or(0, |(_, markers)| markers),
        ..PoseStatus::initializing(now, String::new())
    }
    .judged(&config.status, imu_age > crate::timeline::dropout::GAP, false);
    if status.state == PoseState::Coasting {
        status.reason = format!(
            "two or more markers hidden, or no climber/transform: {}; the doubly integrated \
             accelerations carry the pose",
            status.reason
        );
    }
    status
}

/// Largest standard deviations of position (m) and rotation (rad) of the published filter; infinite
/// without an estimate.
fn sigmas(paper: &Paper) -> (f64, f64) {
    paper.covariance().map_or((f64::INFINITY, f64::INFINITY), |covariance| {
        let largest = |first: usize| {
            let block = covariance.fixed_view::<3, 3>(first, first).into_owned();
            block.symmetric_eigenvalues().max().max(0.0).sqrt()
        };
        (largest(0), largest(3))
    })
}
