//! Reads a bag into the samples of the batch estimators, refines a rig with them, and checks it.

use crate::replay::{Counts, Fed, Feed, ImageTopic, TopicNames, decode, kind_of};
use anyhow::{Context, Result, bail};
use bag::{BagMessage, BagReader};
use climber_driver::{Climber, ClimberConfig, JointReading};
use marker_tracker::{Input, Output, Tracker, TrackerConfig};
use node_kit::convert;
use rig_calibration::{Estimate, Recording, Report, Samples, Track, examine_stamps, refine_rig};
use rig_model::{
    CameraModel, ClimberSample, ImuSample, MarkerColor, MarkerLayout, MarkerObservations, Rig,
    Stamp, topics,
};
use std::path::Path;
use volant_msgs::{
    Message, geometry_msgs, msg::MarkerObservations as MarkersMessage, sensor_msgs::msg,
};

/// The images are tracked again until the markers move by less than this, m: a tenth of the
/// accuracy of a good recording.
const SETTLED: f64 = 3e-5;
const ROUNDS: usize = 4;

fn workers() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Appends what the tracker has found.
fn collect(tracker: &mut Tracker, markers: &mut Vec<MarkerObservations>) {
    while let Some(output) = tracker.poll() {
        if let Output::Observations(observations) = output {
            markers.push(observations);
        }
    }
}

/// Configuration of the cores that a bag is read with, and the names of its topics.
#[derive(Clone, Debug)]
pub struct Cores {
    /// The tracker's.
    pub tracker: TrackerConfig,
    /// The climber driver's, for a bag with `climber/joint_states` and without
    /// `climber/transform`; or why there is none.
    pub climber: Result<ClimberConfig, String>,
    /// Names of the topics in the bag.
    pub names: TopicNames,
}

impl Cores {
    /// The defaults with a rig file.
    pub fn of(rig: &Rig) -> Self {
        let tracker = TrackerConfig { start_colors: rig.colors, ..TrackerConfig::default() };
        Self { tracker, climber: Ok(ClimberConfig::default()), names: TopicNames::default() }
    }
}

/// Reads camera and markers of a bag; the markers are tracked again if it holds images. What the
/// bag lost, and why inputs are unusable, is appended to `losses`, also before an error.
///
/// # Errors
/// No usable `camera_info`, several topics of a type of which none has the rig's name, or an
/// unreadable bag.
pub fn read_markers(
    path: &Path,
    rig: &Rig,
    cores: &Cores,
    losses: &mut Vec<String>,
) -> Result<(CameraModel, Vec<MarkerObservations>)> {
    let samples = read(path, rig, cores, false, losses)?;
    Ok((samples.camera, samples.markers))
}

/// Reads a bag; with `motion`, also what IMU and encoders measured. `losses`: see [`read_markers`].
fn read(
    path: &Path,
    rig: &Rig,
    cores: &Cores,
    motion: bool,
    losses: &mut Vec<String>,
) -> Result<Samples> {
    let shown = path.display();
    let summary = BagReader::summary(path)?;
    let choose = |alternatives: &[_]| {
        cores.names.choose(&summary, alternatives).with_context(|| shown.to_string())
    };
    let images = ImageTopic::of(&summary, &cores.names).with_context(|| shown.to_string())?;
    let has_images = images.is_some();
    let mut wanted = vec![choose(&[(topics::CAMERA_INFO, msg::CameraInfo::TYPE_NAME)])?];
    if !has_images {
        wanted.push(choose(&[(topics::MARKERS, MarkersMessage::TYPE_NAME)])?);
    }
    let mut driver = None;
    if motion {
        let climber = choose(&[
            (topics::CLIMBER_TRANSFORM, geometry_msgs::msg::TransformStamped::TYPE_NAME),
            (topics::JOINT_STATES, msg::JointState::TYPE_NAME),
        ])?;
        driver = match &cores.climber {
            _ if !matches!(climber, Some((1, _))) => None,
            Ok(config) => Some(Climber::new(config.clone()).with_context(|| shown.to_string())?),
            Err(reason) => {
                bail!("{shown}: climber/joint_states is converted by climber_driver: {reason}")
            }
        };
        wanted.extend([choose(&[(topics::IMU, msg::Imu::TYPE_NAME)])?, climber]);
    }
    let wanted = wanted.into_iter().flatten().map(|(_, name)| name).collect();
    let mut feed = Feed::start(path, images, wanted, workers())?;
    let mut reading = Reading {
        rig,
        tracker: Tracker::new(rig.markers.clone(), cores.tracker.clone()),
        driver,
        camera: None,
        markers: vec![],
        imu: vec![],
        climber: vec![],
        rejected: vec![],
        counts: Counts::default(),
    };
    while let Some(fed) = feed.take()? {
        reading.take(fed);
    }
    let Reading { camera, markers, imu, climber, rejected, counts, .. } = reading;
    losses.extend(feed.losses());
    losses.extend(counts.warning_lines());
    if let Some(error) = rejected.first() {
        let (number, all) = (rejected.len(), rejected.len() + climber.len());
        let text = format!("{shown}: {number} of {all} climber transforms are rejected: {error}");
        if number > climber.len() {
            bail!(text);
        }
        losses.push(text);
    }
    let camera = camera.with_context(|| {
        let topic = cores.names.resolve(topics::CAMERA_INFO);
        format!(
            "{shown}: no usable camera_info in it; record {topic} too, or name the rig's topics \
             with --namespace or --remap"
        )
    })?;
    Ok(Samples { camera, markers, imu, climber })
}

/// The samples of a bag, as far as it is read.
struct Reading<'a> {
    rig: &'a Rig,
    tracker: Tracker,
    driver: Option<Climber>,
    camera: Option<CameraModel>,
    markers: Vec<MarkerObservations>,
    imu: Vec<ImuSample>,
    climber: Vec<ClimberSample>,
    /// Why climber transforms were rejected.
    rejected: Vec<String>,
    /// Warnings about the other inputs.
    counts: Counts,
}

impl Reading<'_> {
    fn take(&mut self, fed: Fed) {
        match fed {
            Fed::Image(Ok((stamp, image))) => self.tracker.handle(Input::Image(image.view(stamp))),
            Fed::Image(Err(reason)) => {
                self.counts.warn("image", || format!("an image is ignored: {reason}"));
            }
            Fed::Message(message) => self.message(&message),
        }
        while let Some(output) = self.tracker.poll() {
            match output {
                Output::Observations(observations) => self.markers.push(observations),
                Output::Warning(warning) => {
                    let kind = kind_of("tracker", &warning);
                    self.counts.warn(&kind, || format!("tracker: {warning}"));
                }
            }
        }
    }

    fn message(&mut self, message: &BagMessage) {
        let kind = message.topic.type_name.as_str();
        if kind == msg::CameraInfo::TYPE_NAME {
            let Some(info) = decode(message, &mut self.counts) else { return };
            match convert::camera_model(&info) {
                Ok(model) => {
                    self.tracker.handle(Input::Camera(model.clone()));
                    self.camera = Some(model);
                }
                Err(error) => self.counts.warn("camera_info", || error.to_string()),
            }
        } else if kind == MarkersMessage::TYPE_NAME {
            let Some(observed) = decode(message, &mut self.counts) else { return };
            match convert::marker_observations(&observed) {
                Ok(observations) => self.markers.push(observations),
                Err(error) => self
                    .counts
                    .warn(topics::MARKERS, || format!("{error}; such messages are ignored")),
            }
        } else if kind == msg::Imu::TYPE_NAME {
            self.imu.extend(decode(message, &mut self.counts).map(|m| convert::imu_sample(&m)));
        } else if kind == geometry_msgs::msg::TransformStamped::TYPE_NAME {
            let Some(transform) = decode(message, &mut self.counts) else { return };
            match convert::climber_sample(&transform, &self.rig.frames) {
                Ok(sample) => self.climber.push(sample),
                Err(error) => self.rejected.push(error.to_string()),
            }
        } else if let Some(driver) = &mut self.driver
            && kind == msg::JointState::TYPE_NAME
        {
            let Some(joints) = decode::<msg::JointState>(message, &mut self.counts) else { return };
            let reading = JointReading {
                stamp: convert::stamp(&joints.header.stamp),
                names: joints.name,
                positions: joints.position,
            };
            let logged = i64::try_from(message.log_time).unwrap_or(i64::MAX);
            driver.handle(&reading, Stamp::from_nanos(logged));
            while let Some(output) = driver.poll() {
                match output {
                    climber_driver::Output::Sample(sample) => self.climber.push(sample),
                    climber_driver::Output::Warning(warning) => {
                        let kind = format!("climber {}", warning.kind());
                        self.counts.warn(&kind, || format!("climber: {warning}"));
                    }
                }
            }
        }
    }
}

/// Tracks the markers in the images of a bag, or in its first `limit` images.
///
/// # Errors
/// An unreadable bag, or several topics with images of which none has the rig's name.
pub fn track_bag(
    path: &Path,
    layout: &MarkerLayout,
    config: &TrackerConfig,
    camera: &CameraModel,
    limit: Option<usize>,
    names: &TopicNames,
) -> Result<Vec<MarkerObservations>> {
    let images = ImageTopic::of(&BagReader::summary(path)?, names)?;
    let mut feed = Feed::start(path, images, vec![], workers())?;
    let mut tracker = Tracker::new(layout.clone(), config.clone());
    tracker.handle(Input::Camera(camera.clone()));
    let mut markers = vec![];
    while let Some(fed) = feed.take()? {
        if let Fed::Image(Ok((stamp, image))) = fed {
            tracker.handle(Input::Image(image.view(stamp)));
            collect(&mut tracker, &mut markers);
        }
        if limit.is_some_and(|limit| markers.len() >= limit) {
            break;
        }
    }
    Ok(markers)
}

/// Checks a rig's files against a bag; `climber_offset`: see [`rig_calibration::check`], `losses`:
/// see [`read_markers`].
///
/// # Errors
/// As [`read_markers`] and [`rig_calibration::check`].
pub fn check_bag(
    bag: &Path,
    rig: &Rig,
    cores: &Cores,
    climber_offset: f64,
    losses: &mut Vec<String>,
) -> Result<Report> {
    let samples = read(bag, rig, cores, true, losses)?;
    let has_images = ImageTopic::of(&BagReader::summary(bag)?, &cores.names)?.is_some();
    let mut track = |layout: &MarkerLayout, camera: &CameraModel, limit| {
        track_bag(bag, layout, &cores.tracker, camera, limit, &cores.names).unwrap_or_default()
    };
    let track: Option<&mut Track<'_>> = if has_images { Some(&mut track) } else { None };
    rig_calibration::check(&samples, rig, climber_offset, track)
        .with_context(|| bag.display().to_string())
}

/// Refines a rig with a bag; `held`: see [`refine_rig`], `losses`: see [`read_markers`].
/// The tracker's measurements depend slightly on the marker positions, so the images are tracked
/// again with the refined positions until these converge. The rig file stays the prior of what the
/// motion does not determine.
///
/// # Errors
/// As [`read_markers`] and [`refine_rig`]; stamps with which nothing can be estimated.
pub fn refine_from_bag(
    bag: &Path,
    rig: &Rig,
    cores: &Cores,
    held: &[&str],
    losses: &mut Vec<String>,
) -> Result<Estimate> {
    let mut seen_with = rig.clone();
    let mut round = 1;
    let known = losses.len();
    loop {
        // The same in each round.
        losses.truncate(known);
        let samples = read(bag, &seen_with, cores, true, losses)?;
        if let Some(finding) = examine_stamps(&samples).iter().find(|f| f.blocks) {
            bail!("{}: {}; {}", bag.display(), finding.text, finding.remedy);
        }
        let estimate = Recording::new(&samples)
            .and_then(|recording| refine_rig(&recording, rig, held))
            .with_context(|| format!("{}", bag.display()))?;
        let centers = [&estimate.rig, &seen_with].map(|r| &r.markers.centers);
        let moved = MarkerColor::ALL
            .map(|c| (centers[0][c] - centers[1][c]).norm())
            .into_iter()
            .fold(0.0, f64::max);
        if moved < SETTLED || round == ROUNDS {
            return Ok(estimate);
        }
        seen_with.markers = estimate.rig.markers.clone();
        round += 1;
    }
}
