//! The nodes' cores connected in sequence, fed in the order in which the bag logged the messages.

use super::output::OutputBag;
use bag::{BagError, BagMessage};
use climber_driver::{Climber, JointReading};
use marker_tracker::{OwnedImage, Tracker};
use node_kit::convert;
use pose_fusion::{Fusion, Outcome, Output, RigCheck, messages};
use rig_model::{CameraModel, MarkerObservations, MarkerState, Rig, Stamp, topics};
use std::collections::BTreeMap;
use volant_msgs::{
    Message, cdr, geometry_msgs::msg::TransformStamped, msg, sensor_msgs::msg as sensor,
    tf2_msgs::msg::TFMessage,
};

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
    /// Stamps of the first IMU sample and of the odometries.
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
        self.warnings.values().map(|(count, sentence)| {
            let times = if *count > 1 { format!(" ({count} times)") } else { String::new() };
            format!("{sentence}{times}")
        })
    }
}

/// A stamp further ahead of the IMU's, s, is wrong, since no IMU is out for as long; the filter
/// rejects it. In the output it would be the end of the bag's time.
const FAR_AHEAD: f64 = 3600.0;

/// The cores and the output.
#[derive(Debug)]
pub(super) struct Pipeline {
    rig: Rig,
    tracker: Tracker,
    fusion: Fusion,
    camera: Option<CameraModel>,
    output: OutputBag,
    smooth: bool,
    /// The climber driver, where the bag holds its input and not its output.
    pub(super) climber: Option<Climber>,
    rig_check: RigCheck,
    /// Stamp of the last IMU sample.
    last_imu: Option<Stamp>,
    /// Counts so far.
    pub(super) counts: Counts,
}

impl Pipeline {
    /// Creates the cores from their configuration.
    pub(super) fn new(
        rig: Rig,
        tracker: Tracker,
        fusion: Fusion,
        output: OutputBag,
        smooth: bool,
    ) -> Self {
        Self {
            rig,
            tracker,
            fusion,
            camera: None,
            output,
            smooth,
            climber: None,
            rig_check: RigCheck::default(),
            last_imu: None,
            counts: Counts::default(),
        }
    }

    /// What the filter found that correct files would not show.
    pub(super) fn findings(&self) -> Vec<String> {
        self.rig_check.findings(&self.fusion.status())
    }

    /// What the filter waits for; empty where there is an estimate.
    pub(super) fn missing(&self) -> String {
        self.fusion.missing()
    }

    /// The warning about an input of which the filter has not received a single usable message: how
    /// often, and the first one.
    pub(super) fn rejected_input(&self) -> Option<&(u64, String)> {
        let counts = &self.counts;
        let warning = |kind: &str| counts.warnings.get(kind);
        let no_markers = counts.markers == 0;
        let unstamped = warning("filter NoStamp").map_or(0, |(count, _)| *count);
        let least = counts.markers.min(counts.imu).min(counts.climber);
        [
            ("camera_info", self.camera.is_none()),
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
    }

    /// Handles an IMU sample.
    pub(super) fn imu(&mut self, message: &sensor::Imu) -> Result<(), BagError> {
        let sample = convert::imu_sample(message);
        self.last_imu = Some(sample.stamp);
        self.counts.imu += 1;
        let first = *self.counts.first_imu.get_or_insert(sample.stamp);
        self.counts.imu_settled += u64::from(sample.stamp.seconds_since(first) > 1.0);
        self.fuse(pose_fusion::Input::Imu(sample))
    }

    /// Handles a climber transform.
    pub(super) fn climber(&mut self, message: &TransformStamped) -> Result<(), BagError> {
        match convert::climber_sample(message, &self.rig.frames) {
            Ok(sample) => {
                self.counts.climber += 1;
                if !self.is_far_ahead(sample.stamp) {
                    let message = convert::climber_message(&sample, &self.rig.frames);
                    self.output.put(topics::CLIMBER_TRANSFORM, sample.stamp, &message)?;
                    self.output.transform(sample.stamp, message)?;
                }
                self.fuse(pose_fusion::Input::Climber(sample))
            }
            Err(error) => {
                self.counts.warn(topics::CLIMBER_TRANSFORM, || {
                    format!("{error}; such transforms are ignored")
                });
                Ok(())
            }
        }
    }

    /// Handles the climber's encoder readings as its driver does; `received` is when the bag logged
    /// them.
    pub(super) fn joints(
        &mut self,
        message: sensor::JointState,
        received: Stamp,
    ) -> Result<(), BagError> {
        let Some(climber) = &mut self.climber else { return Ok(()) };
        let reading = JointReading {
            stamp: convert::stamp(&message.header.stamp),
            names: message.name,
            positions: message.position,
        };
        climber.handle(&reading, received);
        let outputs: Vec<_> = std::iter::from_fn(|| climber.poll()).collect();
        outputs.into_iter().try_for_each(|output| match output {
            // As a message, which rounds the rotation: live the filter receives no other.
            climber_driver::Output::Sample(sample) => {
                self.climber(&convert::climber_message(&sample, &self.rig.frames))
            }
            climber_driver::Output::Warning(warning) => {
                let kind = format!("climber {}", warning.kind());
                self.counts.warn(&kind, || format!("climber: {warning}"));
                Ok(())
            }
        })
    }

    /// Handles a camera info.
    pub(super) fn camera(&mut self, message: &sensor::CameraInfo) -> Result<(), BagError> {
        match convert::camera_model(message) {
            Ok(model) if self.camera.as_ref() == Some(&model) => Ok(()),
            Ok(model) => {
                self.camera = Some(model.clone());
                self.rig_check.note_camera();
                self.tracker.handle(marker_tracker::Input::Camera(model.clone()));
                self.fuse(pose_fusion::Input::Camera(model))
            }
            Err(error) => {
                self.counts.warn("camera_info", || error.to_string());
                Ok(())
            }
        }
    }

    /// Handles an image.
    pub(super) fn image(&mut self, stamp: Stamp, image: &OwnedImage) -> Result<(), BagError> {
        self.tracker.handle(marker_tracker::Input::Image(image.view(stamp)));
        self.counts.images += 1;
        while let Some(output) = self.tracker.poll() {
            match output {
                marker_tracker::Output::Observations(observations) => {
                    self.observations(observations)?
                }
                marker_tracker::Output::Warning(warning) => {
                    self.counts
                        .warn(&kind_of("tracker", &warning), || format!("tracker: {warning}"));
                }
            }
        }
        Ok(())
    }

    /// Counts an unusable image.
    pub(super) fn bad_image(&mut self, reason: &str) {
        self.counts.warn("image", || format!("an image is ignored: {reason}"));
    }

    /// Handles marker observations of a live tracker.
    pub(super) fn markers(&mut self, message: &msg::MarkerObservations) -> Result<(), BagError> {
        match convert::marker_observations(message) {
            Ok(observations) => self.observations(observations),
            Err(error) => {
                self.counts.warn(topics::MARKERS, || format!("{error}; such messages are ignored"));
                Ok(())
            }
        }
    }

    /// Compares `/tf_static` with the rig file, which takes precedence, and warns of differences.
    pub(super) fn tf_static(&mut self, message: &TFMessage) {
        for ours in convert::static_transforms(&self.rig, Stamp::default()).transforms {
            let (parent, child) = (&ours.header.frame_id, &ours.child_frame_id);
            let theirs = message
                .transforms
                .iter()
                .find(|t| t.header.frame_id == *parent && t.child_frame_id == *child);
            let (Some(theirs), Ok(ours)) = (theirs, convert::isometry(&ours.transform, "rig"))
            else {
                continue;
            };
            let sentence = match convert::isometry(&theirs.transform, topics::absolute::TF_STATIC) {
                Err(error) => error.to_string(),
                Ok(theirs) => {
                    let meters = (theirs.translation.vector - ours.translation.vector).norm();
                    let degrees = theirs.rotation.angle_to(&ours.rotation).to_degrees();
                    // Rounding to eight digits in a file.
                    if meters <= 1e-4 && degrees <= 0.01 {
                        continue;
                    }
                    format!(
                        "/tf_static has {child} in {parent} {:.1} mm and {degrees:.2} deg from \
                         the rig file's; \
                         the rig file counts",
                        meters * 1e3
                    )
                }
            };
            self.counts.warn(&format!("/tf_static {parent} {child}"), || sentence);
        }
    }

    /// Closes the output.
    pub(super) fn finish(mut self) -> Result<Counts, BagError> {
        self.write_smoothed(true)?;
        self.counts.findings = self.findings();
        self.output.finish()?;
        Ok(self.counts)
    }

    fn write_smoothed(&mut self, end: bool) -> Result<(), BagError> {
        if self.smooth {
            for odometry in self.fusion.smoothed(end) {
                self.counts.smoothed += 1;
                let message = messages::odometry(&odometry, &self.rig.frames);
                self.output.put(topics::SMOOTHED_ODOMETRY, odometry.stamp, &message)?;
            }
        }
        Ok(())
    }

    fn observations(&mut self, observations: MarkerObservations) -> Result<(), BagError> {
        let detected =
            observations.markers.iter().filter(|(_, m)| m.state == MarkerState::Detected).count();
        self.counts.markers += 1;
        self.counts.detected += detected as u64;
        if !self.is_far_ahead(observations.stamp) {
            let message = convert::markers_message(&self.rig.frames.camera, &observations);
            self.output.put(topics::MARKERS, observations.stamp, &message)?;
        }
        self.fuse(pose_fusion::Input::Markers(observations))?;
        self.write_smoothed(false)
    }

    fn is_far_ahead(&self, stamp: Stamp) -> bool {
        self.last_imu.is_some_and(|imu| stamp.seconds_since(imu) > FAR_AHEAD)
    }

    fn fuse(&mut self, input: pose_fusion::Input) -> Result<(), BagError> {
        self.fusion.handle(input);
        while let Some(output) = self.fusion.poll() {
            self.output.fused(&output)?;
            match output {
                Output::Odometry(odometry) => self.count_odometry(odometry.stamp),
                Output::VisualPose(_) => self.counts.visual += 1,
                Output::MarkerUpdates(image) => {
                    let used = image.markers.0.iter().filter(|m| m.outcome == Outcome::Used);
                    self.counts.used += used.count() as u64;
                    self.rig_check.note(&image);
                }
                Output::Warning(warning) => {
                    self.counts.warn(&kind_of("filter", &warning), || format!("filter: {warning}"));
                }
                Output::Status(_) | Output::Predicted(_) | Output::Swing(_) => {}
            }
        }
        Ok(())
    }

    fn count_odometry(&mut self, at: Stamp) {
        let counts = &mut self.counts;
        counts.odometry += 1;
        let settled = counts.first_imu.is_some_and(|first| at.seconds_since(first) > 1.0);
        if settled {
            counts.odometry_settled += 1;
            if let Some(last) = counts.last_odometry {
                counts.longest_gap = counts.longest_gap.max(at.seconds_since(last));
            }
        }
        counts.last_odometry = Some(at);
    }
}

/// Decodes a message, or counts it with the warnings.
pub(crate) fn decode<M: Message>(message: &BagMessage, counts: &mut Counts) -> Option<M> {
    let topic = &message.topic.name;
    let warn = |error: cdr::CdrError| {
        counts.warn(topic, || format!("{topic}: a message is ignored: {error}"))
    };
    cdr::from_bytes(&message.data).map_err(warn).ok()
}

/// Name of a warning's variant.
pub(crate) fn kind_of(who: &str, warning: &impl std::fmt::Debug) -> String {
    let text = format!("{warning:?}");
    let end = text.find(|c: char| !c.is_alphanumeric()).unwrap_or(text.len());
    format!("{who} {}", &text[..end])
}
