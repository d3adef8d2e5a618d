//! The nodes' cores connected in sequence, fed in the order in which the bag logged the messages.

use super::{feed::Fed, front_end::FrontEnd, output::OutputBag};
use bag::BagError;
use node_kit::convert;
use pose_fusion::{Fusion, Outcome, Output, RigCheck, messages};
use rig_model::{
    ClimberSample, Frames, ImuSample, MarkerObservations, MarkerState, Sample, Stamp, topics,
};
use std::collections::BTreeMap;

/// Counts of inputs and outputs, and warnings: a flat record, since each field is one number of the
/// printed summary or needed for one.
#[derive(Clone, Debug, Default)]
pub struct Counts {
    /// Decoded images.
    pub images: u64,
    /// Detected markers (at most four per image).
    pub detected: u64,
    /// Marker observations, from images or from the bag.
    pub markers: u64,
    /// IMU samples.
    pub imu: u64,
    /// Climber transforms.
    pub climber: u64,
    /// Odometries.
    pub odometry: u64,
    /// Poses from one image alone.
    pub visual: u64,
    /// Smoothed odometries.
    pub smoothed: u64,
    /// Markers that updated the filter.
    pub used: u64,
    /// Warnings by kind: their number, and the first one.
    pub warnings: BTreeMap<String, (u64, String)>,
    /// What the filter found that correct files would not show, at the end.
    pub findings: Vec<String>,
    /// Stamp of the first IMU sample.
    pub first_imu: Option<Stamp>,
    /// IMU samples more than one second after the first.
    pub imu_settled: u64,
    /// Odometries more than one second after the first IMU sample.
    pub odometry_settled: u64,
    /// Stamp of the last odometry.
    pub last_odometry: Option<Stamp>,
    /// Longest time between two odometries after the first second, s.
    pub longest_gap: f64,
}

impl Counts {
    /// Counts a warning; only the first of a kind is kept.
    pub fn warn(&mut self, kind: &str, sentence: impl FnOnce() -> String) {
        match self.warnings.get_mut(kind) {
            Some((count, _)) => *count += 1,
            None => {
                self.warnings.insert(kind.to_owned(), (1, sentence()));
            }
        }
    }

    /// The first warning of each kind, with their number.
    pub fn warning_lines(&self) -> impl Iterator<Item = String> {
        self.warnings.values().map(with_number)
    }

    fn odometry_at(&mut self, stamp: Stamp) {
        self.odometry += 1;
        if self.first_imu.is_some_and(|first| stamp.seconds_since(first) > 1.0) {
            self.odometry_settled += 1;
            if let Some(last) = self.last_odometry {
                self.longest_gap = self.longest_gap.max(stamp.seconds_since(last));
            }
        }
        self.last_odometry = Some(stamp);
    }
}

/// A warning, with its number where there are several.
fn with_number((count, sentence): &(u64, String)) -> String {
    let times = if *count > 1 { format!(" ({count} times)") } else { String::new() };
    format!("{sentence}{times}")
}

/// A stamp further ahead of the filter's time, s, is wrong, since nothing is out for as long; the
/// filter rejects it. In the output it would be the end of the bag's time.
const FAR_AHEAD: f64 = 3600.0;

/// The cores and the output.
#[derive(Debug)]
pub(super) struct Pipeline {
    frames: Frames,
    front_end: FrontEnd,
    fusion: Fusion,
    output: OutputBag,
    smooth: bool,
    rig_check: RigCheck,
}

impl Pipeline {
    /// Connects the cores.
    pub(super) fn new(
        frames: Frames,
        front_end: FrontEnd,
        fusion: Fusion,
        output: OutputBag,
        smooth: bool,
    ) -> Self {
        let rig_check = RigCheck::default();
        Self { frames, front_end, fusion, output, smooth, rig_check }
    }

    /// Counts so far.
    pub(super) fn counts(&self) -> &Counts {
        &self.front_end.counts
    }

    /// What the filter found that correct files would not show.
    pub(super) fn findings(&self) -> Vec<String> {
        self.rig_check.findings(&self.fusion.status())
    }

    /// Why the last image shows no marker, where none of the images does.
    pub(super) fn why_no_marker(&self) -> Option<String> {
        self.front_end.why_no_marker()
    }

    /// What the filter waits for; empty where there is an estimate.
    pub(super) fn missing(&self) -> String {
        self.fusion.missing()
    }

    /// The warning about an input of which the filter has not received a single usable message.
    pub(super) fn rejected_input(&self) -> Option<String> {
        let counts = self.counts();
        let warning = |kind: &str| counts.warnings.get(kind);
        let no_markers = counts.markers == 0;
        let unstamped = warning("filter NoStamp").map_or(0, |(count, _)| *count);
        let least = counts.markers.min(counts.imu).min(counts.climber);
        [
            ("camera_info", self.front_end.camera.is_none()),
            (topics::CLIMBER_TRANSFORM, counts.climber == 0),
            (topics::MARKERS, no_markers),
            ("image", no_markers),
            ("filter NoStamp", unstamped >= least),
        ]
        .into_iter()
        .find_map(|(kind, unusable)| warning(kind).filter(|_| unusable))
        .or_else(|| {
            // Every encoder reading was rejected: most of them for this reason.
            let of_encoders =
                counts.warnings.iter().filter(|(kind, _)| kind.starts_with("climber "));
            let most = of_encoders.map(|(_, warning)| warning).max_by_key(|(number, _)| *number);
            most.filter(|_| counts.climber == 0)
        })
        .or_else(|| {
            // Undecodable messages are counted by their topic.
            let undecodable = |kind: &str| kind.starts_with('/') && !kind.contains(' ');
            counts.warnings.iter().find(|(kind, _)| undecodable(kind)).map(|(_, warning)| warning)
        })
        .map(with_number)
    }

    /// Handles the next item of the bag.
    pub(super) fn handle(&mut self, fed: Fed) -> Result<(), BagError> {
        for sample in self.front_end.handle(fed) {
            match sample {
                Sample::Imu(sample) => self.imu(sample)?,
                Sample::Climber(sample) => self.climber(sample)?,
                Sample::Camera(camera) => {
                    self.rig_check.note_camera();
                    self.fuse(Sample::Camera(camera))?;
                }
                Sample::Markers(observations) => self.observations(observations)?,
            }
        }
        for error in std::mem::take(&mut self.front_end.rejected) {
            let sentence = || format!("{error}; such transforms are ignored");
            self.front_end.counts.warn(topics::CLIMBER_TRANSFORM, sentence);
        }
        Ok(())
    }

    fn imu(&mut self, sample: ImuSample) -> Result<(), BagError> {
        let counts = &mut self.front_end.counts;
        counts.imu += 1;
        let first = *counts.first_imu.get_or_insert(sample.stamp);
        counts.imu_settled += u64::from(sample.stamp.seconds_since(first) > 1.0);
        self.fuse(Sample::Imu(sample))
    }

    fn climber(&mut self, mut sample: ClimberSample) -> Result<(), BagError> {
        if self.front_end.climber.is_some() {
            // As a message, which rounds the rotation: live the filter receives no other.
            let message = convert::climber_message(&sample, &self.frames);
            match convert::climber_sample(&message, &self.frames) {
                Ok(received) => sample = received,
                Err(error) => {
                    self.front_end.rejected.push(error.to_string());
                    return Ok(());
                }
            }
        }
        self.front_end.counts.climber += 1;
        if !self.is_far_ahead(topics::CLIMBER_TRANSFORM, sample.stamp) {
            let message = convert::climber_message(&sample, &self.frames);
            self.output.put(topics::CLIMBER_TRANSFORM, sample.stamp, &message)?;
            self.output.transform(sample.stamp, message)?;
        }
        self.fuse(Sample::Climber(sample))
    }

    /// Closes the output.
    pub(super) fn finish(mut self) -> Result<Counts, BagError> {
        self.write_smoothed(true)?;
        let findings = self.findings();
        self.output.finish()?;
        Ok(Counts { findings, ..self.front_end.counts })
    }

    fn write_smoothed(&mut self, end: bool) -> Result<(), BagError> {
        if self.smooth {
            for odometry in self.fusion.smoothed(end) {
                self.front_end.counts.smoothed += 1;
                let message = messages::odometry(&odometry, &self.frames);
                self.output.put(topics::SMOOTHED_ODOMETRY, odometry.stamp, &message)?;
            }
        }
        Ok(())
    }

    fn observations(&mut self, observations: MarkerObservations) -> Result<(), BagError> {
        let detected =
            observations.markers.iter().filter(|(_, m)| m.state == MarkerState::Detected).count();
        self.front_end.counts.markers += 1;
        self.front_end.counts.detected += detected as u64;
        if !self.is_far_ahead(topics::MARKERS, observations.stamp) {
            let message = convert::markers_message(&self.frames.camera, &observations);
            self.output.put(topics::MARKERS, observations.stamp, &message)?;
        }
        self.fuse(Sample::Markers(observations))?;
        self.write_smoothed(false)
    }

    /// Whether a message is so far ahead of the filter that it is left out of the output, which is
    /// counted.
    fn is_far_ahead(&mut self, topic: &str, stamp: Stamp) -> bool {
        let counts = &mut self.front_end.counts;
        let newest = self.fusion.status().newest_imu.max(counts.last_odometry);
        let far = newest.filter(|newest| stamp.seconds_since(*newest) > FAR_AHEAD);
        if let Some(newest) = far {
            counts.warn(&format!("output {topic}"), || {
                format!(
                    "{topic}: the message at {stamp} is more than an hour ahead of the IMU samples \
                     and the odometry, which are at {newest}, and is left out of the output: check \
                     the clocks"
                )
            });
        }
        far.is_some()
    }

    fn fuse(&mut self, sample: Sample) -> Result<(), BagError> {
        self.fusion.handle(sample);
        while let Some(output) = self.fusion.poll() {
            self.output.fused(&output)?;
            let counts = &mut self.front_end.counts;
            match output {
                Output::Odometry(odometry) => counts.odometry_at(odometry.stamp),
                Output::VisualPose(_) => counts.visual += 1,
                Output::MarkerUpdates(image) => {
                    let used = image.markers.0.iter().filter(|m| m.outcome == Outcome::Used);
                    counts.used += used.count() as u64;
                    self.rig_check.note(&image);
                }
                Output::Warning(warning) => {
                    counts.warn(&kind_of("filter", &warning), || format!("filter: {warning}"));
                }
                Output::Status(_) | Output::Predicted(_) | Output::Swing(_) => {}
            }
        }
        Ok(())
    }
}

/// Name of a warning's variant.
pub(super) fn kind_of(who: &str, warning: &impl std::fmt::Debug) -> String {
    let text = format!("{warning:?}");
    let end = text.find(|c: char| !c.is_alphanumeric()).unwrap_or(text.len());
    format!("{who} {}", &text[..end])
}
