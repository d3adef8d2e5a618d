//! A recording, its faults, and whether a check names them.

use super::{fault::Fault, light::findings_while_running};
use crate::robustness::recording;
use marker_tracker::TrackerConfig;
use pose_fusion::Input;
use rig_calibration::{Configured, Report, Samples, Track, Verdict, check};
use rig_model::{CameraModel, MarkerLayout, Rig};
use rig_simulator::{motion::MotionConfig, recording::Recording};
use std::path::{Path, PathBuf};
use volant::{calibration::track_bag, replay::TopicNames};

/// A recording with what is needed to track its images again.
#[derive(Clone, Debug)]
pub struct Bench {
    recording: Recording,
    /// Bag with images, where there is one.
    images: Option<PathBuf>,
    /// Report of the unchanged recording.
    clean: Report,
}

/// What a check says of one fault.
#[derive(Clone, Debug)]
pub struct Cell {
    /// Whether it names the cause, and no other one as wrong.
    pub right: bool,
    /// Verdict and keys.
    pub text: String,
    pub sentences: Vec<String>,
}

fn tracker(rig: &Rig) -> TrackerConfig {
    TrackerConfig { start_colors: rig.colors, ..TrackerConfig::default() }
}

impl Bench {
    /// Reads a folder with `in.mcap`, `rig.yaml`, `truth.mcap` and `truth_markers.csv`.
    pub fn read(folder: &Path) -> anyhow::Result<Self> {
        let mut recording = recording::read(folder, None)?;
        let bag = folder.join("in.mcap");
        let camera = recording.camera().cloned();
        let mut images = None;
        if let Some(camera) = camera {
            let rig = &recording.rig;
            let names = TopicNames::default();
            let markers = track_bag(&bag, &rig.markers, &tracker(rig), &camera, None, &names)?;
            if !markers.is_empty() {
                let markers = markers.into_iter().map(|m| (m.stamp, m)).collect();
                recording = recording::read_with(folder, &markers)?;
                images = Some(bag);
            }
        }
        Self::new(recording, images)
    }

    /// Simulates a run in which all axes of the climber move; `seed` fixes it.
    pub fn simulated(seed: u64) -> anyhow::Result<Self> {
        let config = MotionConfig {
            duration: 20.0,
            swing: 0.2,
            climber_speed: 0.5,
            climber_turn_rate: 0.4,
            ..MotionConfig::nominal(seed)
        };
        Self::of_motion(config)
    }

    /// Simulates a run with a motion and its seed.
    pub fn of_motion(config: MotionConfig) -> anyhow::Result<Self> {
        Self::new(recording::simulated(config)?, None)
    }

    fn new(recording: Recording, images: Option<PathBuf>) -> anyhow::Result<Self> {
        let mut bench = Self { recording, images, clean: Report::default() };
        bench.clean = bench.report(&bench.recording, false)?;
        Ok(bench)
    }

    pub fn name(&self) -> &str {
        &self.recording.name
    }

    pub fn clean(&self) -> &Report {
        &self.clean
    }

    /// Applies a fault and returns what the nodes report while they run
    /// ([`findings_while_running`]); without one, of the unchanged recording.
    pub fn while_running(&self, fault: Option<&Fault>) -> Vec<String> {
        let mut recording = self.recording.clone();
        if let Some(fault) = fault {
            (fault.apply)(&mut recording);
        }
        findings_while_running(&recording)
    }

    fn report(&self, recording: &Recording, retrack: bool) -> anyhow::Result<Report> {
        let camera = recording.camera().cloned();
        let camera = camera.ok_or_else(|| anyhow::anyhow!("{}: no camera", recording.name))?;
        let mut samples = Samples { camera, markers: vec![], imu: vec![], climber: vec![] };
        for (_, input) in &recording.inputs {
            match input {
                Input::Markers(m) => samples.markers.push(m.clone()),
                Input::Imu(s) => samples.imu.push(*s),
                Input::Climber(s) => samples.climber.push(s.clone()),
                _ => {}
            }
        }
        let config = tracker(&recording.rig);
        let mut track = |layout: &MarkerLayout, camera: &CameraModel, limit: Option<usize>| {
            let images = self.images.as_deref().unwrap_or(Path::new(""));
            track_bag(images, layout, &config, camera, limit, &TopicNames::default())
                .unwrap_or_default()
        };
        if self.images.is_some() && retrack {
            samples.markers = track(&recording.rig.markers, &samples.camera, None);
        }
        let track: Option<&mut Track<'_>> =
            if self.images.is_some() && retrack { Some(&mut track) } else { None };
        Ok(check(&samples, &recording.rig, Configured::default(), track)?)
    }

    /// Applies a fault and checks the recording.
    pub fn cell(&self, fault: &Fault) -> Cell {
        let mut recording = self.recording.clone();
        (fault.apply)(&mut recording);
        let report = match self.report(&recording, fault.retrack) {
            Ok(report) => report,
            Err(error) => {
                return Cell { right: false, text: format!("error: {error}"), sentences: vec![] };
            }
        };
        let names = |key: &str, list: &[&str]| list.iter().any(|k| key.starts_with(k));
        let (named, others): (Vec<_>, Vec<_>) =
            report.findings.iter().partition(|f| names(&f.key, fault.keys));
        let accused = others.iter().any(|f| f.verdict == Verdict::Wrong);
        let unobservable = report
            .rows
            .iter()
            .any(|r| r.verdict == Verdict::Unobservable && names(&r.name, fault.rows));
        let estimate = |report: &Report, row: &str| {
            let row = report.rows.iter().find(|r| r.name.starts_with(row) && r.unit == "ms");
            row.map_or((f64::NAN, f64::NAN), |r| (r.estimate, r.deviation))
        };
        // Within the tolerance, or the accuracy that the recording's motion allows.
        let measured = fault.offset.is_none_or(|(row, expected, tolerance)| {
            let (with, deviation) = estimate(&report, row);
            let off = with - estimate(&self.clean, row).0 - expected;
            off.abs() < f64::max(tolerance, 2.0 * deviation)
        });
        let right = !accused && if named.is_empty() { unobservable } else { measured };
        let mut keys: Vec<String> =
            report.findings.iter().map(|f| format!("{}: {}", f.verdict, f.key)).collect();
        if keys.is_empty() {
            keys.push(if unobservable { "unobservable" } else { "ok" }.to_owned());
        }
        if !measured && let Some((row, ..)) = fault.offset {
            let (with, deviation) = estimate(&report, row);
            let clean = estimate(&self.clean, row).0;
            keys.push(format!("{row} {with:.1} ± {deviation:.1} ms, unchanged {clean:.1} ms"));
        }
        let sentences = report.findings.iter().map(|f| f.text.clone()).collect();
        Cell { right, text: keys.join(", "), sentences }
    }
}
