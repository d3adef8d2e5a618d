//! Where the platform is: marker coordinates, inertial samples and the climber's transform in, the fused pose out.
//!
//! The core is [`Fusion`]: [`Fusion::handle`] takes each input in the order in which it arrived, [`Fusion::poll`] gives
//! what there is to say. Time comes with the data; nothing in here reads a clock, logs, sleeps or panics.
//!
//! [`tight`] is the error-state filter on the markers' pixels (the default), [`paper`] the published filter, [`visual`] the pose
//! from one image alone. The shell is in `node` (feature `node`).

pub mod config;
#[cfg(feature = "messages")]
pub mod messages;
#[cfg(feature = "node")]
pub mod node;
pub mod output;
pub mod paper;
#[cfg(feature = "node")]
pub mod services;
pub mod status;
pub mod tight;
pub mod visual;

pub use config::{FusionConfig, Model, PaperConfig, PendulumConfig, TightConfig};
pub use output::{MarkerOutcome, MarkerUpdateRecord, Odometry, Output, PoseEstimate, Warning};
pub use status::Status;
pub use tight::operator::{Checkpoint, Refusal};

use paper::Paper;
use rig_model::{CameraModel, ClimberSample, ImuSample, MarkerObservations, Rig};
use std::collections::VecDeque;
use tight::{Tight, bank::Bank};
use visual::VisualPoses;

/// One input, in the order of arrival.
#[derive(Clone, Debug, PartialEq)]
pub enum Input {
    /// An inertial sample.
    Imu(ImuSample),
    /// The markers of one image.
    Markers(MarkerObservations),
    /// The climber's pose.
    Climber(ClimberSample),
    /// The camera's calibration.
    Camera(CameraModel),
}

/// The estimator: inputs in order of arrival in, estimates out.
#[derive(Debug)]
pub struct Fusion {
    model: Model,
    tight: Bank,
    paper: Paper,
    visual: VisualPoses,
    outputs: VecDeque<Output>,
}

impl Fusion {
    /// A filter that knows nothing yet.
    pub fn new(rig: Rig, config: FusionConfig) -> Self {
        let climber =
            [config.tight.climber_quantum, config.tight.climber_turn_quantum].map(|q| q / 12f64.sqrt());
        Self {
            model: config.model,
            visual: VisualPoses::new(rig.clone(), config.tight.pixel_floor, climber),
            paper: Paper::new(&rig, config.paper),
            tight: Bank::new(rig, config.tight),
            outputs: VecDeque::with_capacity(256),
        }
    }

    /// Takes one input.
    pub fn handle(&mut self, input: Input) {
        match input {
            Input::Imu(sample) => {
                self.visual.imu(&sample);
                match self.model {
                    Model::Tight => self.tight.imu(&sample, &mut self.outputs),
                    Model::Paper => self.paper.imu(&sample),
                }
            }
            Input::Markers(markers) => {
                let visual = self.visual.estimate(&markers);
                match self.model {
                    Model::Tight => self.tight.markers(&markers, &mut self.outputs),
                    Model::Paper => {
                        let odometry = self.paper.image(markers.stamp, visual.as_ref());
                        self.outputs.extend(odometry.map(Output::Odometry));
                    }
                }
                self.outputs.extend(visual.map(Output::VisualPose));
            }
            Input::Climber(sample) => {
                self.visual.climber(&sample);
                if self.model == Model::Tight {
                    self.tight.climber(&sample, &mut self.outputs);
                }
            }
            Input::Camera(camera) => {
                self.visual.camera(&camera);
                self.tight.camera(&camera);
            }
        }
    }

    /// The next thing that the filter says, if any.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// Forgets the estimate and starts from the next image.
    pub fn reset(&mut self) {
        self.tight.reset();
        self.visual.reset();
        self.paper.reset();
    }

    /// Puts the platform at a pose (error-state filter): `world_from_volant` with its covariance, at a stamp of the newest
    /// 0.6 s ([`TightConfig::history`]).
    ///
    /// # Errors
    /// See [`Refusal`]; nothing is changed then.
    pub fn set_pose(&mut self, pose: &PoseEstimate) -> Result<(), Refusal> {
        self.tight.set_pose(pose, &mut self.outputs)
    }

    /// Everything that the error-state filter knows now.
    ///
    /// # Errors
    /// There is no estimate.
    pub fn checkpoint(&self) -> Result<Checkpoint, Refusal> {
        self.tight.checkpoint()
    }

    /// Takes up what was known: all of it where the next inertial sample follows within 0.4 s, else clocks and biases, and
    /// the next image gives the pose.
    ///
    /// # Errors
    /// The checkpoint cannot be; nothing is changed then.
    pub fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), Refusal> {
        self.tight.restore(checkpoint)
    }

    /// Keeps from now on what [`Fusion::smoothed`] needs.
    pub fn keep_for_smoothing(&mut self) {
        self.tight.keep_archive();
    }

    /// The estimates that later data have smoothed and no more will change (error-state filter); at the `end` of the run all.
    pub fn smoothed(&mut self, end: bool) -> Vec<Odometry> {
        self.tight.smoothed(end)
    }

    /// Stops or resumes using markers (error-state filter): what is not used is still compared and recorded.
    pub fn freeze(&mut self, frozen: bool) {
        self.tight.freeze(frozen);
    }

    /// The error-state filter, to look into it.
    pub fn tight(&self) -> &Tight {
        self.tight.speaker()
    }

    /// Counters and insights for diagnostics (of the error-state filter).
    pub fn status(&self) -> Status {
        self.tight.status()
    }
}
