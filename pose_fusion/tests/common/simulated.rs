//! The simulated rig as inputs of the filter, with its truth.

use pose_fusion::{FusionConfig, Input, config::CalibrationSigmas};
use rig_model::{CameraModel, Distortion, Rig, Stamp};
use rig_simulator::{
    inertial::SensorConfig,
    motion::{Motion, MotionConfig},
    recording::Recording,
};
use std::ops::{Deref, DerefMut};

pub fn rig() -> Rig {
    Rig::from_yaml(rig_simulator::RIG_YAML).unwrap()
}

/// The defaults, without calibration errors: the simulated rig has none.
pub fn config() -> FusionConfig {
    let mut config = FusionConfig::default();
    config.tight.calibration = CalibrationSigmas::NONE;
    config.tight.imu.mounting_yaw = 0.0;
    config
}

pub fn camera() -> CameraModel {
    let lens = Distortion::PlumbBob([-0.229544, 0.08209, 0.00069, -0.000372, -0.006257]);
    CameraModel::new(640, 480, [591.3, 589.7, 319.3, 235.2], lens).unwrap()
}

pub struct Run {
    pub motion: Motion,
    pub recording: Recording,
}

impl Deref for Run {
    type Target = Recording;

    fn deref(&self) -> &Recording {
        &self.recording
    }
}

impl DerefMut for Run {
    fn deref_mut(&mut self) -> &mut Recording {
        &mut self.recording
    }
}

/// The stamp of an input that has one.
pub fn stamp_of(input: &mut Input) -> Option<&mut Stamp> {
    match input {
        Input::Imu(s) => Some(&mut s.stamp),
        Input::Markers(s) => Some(&mut s.stamp),
        Input::Climber(s) => Some(&mut s.stamp),
        Input::Camera(_) => None,
    }
}

pub fn run(motion: MotionConfig, sensors: &SensorConfig) -> Run {
    let motion = Motion::new(motion);
    let recording = Recording::simulated(rig(), camera(), &motion, sensors);
    Run { motion, recording }
}

/// Six motions of 14 s, each with its seed: a swing and a fast swing in turns.
pub fn motions() -> Vec<(u64, MotionConfig)> {
    let n = |seed| MotionConfig { duration: 14.0, ..MotionConfig::nominal(seed) };
    let f = |seed| MotionConfig { duration: 14.0, ..MotionConfig::fast_swing(seed) };
    (1..=3).flat_map(|seed| [(seed, n(seed)), (seed + 10, f(seed))]).collect()
}
