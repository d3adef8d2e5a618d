//! Recordings with ground truth as inputs of the estimator.

use anyhow::Context;
use bag::{
    BagError,
    recording::{self, Markers, read_markers, true_centroids},
};
use nalgebra::Isometry3;
use pose_fusion::Input;
use rig_model::{CameraModel, Distortion, Rig, Stamp};
use rig_simulator::{
    RIG_YAML,
    inertial::SensorConfig,
    motion::{Motion, MotionConfig},
    random::Random,
    recording::Recording,
};
use std::{
    fs,
    path::{Path, PathBuf},
};

/// Returns the folders of recordings with truth in `bags` whose name contains `only`, sorted.
///
/// Whether the other files are there shows when they are read, which names the missing one.
pub fn folders(bags: &Path, only: &str) -> anyhow::Result<Vec<PathBuf>> {
    let entries = fs::read_dir(bags).with_context(|| bags.display().to_string())?;
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut folders: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.join("truth.mcap").is_file())
        .filter(|path| name(path).contains(only))
        .collect();
    folders.sort();
    Ok(folders)
}

/// Simulates a run on the simulator's rig; the motion's seed is the sensors' as well.
pub fn simulated(motion: MotionConfig) -> anyhow::Result<Recording> {
    let lens = Distortion::PlumbBob([-0.23, 0.082, 7e-4, -4e-4, -0.006]);
    let camera = CameraModel::new(640, 480, [591.3, 589.7, 319.3, 235.2], lens)?;
    let (rig, sensors) = (Rig::from_yaml(RIG_YAML)?, SensorConfig::nominal(motion.seed));
    Ok(Recording::simulated(rig, camera, &Motion::new(motion), &sensors))
}

/// Reads a folder with `in.mcap`, `rig.yaml`, `truth.mcap` and `truth_markers.csv`.
///
/// Markers are those on `climber/markers` of the recording itself, else of the bag `markers` (a
/// replay's output); without any they are the true centroids with 0.1 px of noise.
pub fn read(folder: &Path, markers: Option<&Path>) -> Result<Recording, BagError> {
    let mut images = markers.map(read_markers).transpose()?.unwrap_or_default();
    if images.is_empty() {
        let mut random = Random::fork(1, "pixels");
        images = true_centroids(folder, 0.1, || random.normal())?;
    }
    read_with(folder, &images)
}

/// Reads a folder with these observations of its images, unless it has its own.
pub fn read_with(folder: &Path, images: &Markers) -> Result<Recording, BagError> {
    let (rig, inputs, truth) = recording::read(folder, images)?;
    let name = folder.file_name().map_or(String::new(), |n| n.to_string_lossy().into_owned());
    Ok(Recording { name, rig, inputs, truth })
}

/// Returns by how much the climber moves the platform at most, m/s: its speed, and its turn by the
/// platform's distance.
pub fn climber_speed(recording: &Recording) -> f64 {
    /// Number of readings that a speed spans: encoders count in steps.
    const SPAN: usize = 5;
    let poses: Vec<(Stamp, Isometry3<f64>)> = recording
        .inputs
        .iter()
        .filter_map(|(_, input)| match input {
            Input::Climber(c) => Some((c.stamp, c.world_from_climber)),
            _ => None,
        })
        .collect();
    let moved = |a: &(Stamp, Isometry3<f64>), b: &(Stamp, Isometry3<f64>)| {
        let truth = recording.pose_at(b.0)?.translation.vector;
        let arm = (truth - b.1.translation.vector).xy().norm();
        let way = (b.1.translation.vector - a.1.translation.vector).norm();
        Some((way + arm * a.1.rotation.angle_to(&b.1.rotation)) / b.0.seconds_since(a.0))
    };
    let speeds = poses.iter().zip(poses.iter().skip(SPAN)).filter_map(|(a, b)| moved(a, b));
    speeds.filter(|speed| speed.is_finite()).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_without_its_bag_is_listed() {
        let dir = tempfile::tempdir().unwrap();
        let run = dir.path().join("run");
        fs::create_dir(&run).unwrap();
        fs::write(run.join("truth.mcap"), "").unwrap();
        fs::create_dir(dir.path().join("other")).unwrap();
        assert_eq!(folders(dir.path(), "").unwrap(), [run]);
    }
}
