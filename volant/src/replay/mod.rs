//! Replay of a bag through the nodes' cores: deterministic, and as fast as possible. A bag and the
//! rig file are read, and a bag with what the nodes would have published is written, each message
//! logged at its stamp. One thread reads, some decode images (`feed`), and this thread drives the
//! cores in the bag's order (`pipeline`): the result does not depend on the threads.

mod feed;
mod output;
mod pipeline;
mod topic_names;

pub use feed::{Fed, Feed, ImageTopic};
pub use pipeline::Counts;
pub(crate) use pipeline::{decode, kind_of};
pub use topic_names::{Remap, TopicNames};

use crate::stopwatch::Stopwatch;
use anyhow::{anyhow, bail};
use bag::{BagError, BagMessage, BagReader, BagSummary, Compression, WriteOptions};
use climber_driver::{Climber, ClimberConfig};
use marker_tracker::{Tracker, TrackerConfig};
use output::OutputBag;
use pipeline::Pipeline;
use pose_fusion::{Fusion, FusionConfig};
use rig_model::{Rig, Stamp, topics};
use std::{
    path::{Path, PathBuf},
    time::Duration,
};
use volant_msgs::{Message, geometry_msgs, msg, sensor_msgs, tf2_msgs};

/// Options of a replay.
#[derive(Clone, Debug)]
pub struct ReplayOptions {
    /// Bag to replay.
    pub input: PathBuf,
    /// Rig.
    pub rig: Rig,
    /// Bag to write.
    pub output: PathBuf,
    /// Whether an existing file is replaced; never the input.
    pub overwrite: bool,
    /// Configuration of the tracker.
    pub tracker: TrackerConfig,
    /// Configuration of the climber driver, for a bag with `climber/joint_states` and without
    /// `climber/transform`; or why there is none.
    pub climber: Result<ClimberConfig, String>,
    /// Configuration of the filter, with its model.
    pub fusion: FusionConfig,
    /// Namespace and remaps.
    pub names: TopicNames,
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
    let (input, output) = (&options.input, &options.output);
    node_kit::files::check_output(output, options.overwrite, &[input])?;
    let summary = BagReader::summary(input)?;
    let plan = Plan::new(input, &summary, &options.names)?;
    let climber = if plan.has_transforms {
        None
    } else {
        let config = options.climber.clone();
        let climber = config.and_then(|c| Climber::new(c).map_err(|e| e.to_string()));
        let failed = |reason: String| {
            let (path, topic) = (input.display(), &plan.climber);
            anyhow!("{path}: {topic} is converted by climber_driver: {reason}")
        };
        Some(climber.map_err(failed)?)
    };
    let (start, end) = summary.span.unwrap_or_default();
    let first = Stamp::from_nanos(i64::try_from(start).unwrap_or(0));
    let write = WriteOptions {
        compression: options.compression,
        replace: options.overwrite,
        ..WriteOptions::default()
    };
    let out =
        OutputBag::create(output, write, &options.names, &options.rig, first, options.smooth)?;
    let tracker = Tracker::new(options.rig.markers.clone(), options.tracker.clone());
    let mut fusion = Fusion::new(options.rig.clone(), options.fusion.clone());
    if options.smooth {
        fusion.keep_for_smoothing();
    }
    let mut pipeline = Pipeline::new(options.rig.clone(), tracker, fusion, out, options.smooth);
    pipeline.climber = climber;
    let mut feed = Feed::start(input, plan.images.clone(), plan.wanted(), options.workers)?;
    while let Some(fed) = feed.take()? {
        match fed {
            Fed::Message(message) => plan.hand_over(&message, &mut pipeline)?,
            Fed::Image(Ok((stamp, image))) => pipeline.image(stamp, &image)?,
            Fed::Image(Err(reason)) => pipeline.bad_image(&reason),
        }
        progress(feed.bytes_read());
    }
    let losses = feed.losses();
    if pipeline.counts.odometry == 0 {
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
    let (counts, missing) = (&pipeline.counts, pipeline.missing());
    if let Some((count, sentence)) = pipeline.rejected_input() {
        let times = if *count > 1 { format!(" ({count} times)") } else { String::new() };
        return format!("{sentence}{times}");
    }
    let cause = losses.first().cloned().or_else(|| pipeline.findings().into_iter().next());
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

/// Names of the bag's topics.
struct Plan {
    images: Option<ImageTopic>,
    markers: Option<String>,
    imu: String,
    /// Transforms, or the encoder readings where there are none.
    climber: String,
    has_transforms: bool,
    camera: String,
    tf_static: String,
}

impl Plan {
    fn new(path: &Path, bag: &BagSummary, names: &TopicNames) -> anyhow::Result<Self> {
        let need = |wanted: &[_]| first_of(path, bag, names, wanted);
        let (kind, observed) = need(&[
            (topics::IMAGE, sensor_msgs::msg::Image::TYPE_NAME),
            (topics::COMPRESSED_IMAGE, sensor_msgs::msg::CompressedImage::TYPE_NAME),
            (topics::MARKERS, msg::MarkerObservations::TYPE_NAME),
        ])?;
        let (images, markers) = match kind {
            0 => (Some(ImageTopic::Raw(observed)), None),
            1 => (Some(ImageTopic::Compressed(observed)), None),
            _ => (None, Some(observed)),
        };
        let (_, imu) = need(&[(topics::IMU, sensor_msgs::msg::Imu::TYPE_NAME)])?;
        let (kind, climber) = need(&[
            (topics::CLIMBER_TRANSFORM, geometry_msgs::msg::TransformStamped::TYPE_NAME),
            (topics::JOINT_STATES, sensor_msgs::msg::JointState::TYPE_NAME),
        ])?;
        let has_transforms = kind == 0;
        let (_, camera) = need(&[(topics::CAMERA_INFO, sensor_msgs::msg::CameraInfo::TYPE_NAME)])?;
        let tf_static = names.resolve(topics::absolute::TF_STATIC);
        Ok(Self { images, markers, imu, climber, has_transforms, camera, tf_static })
    }

    fn wanted(&self) -> Vec<String> {
        let always = [&self.imu, &self.climber, &self.camera, &self.tf_static];
        always.into_iter().chain(&self.markers).cloned().collect()
    }

    fn hand_over(&self, message: &BagMessage, to: &mut Pipeline) -> Result<(), BagError> {
        fn read<M: Message>(message: &BagMessage, to: &mut Pipeline) -> Option<M> {
            decode(message, &mut to.counts)
        }
        let topic = &message.topic.name;
        if *topic == self.imu {
            read(message, to).map_or(Ok(()), |m| to.imu(&m))
        } else if *topic == self.climber && self.has_transforms {
            read(message, to).map_or(Ok(()), |m| to.climber(&m))
        } else if *topic == self.climber {
            let at = Stamp::from_nanos(i64::try_from(message.log_time).unwrap_or(0));
            read(message, to).map_or(Ok(()), |m| to.joints(m, at))
        } else if *topic == self.camera {
            read(message, to).map_or(Ok(()), |m| to.camera(&m))
        } else if Some(topic) == self.markers.as_ref() {
            read(message, to).map_or(Ok(()), |m| to.markers(&m))
        } else if *topic == self.tf_static {
            if let Some(m) = read::<tf2_msgs::msg::TFMessage>(message, to) {
                to.tf_static(&m);
            }
            Ok(())
        } else {
            Ok(())
        }
    }
}
