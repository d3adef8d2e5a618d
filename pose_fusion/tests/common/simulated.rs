//! The simulated rig as inputs of the filter, with its truth.

use pose_fusion::{FusionConfig, Input, config::CalibrationSigmas};
use rig_model::{
    CameraModel, Distortion, Rig, Stamp,
    score::{Truth, TruthSample},
};
use rig_simulator::{
    inertial::{SensorConfig, Sensors},
    motion::{Motion, MotionConfig},
};

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
    pub inputs: Vec<(Stamp, Input)>,
    pub truth: Truth,
}

impl Run {
    /// The inputs in the order of their arrival.
    pub fn inputs(&self) -> impl Iterator<Item = Input> {
        self.inputs.iter().map(|(_, input)| input.clone())
    }

    /// The inputs with their times of arrival since the epoch, s.
    pub fn timed(&self) -> Vec<(f64, Input)> {
        let epoch = self.inputs[0].0;
        self.inputs.iter().map(|(at, input)| (at.seconds_since(epoch), input.clone())).collect()
    }

    /// The inputs, each changed with its time of arrival since the epoch, s.
    pub fn changed(&self, mut change: impl FnMut(f64, &mut Input)) -> Vec<Input> {
        let mut inputs = self.timed();
        inputs.iter_mut().for_each(|(at, input)| change(*at, input));
        inputs.into_iter().map(|(_, input)| input).collect()
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
    let (rig, camera) = (rig(), camera());
    let recording = Sensors::new(&motion, &rig, &camera, sensors).record();
    let mut inputs = vec![(sensors.epoch, Input::Camera(camera))];
    inputs.extend(recording);
    let count = (motion.duration() * 200.0) as i64;
    let truth = (-10..count + 10)
        .map(|i| {
            let k = motion.kinematics(i as f64 * 0.005);
            TruthSample {
                stamp: sensors.epoch.plus_seconds(i as f64 * 0.005),
                world_from_volant: k.world_from_volant,
                linear_velocity: k.world_from_volant.rotation.inverse() * k.velocity,
                angular_velocity: k.angular_velocity,
            }
        })
        .collect();
    Run { motion, inputs, truth: Truth::new(truth) }
}

/// Six motions of 14 s, each with its seed: a swing and a fast swing in turns.
pub fn motions() -> Vec<(u64, MotionConfig)> {
    let n = |seed| MotionConfig { duration: 14.0, ..MotionConfig::nominal(seed) };
    let f = |seed| MotionConfig { duration: 14.0, ..MotionConfig::fast_swing(seed) };
    (1..=3).flat_map(|seed| [(seed, n(seed)), (seed + 10, f(seed))]).collect()
}
