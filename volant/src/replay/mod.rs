//! Replay of a bag through the nodes' cores: deterministic, and as fast as possible. A bag and the
//! rig file are read, and a bag with what the nodes would have published is written, each message
//! logged at its stamp. One thread reads, some decode images (`feed`), and this thread drives the
//! cores in the bag's order (`front_end`, `pipeline`): the result does not depend on the threads.

mod feed;
mod front_end;
mod output;
mod pipeline;
mod topic_names;

pub use feed::{Fed, Feed, ImageTopic, decoding_threads};
pub(crate) use front_end::{FrontEnd, Roles};
pub use pipeline::Counts;
pub(crate) use topic_names::empty;
pub use topic_names::{Remap, TopicNames, summarize};

use crate::stopwatch::Stopwatch;
use anyhow::{anyhow, bail};
use bag::{BagReader, BagSummary, BagWriter, Compression, WriteOptions};
use climber_driver::{Climber, ClimberConfig};
use marker_tracker::TrackerConfig;
use output::OutputBag;
use pipeline::Pipeline;
use pose_fusion::{Fusion, FusionConfig};
use rig_model::{Rig, topics};
use std::{
    path::{Path, PathBuf},
    time::Duration,
};
use volant_msgs::{Message, geometry_msgs, msg, sensor_msgs};

/// Rig and configuration of the cores that a bag is read with, and the names of its topics.
#[derive(Clone, Debug)]
pub struct Cores {
    /// Rig.
    pub rig: Rig,
    /// Configuration of the tracker.
    pub tracker: TrackerConfig,
    /// Configuration of the climber driver, for a bag with `climber/joint_states` and without
    /// `climber/transform`; or why there is none.
    pub climber: Result<ClimberConfig, String>,
    /// Configuration of the filter, with its model.
    pub fusion: FusionConfig,
    /// Namespace and remaps.
    pub names: TopicNames,
}

impl Cores {
    /// The defaults with a rig file.
    pub fn of(rig: &Rig) -> Self {
        Self {
            rig: rig.clone(),
            tracker: TrackerConfig { start_colors: rig.colors, ..TrackerConfig::default() },
            climber: Ok(ClimberConfig::default()),
            fusion: FusionConfig::default(),
            names: TopicNames::default(),
        }
    }
}

/// Options of a replay.
#[derive(Clone, Debug)]
pub struct ReplayOptions {
    /// Bag to replay.
    pub input: PathBuf,
    /// Bag to write.
    pub output: PathBuf,
    /// Whether an existing file is replaced; never the input.
    pub overwrite: bool,
    /// The cores.
    pub cores: Cores,
    /// Compression of the bag to write.
    pub compression: Compression,
    /// Threads that decode images.
    pub workers: usize,
    /// Whether to add `volant/smoothed_odometry`, estimates from all measurements of the bag.
    pub smooth: bool,
}

/// Result of a replay.
#[derive(Clone, Debug)]
pub struct ReplayReport {
    /// Counts of inputs and outputs.
    pub counts: Counts,
    /// Wall-clock time.
    pub wall: Duration,
    /// Duration of the bag, s.
    pub recorded: f64,
    /// Losses in the bag, one sentence each.
    pub losses: Vec<String>,
}

/// Replays a bag. `progress` is called with the bytes read, of [`BagSummary::bytes`].
///
/// # Errors
/// A bag is not readable or writable; a required topic has no message or another type; the bag
/// needs the climber driver, which would not start; the filter never initialized. A damaged bag is
/// not an error: its losses are in the report.
pub fn replay(
    options: &ReplayOptions,
    mut progress: impl FnMut(u64),
) -> anyhow::Result<ReplayReport> {
    let watch = Stopwatch::start();
    let ReplayOptions { input, output, cores, .. } = options;
    let Cores { rig, names, .. } = cores;
    BagWriter::check(output, options.overwrite, &[input])?;
    let summary = BagReader::summary(input)?;
    let roles = roles(input, &summary, names)?;
    let climber = roles.joints.as_ref().map(|topic| {
        let climber = cores.climber.clone().and_then(Climber::new);
        let path = input.display();
        climber.map_err(|e| anyhow!("{path}: {topic} is converted by climber_driver: {e}"))
    });
    let climber = climber.transpose()?;
    let (start, end) = summary.span.unwrap_or_default();
    let write = WriteOptions {
        compression: options.compression,
        replace: options.overwrite,
        ..WriteOptions::default()
    };
    let out = OutputBag::create(output, write, names, rig, options.smooth)?;
    let mut fusion = Fusion::new(rig.clone(), cores.fusion.clone());
    if options.smooth {
        fusion.keep_for_smoothing();
    }
    let mut feed = Feed::start(input, roles.images.clone(), roles.messages(), options.workers)?;
    let front_end = FrontEnd::new(rig, roles, &cores.tracker, climber);
    let mut pipeline = Pipeline::new(rig.frames.clone(), front_end, fusion, out, options.smooth);
    while let Some(fed) = feed.take()? {
        pipeline.handle(fed)?;
        progress(feed.bytes_read());
    }
    let losses = feed.losses().to_vec();
    if pipeline.counts().odometry == 0 {
        let why = why_silent(&pipeline, &losses);
        bail!("{}: the filter never started: {why}", input.display());
    }
    Ok(ReplayReport {
        counts: pipeline.finish()?,
        wall: watch.elapsed(),
        recorded: (end.saturating_sub(start)) as f64 * 1e-9,
        losses,
    })
}

fn why_silent(pipeline: &Pipeline, losses: &[String]) -> String {
    let (counts, missing) = (pipeline.counts(), pipeline.missing());
    if let Some(warning) = pipeline.rejected_input() {
        return warning;
    }
    let cause = losses.first().cloned().or_else(|| pipeline.findings().into_iter().next());
    let cause = cause.or_else(|| pipeline.why_no_marker());
    if let Some(cause) = cause {
        return format!("{missing}; {cause}");
    }
    format!(
        "{missing}; {} markers measured in {} images, {} IMU samples, {} climber transforms; \
         check the camera's view, the markers in the rig file and the stamps",
        counts.detected, counts.markers, counts.imu, counts.climber
    )
}

/// Returns the first of some topics, given by relative name and type, that has messages, with its
/// place among them.
///
/// # Errors
/// None has a message, or the first that has is of another type.
fn first_of(
    path: &Path,
    bag: &BagSummary,
    names: &TopicNames,
    wanted: &[(&'static str, &'static str)],
) -> anyhow::Result<(usize, String)> {
    let shown = path.display();
    for (place, (name, type_name)) in wanted.iter().enumerate() {
        let topic = names.resolve(name);
        let Some((found, _)) = bag.topics.iter().find(|(t, count)| t.name == topic && *count > 0)
        else {
            continue;
        };
        if found.type_name.is_empty() || found.type_name == *type_name {
            return Ok((place, topic));
        }
        let found = &found.type_name;
        bail!(
            "{shown}: {topic} is {found}, expected {type_name}; name the right topic with --remap"
        );
    }
    let (topics, remedy) = (names.list(wanted), names.remedy(bag, wanted));
    bail!("{shown}: no message on {topics}; {remedy}")
}

/// Chooses the topics that a replay reads.
///
/// # Errors
/// A required topic has no message, or another type.
fn roles(path: &Path, bag: &BagSummary, names: &TopicNames) -> anyhow::Result<Roles> {
    let need = |wanted: &[_]| first_of(path, bag, names, wanted);
    let mut roles = Roles::default();
    let (kind, observed) = need(&[
        (topics::IMAGE, sensor_msgs::msg::Image::TYPE_NAME),
        (topics::COMPRESSED_IMAGE, sensor_msgs::msg::CompressedImage::TYPE_NAME),
        (topics::MARKERS, msg::MarkerObservations::TYPE_NAME),
    ])?;
    match kind {
        0 => roles.images = Some(ImageTopic::Raw(observed)),
        1 => roles.images = Some(ImageTopic::Compressed(observed)),
        _ => roles.markers = Some(observed),
    }
    roles.imu = Some(need(&[(topics::IMU, sensor_msgs::msg::Imu::TYPE_NAME)])?.1);
    let (kind, climber) = need(&[
        (topics::CLIMBER_TRANSFORM, geometry_msgs::msg::TransformStamped::TYPE_NAME),
        (topics::JOINT_STATES, sensor_msgs::msg::JointState::TYPE_NAME),
    ])?;
    match kind {
        0 => roles.transforms = Some(climber),
        _ => roles.joints = Some(climber),
    }
    let camera_info = (topics::CAMERA_INFO, sensor_msgs::msg::CameraInfo::TYPE_NAME);
    roles.camera = Some(need(&[camera_info])?.1);
    roles.tf_static = Some(names.resolve(topics::absolute::TF_STATIC));
    Ok(roles)
}
