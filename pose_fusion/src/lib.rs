//! Where the platform is: marker coordinates, inertial samples and the climber's transform in, the fused pose out.
//!
//! The core is [`Fusion`]: [`Fusion::handle`] takes each input in the order in which it arrived, [`Fusion::poll`] gives
//! what there is to say. Time comes with the data; nothing in here reads a clock, logs, sleeps or panics.

pub mod config;
pub mod output;

pub use config::{FusionConfig, Model};
pub use output::{MarkerOutcome, MarkerUpdateRecord, Odometry, Output, PoseEstimate, Warning};

use rig_model::{CameraModel, ClimberSample, ImuSample, MarkerObservations, Rig};
use std::collections::VecDeque;

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
    rig: Rig,
    config: FusionConfig,
    outputs: VecDeque<Output>,
}

impl Fusion {
    /// A filter that knows nothing yet.
    pub fn new(rig: Rig, config: FusionConfig) -> Self {
        Self { rig, config, outputs: VecDeque::new() }
    }

    /// Takes one input.
    pub fn handle(&mut self, input: Input) {
        let _ = (input, &self.rig, &self.config);
    }

    /// The next thing that the filter says, if any.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }
}
