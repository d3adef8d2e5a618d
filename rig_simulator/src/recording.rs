//! Runs with ground truth, as inputs of an estimator.

use crate::{
    inertial::{Samples, SensorConfig, Sensors},
    motion::Motion,
};
use nalgebra::Isometry3;
use rig_model::{
    CameraModel, ImuSample, Rig, Sample, Stamp,
    score::{Truth, TruthSample},
};

/// Run with ground truth, simulated or read from bags.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Name, such as that of its folder.
    pub name: String,
    /// Rig file.
    pub rig: Rig,
    /// Inputs with their times of arrival, in the order of arrival.
    pub inputs: Samples,
    /// True motion.
    pub truth: Truth,
}

impl Recording {
    /// Simulates a run: the camera's calibration, then every sample, and the truth at 200 Hz from
    /// 50 ms before the run to 50 ms after it.
    pub fn simulated(
        rig: Rig,
        camera: CameraModel,
        motion: &Motion,
        sensors: &SensorConfig,
    ) -> Self {
        let recorded = Sensors::new(motion, &rig, &camera, sensors).record();
        let mut inputs = vec![(sensors.epoch, Sample::Camera(camera))];
        inputs.extend(recorded);
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
        let name = format!("simulated {}", motion.config().seed);
        Self { name, rig, inputs, truth: Truth::new(truth) }
    }

    /// Stamp of the first truth.
    pub fn start(&self) -> Stamp {
        self.truth.span().map_or(Stamp::default(), |(first, _)| first)
    }

    /// True pose at an instant, interpolated.
    pub fn pose_at(&self, stamp: Stamp) -> Option<Isometry3<f64>> {
        Some(self.truth.at(stamp)?.world_from_volant)
    }

    /// First calibration of the camera.
    pub fn camera(&self) -> Option<&CameraModel> {
        self.inputs.iter().find_map(|(_, input)| match input {
            Sample::Camera(camera) => Some(camera),
            _ => None,
        })
    }

    /// Inputs in the order of arrival.
    pub fn inputs(&self) -> impl Iterator<Item = Sample> {
        self.inputs.iter().map(|(_, input)| input.clone())
    }

    /// Inputs with their times of arrival since the first one, s.
    pub fn timed(&self) -> Vec<(f64, Sample)> {
        let first = self.inputs.first().map_or(Stamp::default(), |(at, _)| *at);
        self.inputs.iter().map(|(at, input)| (at.seconds_since(first), input.clone())).collect()
    }

    /// Inputs, each changed with its time of arrival since the first one, s.
    pub fn changed(&self, mut change: impl FnMut(f64, &mut Sample)) -> Vec<Sample> {
        let mut inputs = self.timed();
        inputs.iter_mut().for_each(|(at, input)| change(*at, input));
        inputs.into_iter().map(|(_, input)| input).collect()
    }

    /// Holds back the IMU samples until `count` are there. They are stamped then, `apart` seconds
    /// apart; without it they keep their stamps.
    pub fn arrive_in_bursts(&mut self, count: usize, apart: Option<f64>) {
        let (mut held, mut inputs) = (Vec::new(), Vec::new());
        for (at, input) in self.inputs.drain(..) {
            let Sample::Imu(sample) = input else {
                inputs.push((at, input));
                continue;
            };
            held.push(sample);
            if held.len() == count {
                inputs.extend(held.drain(..).enumerate().map(|(k, held)| {
                    let later = (count - 1 - k) as f64;
                    let stamp =
                        apart.map_or(held.stamp, |apart| sample.stamp.plus_seconds(-apart * later));
                    (at, Sample::Imu(ImuSample { stamp, ..held }))
                }));
            }
        }
        self.inputs = inputs;
    }
}
