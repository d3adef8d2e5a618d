//! The recordings with ground truth (folder in the environment variable VOLANT_SHARED) with the
//! true marker centroids plus noise in place of a tracker.

use bag::recording::{self, true_centroids};
use rig_simulator::{random::Random, recording::Recording};
use std::path::PathBuf;

/// The folder of the bags, else a skip.
pub fn folder() -> Option<PathBuf> {
    Some(test_support::recordings()?.join("bags"))
}

/// Reads a bag with true centroids and `sigma` px of noise; markers shown below 99 % are lost.
pub fn read(name: &str, sigma: f64, seed: u64) -> Option<Recording> {
    let folder = folder()?.join(name);
    let mut random = Random::fork(seed, "pixels");
    let markers = true_centroids(&folder, sigma, || random.normal()).unwrap();
    let (rig, inputs, truth) = recording::read(&folder, &markers).unwrap();
    Some(Recording { name: format!("bag: {name}"), rig, inputs, truth })
}
