//! Where the platform is: marker coordinates, inertial samples and the climber's transform in, the fused pose out.
//!
//! The core is [`Fusion`]: [`Fusion::handle`] takes each input in the order in which it arrived, [`Fusion::poll`] gives
//! what there is to say. Time comes with the data; nothing in here reads a clock, logs, sleeps or panics.
//!
//! [`tight`] is the error-state filter on the markers' pixels (the default).

pub mod config;
pub mod output;
pub mod status;
pub mod tight;

pub use config::{FusionConfig, Model, PaperConfig, TightConfig};
pub use output::{MarkerOutcome, MarkerUpdateRecord, Odometry, Output, PoseEstimate, Warning};
pub use status::Status;

use rig_model::{CameraModel, ClimberSample, ImuSample, MarkerObservations, Rig};
use std::collections::VecDeque;
use tight::Tight;

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
    tight: Tight,
    outputs: VecDeque<Output>,
}

impl Fusion {
    /// A filter that knows nothing yet.
    pub fn new(rig: Rig, config: FusionConfig) -> Self {
        Self { tight: Tight::new(rig, config.tight), outputs: VecDeque::with_capacity(256) }
    }

    /// Takes one input.
    pub fn handle(&mut self, input: Input) {
        match input {
            Input::Imu(sample) => self.tight.imu(&sample, &mut self.outputs),
            Input::Markers(markers) => self.tight.markers(&markers, &mut self.outputs),
            Input::Climber(sample) => self.tight.climber(&sample, &mut self.outputs),
            Input::Camera(camera) => self.tight.camera(camera),
        }
    }

    /// The next thing that the filter says, if any.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// The error-state filter, to look into it.
    pub fn tight(&self) -> &Tight {
        &self.tight
    }

    /// Counters and insights for diagnostics.
    pub fn status(&self) -> Status {
        self.tight.status()
    }
}
