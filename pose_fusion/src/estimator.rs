//! The estimators behind one interface.

use crate::{
    config::{FusionConfig, Model},
    filter::Filter,
    health::{pose_status::PoseStatus, status::Status},
    initialization::checkpoint::{Checkpoint, Refusal},
    output::{Odometry, Output, PoseEstimate},
    reference::{paper::Paper, single_image::SingleImagePose},
};
use rig_model::{CameraModel, ClimberSample, ImuSample, MarkerObservations, Rig, Stamp};
use std::collections::VecDeque;

/// Length of a batch of smoothed odometry, s.
const SMOOTHED: f64 = 60.0;
/// Later data that a smoothed estimate knows at least, s: biases and time offset are found in less.
const LAG: f64 = 20.0;

/// One input, in the order of arrival.
#[derive(Clone, Debug, PartialEq)]
pub enum Input {
    /// IMU sample.
    Imu(ImuSample),
    /// Markers of one image.
    Markers(MarkerObservations),
    /// Pose of the climber.
    Climber(ClimberSample),
    /// Calibration of the camera.
    Camera(CameraModel),
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
    newest_image: Option<Stamp>,
}

impl Fusion {
    /// Creates an estimator without an estimate.
    pub fn new(rig: Rig, config: FusionConfig) -> Self {
        Self {
            single_image: SingleImagePose::new(
                rig.clone(),
                &config.tight,
                config.visual_use_gravity,
            ),
            estimator: match config.model {
                Model::Tight => Estimator::TightlyCoupled(Filter::new(
                    rig,
                    config.tight.clone(),
                    config.status.clone(),
                )),
                Model::Paper => Estimator::Paper(Paper::new(&rig, config.paper.clone())),
            },
            config,
            outputs: VecDeque::with_capacity(256),
            newest_image: None,
        }
    }

    /// Takes in one input.
    pub fn handle(&mut self, input: Input) {
        let out = &mut self.outputs;
        let stamp = match &input {
            Input::Imu(sample) => {
                self.single_image.imu(sample);
                match &mut self.estimator {
                    Estimator::TightlyCoupled(filter) => filter.imu(sample, out),
                    Estimator::Paper(paper) => paper.imu(sample),
                }
                sample.stamp
            }
            Input::Markers(markers) => {
                let visual = self.single_image.estimate(markers);
                match &mut self.estimator {
                    Estimator::TightlyCoupled(filter) => filter.markers(markers, out),
                    Estimator::Paper(paper) => {
                        if let Some(odometry) = paper.image(markers.stamp, visual.as_ref()) {
                            let image_age = if visual.is_some() { 0.0 } else { f64::INFINITY };
                            let status =
                                paper_status(&odometry, image_age, paper.imu_age(), &self.config);
                            out.push_back(Output::Odometry(odometry));
                            out.push_back(Output::Status(status));
                            self.newest_image = Some(markers.stamp);
                        }
                    }
                }
                out.extend(visual.map(Output::VisualPose));
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
        if let Estimator::TightlyCoupled(filter) = &mut self.estimator {
            filter.publish_initializing(stamp, out);
        }
    }

    /// Returns the next output, if any.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
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

    /// Returns the error-state filter, where it runs.
    pub fn filter(&self) -> Option<&Filter> {
        match &self.estimator {
            Estimator::TightlyCoupled(filter) => Some(filter),
            Estimator::Paper(_) => None,
        }
    }

    /// Returns why there is no estimate yet; empty where there is one.
    pub fn missing(&self) -> String {
        match &self.estimator {
            Estimator::TightlyCoupled(filter) if filter.state().is_some() => String::new(),
            Estimator::TightlyCoupled(filter) => filter.missing(),
            Estimator::Paper(_) if self.newest_image.is_some() => String::new(),
            Estimator::Paper(paper) => paper.missing().to_owned(),
        }
    }

    /// Returns counters and insights for diagnostics.
    pub fn status(&self) -> Status {
        match &self.estimator {
            Estimator::TightlyCoupled(filter) => filter.status(),
            Estimator::Paper(_) => Status {
                initialized: self.newest_image.is_some(),
                newest_imu: self.newest_image,
                last_used_image: self.newest_image,
                ..Status::default()
            },
        }
    }
}

const NOT_OF_THE_PAPER: Refusal =
    Refusal::Invalid { what: "the request", why: "the published filter runs (parameter `model`)" };

fn paper_status(
    odometry: &Odometry,
    image_age: f64,
    imu_age: f64,
    config: &FusionConfig,
) -> PoseStatus {
    let largest = |first: usize| {
        let block = odometry.pose_covariance.fixed_view::<3, 3>(first, first).into_owned();
        block.symmetric_eigenvalues().max().max(0.0).sqrt()
    };
    let vision_only = imu_age > crate::timeline::dropout::GAP;
    PoseStatus {
        position_sigma: largest(0),
        rotation_sigma: largest(3),
        image_age,
        imu_age,
        climber_age: image_age,
        ..PoseStatus::initializing(odometry.stamp, String::new())
    }
    .judged(&config.status, vision_only)
}
