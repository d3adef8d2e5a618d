//! Reads a bag into the samples of the batch estimators, refines a rig with them, and checks it.

use crate::replay::{Fed, Feed, ImageTopic, TopicNames};
use anyhow::{Context, Result, bail};
use bag::{BagReader, BagSummary};
use climber_driver::{Climber, ClimberConfig, JointReading};
use marker_tracker::{Input, Output, Tracker, TrackerConfig};
use node_kit::convert;
use rig_calibration::{Estimate, Recording, Report, Samples, Track, examine_stamps, refine_rig};
use rig_model::{CameraModel, MarkerColor, MarkerLayout, MarkerObservations, Rig, Stamp, topics};
use std::path::Path;
use volant_msgs::{
    Message, cdr, geometry_msgs, msg::MarkerObservations as MarkersMessage, sensor_msgs::msg,
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

/// Returns the topic of a bag's images.
fn images_of(bag: &BagSummary, names: &TopicNames) -> Result<Option<ImageTopic>> {
    let alternatives = [
        (topics::IMAGE, msg::Image::TYPE_NAME),
        (topics::COMPRESSED_IMAGE, msg::CompressedImage::TYPE_NAME),
    ];
    let found = names.choose(bag, &alternatives)?;
    let kinds = [ImageTopic::Raw, ImageTopic::Compressed];
    Ok(found.map(|(place, name)| kinds[place](name)))
}

/// Reads camera and markers of a bag; the markers are tracked again if it holds images.
///
/// # Errors
/// No `camera_info`, several topics of a type of which none has the rig's name, an undecodable
/// message, or an unreadable bag.
pub fn read_markers(
    path: &Path,
    rig: &Rig,
    cores: &Cores,
) -> Result<(CameraModel, Vec<MarkerObservations>)> {
    let samples = read(path, rig, cores, false)?;
    Ok((samples.camera, samples.markers))
}

/// Reads a bag; with `motion`, also what IMU and encoders measured.
fn read(path: &Path, rig: &Rig, cores: &Cores, motion: bool) -> Result<Samples> {
    let shown = path.display();
    let summary = BagReader::summary(path)?;
    let choose = |alternatives: &[_]| {
        cores.names.choose(&summary, alternatives).with_context(|| shown.to_string())
    };
    let images = images_of(&summary, &cores.names).with_context(|| shown.to_string())?;
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
    let mut tracker = Tracker::new(rig.markers.clone(), cores.tracker.clone());
    let (mut camera, mut markers) = (None, vec![]);
    let (mut imu, mut climber, mut rejected) = (vec![], vec![], vec![]);
    while let Some(fed) = feed.take()? {
        match fed {
            Fed::Image(Ok((stamp, image))) => tracker.handle(Input::Image(image.view(stamp))),
            Fed::Image(Err(_)) => {}
            Fed::Message(message) => {
                let what = || format!("{shown}: a message on {}", message.topic.name);
                let (kind, data) = (message.topic.type_name.as_str(), &message.data);
                if kind == msg::CameraInfo::TYPE_NAME {
                    let info = cdr::from_bytes(data).with_context(what)?;
                    let model = convert::camera_model(&info).with_context(what)?;
                    tracker.handle(Input::Camera(model.clone()));
                    camera = Some(model);
                } else if kind == MarkersMessage::TYPE_NAME {
                    let observed: MarkersMessage = cdr::from_bytes(data).with_context(what)?;
                    markers.push(convert::marker_observations(&observed).with_context(what)?);
                } else if kind == msg::Imu::TYPE_NAME {
                    imu.push(convert::imu_sample(&cdr::from_bytes(data).with_context(what)?));
                } else if kind == geometry_msgs::msg::TransformStamped::TYPE_NAME {
                    let transform = cdr::from_bytes(data).with_context(what)?;
                    match convert::climber_sample(&transform, &rig.frames) {
                        Ok(sample) => climber.push(sample),
                        Err(error) => rejected.push(error),
                    }
                } else if let Some(driver) = &mut driver
                    && kind == msg::JointState::TYPE_NAME
                {
                    let joints: msg::JointState = cdr::from_bytes(data).with_context(what)?;
                    let reading = JointReading {
                        stamp: convert::stamp(&joints.header.stamp),
                        names: joints.name,
                        positions: joints.position,
                    };
                    let logged = i64::try_from(message.log_time).unwrap_or(i64::MAX);
                    driver.handle(&reading, Stamp::from_nanos(logged));
                    climber.extend(std::iter::from_fn(|| driver.poll()).filter_map(|o| match o {
                        climber_driver::Output::Sample(sample) => Some(sample),
                        climber_driver::Output::Warning(_) => None,
                    }));
                }
            }
        }
        collect(&mut tracker, &mut markers);
    }
    if let Some(error) = rejected.first()
        && rejected.len() > climber.len()
    {
        let all = rejected.len() + climber.len();
        bail!("{shown}: {} of {all} climber transforms are rejected: {error}", rejected.len());
    }
    let camera = camera.with_context(|| {
        let topic = cores.names.resolve(topics::CAMERA_INFO);
        format!(
            "{shown}: no camera_info in it; record {topic} too, or name the rig's topics with \
             --namespace or --remap"
        )
    })?;
    Ok(Samples { camera, markers, imu, climber })
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
    let images = images_of(&BagReader::summary(path)?, names)?;
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

/// Checks a rig's files against a bag; `climber_offset`: see [`rig_calibration::check`].
///
/// # Errors
/// As [`read_markers`] and [`rig_calibration::check`].
pub fn check_bag(bag: &Path, rig: &Rig, cores: &Cores, climber_offset: f64) -> Result<Report> {
    let samples = read(bag, rig, cores, true)?;
    let has_images = images_of(&BagReader::summary(bag)?, &cores.names)?.is_some();
    let mut track = |layout: &MarkerLayout, camera: &CameraModel, limit| {
        track_bag(bag, layout, &cores.tracker, camera, limit, &cores.names).unwrap_or_default()
    };
    let track: Option<&mut Track<'_>> = if has_images { Some(&mut track) } else { None };
    rig_calibration::check(&samples, rig, climber_offset, track)
        .with_context(|| bag.display().to_string())
}

/// Refines a rig with a bag; `held`: see [`refine_rig`].
/// The tracker's measurements depend slightly on the marker positions, so the images are tracked
/// again with the refined positions until these converge. The rig file stays the prior of what the
/// motion does not determine.
///
/// # Errors
/// As [`read_markers`] and [`refine_rig`]; stamps with which nothing can be estimated.
pub fn refine_from_bag(bag: &Path, rig: &Rig, cores: &Cores, held: &[&str]) -> Result<Estimate> {
    let mut seen_with = rig.clone();
    let mut round = 1;
    loop {
        let samples = read(bag, &seen_with, cores, true)?;
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
