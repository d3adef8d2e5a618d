//! The developer bags (folder in the environment variable VOLANT_SHARED) with the true marker
//! centroids plus noise in place of a tracker.

use bag::recording::{Recording, Sample, true_centroids};
use pose_fusion::Input;
use rig_model::{Rig, Stamp, score::Truth};
use rig_simulator::random::Random;
use std::path::PathBuf;

/// A bag as the filter gets it, and its truth.
pub struct Bag {
    pub rig: Rig,
    /// In order of arrival.
    pub inputs: Vec<(Stamp, Input)>,
    pub truth: Truth,
}

/// The folder of the bags, else a skip.
pub fn folder() -> Option<PathBuf> {
    Some(test_support::recordings()?.join("bags"))
}

/// Reads a bag; markers are the true centroids with `sigma` px of noise, those shown less than 99 %
/// are lost.
pub fn read(name: &str, sigma: f64, seed: u64) -> Option<Bag> {
    let folder = folder()?.join(name);
    let mut random = Random::fork(seed, "pixels");
    let markers = true_centroids(&folder, sigma, || random.normal()).unwrap();
    let Recording { rig, samples, truth } = Recording::read(&folder, &markers).unwrap();
    let inputs = samples.into_iter().map(|(at, sample)| (at, input(sample))).collect();
    Some(Bag { rig, inputs, truth })
}

fn input(sample: Sample) -> Input {
    match sample {
        Sample::Camera(camera) => Input::Camera(camera),
        Sample::Climber(sample) => Input::Climber(sample),
        Sample::Imu(sample) => Input::Imu(sample),
        Sample::Markers(observations) => Input::Markers(observations),
    }
}
