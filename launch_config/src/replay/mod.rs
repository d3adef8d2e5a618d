//! A recorded run through the nodes' own code: deterministic, and as fast as it can.
//!
//! In flow a bag and the rig file, out flows a bag with what the nodes would have said, each message logged at its
//! stamp. One thread reads, some decode images ([`feed`]), and this thread drives the cores in the bag's order
//! ([`pipeline`]), so the result does not depend on the threads.

mod feed;
mod output;
mod pipeline;
mod topics;

pub use feed::{Fed, Feed, ImageTopic};
pub use pipeline::{Counts, Spent};
pub use topics::{TopicNameError, TopicNames};

use crate::{
    bag::{BagError, BagMessage, BagReader, BagSummary, Compression, WriteOptions},
    stopwatch::Stopwatch,
};
use marker_tracker::{Tracker, TrackerConfig};
use output::OutputBag;
use pipeline::Pipeline;
use pose_fusion::{Fusion, FusionConfig};
use rig_model::{Rig, Stamp};
use std::{
    path::{Path, PathBuf},
    time::Duration,
};
use thiserror::Error;
use volant_msgs::{Message, cdr, geometry_msgs, msg, sensor_msgs, tf2_msgs};

/// What is replayed, and how.
#[derive(Clone, Debug)]
pub struct ReplayOptions {
    /// The bag.
    pub input: PathBuf,
    /// The rig.
    pub rig: Rig,
    /// The bag to write.
    pub output: PathBuf,
    /// How the tracker is set.
    pub tracker: TrackerConfig,
    /// How the filter is set, the model included.
    pub fusion: FusionConfig,
    /// Namespace and remaps.
    pub names: TopicNames,
    /// Of the bag to write.
    pub compression: Compression,
    /// Threads that decode images.
    pub workers: usize,
    /// Adds `volant/smoothed_odometry`: every estimate with the knowledge of what came after it.
    pub smooth: bool,
}

/// What a replay did.
#[derive(Clone, Debug)]
pub struct ReplayReport {
    /// What went through.
    pub counts: Counts,
    /// Work (of one core) in the cores and the output.
    pub spent: Spent,
    /// Work in image decoding, over all its threads.
    pub decoding: Duration,
    /// From start to end.
    pub wall: Duration,
    /// The bag's duration, s.
    pub recorded: f64,
    /// What the bag lost, one sentence each.
    pub losses: Vec<String>,
}

/// Why a replay failed.
#[derive(Debug, Error)]
pub enum ReplayError {
    /// A bag cannot be read or written.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The output would replace the input.
    #[error("{}: the output is the input; give --out another name", path.display())]
    SameFile {
        /// Which.
        path: PathBuf,
    },
    /// A topic that is needed has no message.
    #[error("{}: no message on {topic} ({type_name}){hint}; record it, or name it with --remap {name}:=OTHER", path.display())]
    MissingTopic {
        /// The bag.
        path: PathBuf,
        /// The topic as it was looked for.
        topic: String,
        /// Its name in the contract.
        name: &'static str,
        /// Its type.
        type_name: &'static str,
        /// A topic of that type that is there.
        hint: String,
    },
    /// A topic is there with another type.
    #[error("{}: {topic} is {found}, expected {expected}; name the right topic with --remap", path.display())]
    WrongType {
        /// The bag.
        path: PathBuf,
        /// The topic.
        topic: String,
        /// Its type.
        found: String,
        /// The type it should have.
        expected: String,
    },
    /// The filter never spoke.
    #[error("{}: the filter never started: {why}", path.display())]
    NoEstimate {
        /// The bag.
        path: PathBuf,
        /// What was seen, and what to check.
        why: String,
    },
}

/// Replays a bag. `progress` is told the bytes read and all bytes.
///
/// # Errors
/// See [`ReplayError`]; a bag that is cut off or damaged is no error, its losses are in the report.
pub fn replay(
    options: &ReplayOptions,
    mut progress: impl FnMut(u64, u64),
) -> Result<ReplayReport, ReplayError> {
    let watch = Stopwatch::start();
    let (input, output) = (&options.input, &options.output);
    let same = |a: &Path, b: &Path| matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b);
    if same(input, output) {
        return Err(ReplayError::SameFile { path: output.clone() });
    }
    let summary = BagReader::summary(input)?;
    let plan = Plan::new(input, &summary, &options.names)?;
    let (start, end) = summary.span.unwrap_or_default();
    let first = Stamp::from_nanos(i64::try_from(start).unwrap_or(0));
    let write = WriteOptions { compression: options.compression, replace: true, ..WriteOptions::default() };
    let out = OutputBag::create(output, write, &options.names, &options.rig, first, options.smooth)?;
    let tracker = Tracker::new(options.rig.markers.clone(), options.tracker.clone());
    let mut fusion = Fusion::new(options.rig.clone(), options.fusion.clone());
    if options.smooth {
        fusion.keep_for_smoothing();
    }
    let mut pipeline = Pipeline::new(options.rig.clone(), tracker, fusion, out, options.smooth);
    let mut feed = Feed::start(input, plan.images.clone(), plan.wanted(), options.workers)?;
    while let Some(fed) = feed.take()? {
        match fed {
            Fed::Message(message) => plan.hand_over(&message, &mut pipeline)?,
            Fed::Image(Ok((stamp, image))) => {
                pipeline.image(stamp, &image)?;
                progress(feed.bytes_read(), summary.bytes);
            }
            Fed::Image(Err(reason)) => pipeline.bad_image(&reason),
        }
    }
    let (decoding, losses) = (feed.decode_time(), feed.losses());
    let (counts, spent) = pipeline.finish()?;
    if counts.odometry == 0 {
        return Err(ReplayError::NoEstimate { path: input.clone(), why: why_silent(&counts, &losses) });
    }
    Ok(ReplayReport {
        counts,
        spent,
        decoding,
        wall: watch.elapsed(),
        recorded: (end.saturating_sub(start)) as f64 * 1e-9,
        losses,
    })
}

fn why_silent(counts: &Counts, losses: &[String]) -> String {
    let said: Vec<&str> =
        counts.said.values().map(|(_, s)| s.as_str()).chain(losses.iter().map(String::as_str)).collect();
    let heard = if said.is_empty() { String::new() } else { format!("; {}", said.join("; ")) };
    format!(
        "{} markers measured in {} images, {} inertial samples, {} climber transforms{heard}; check the camera's view, \
         the markers in the rig file and the stamps",
        counts.detected, counts.markers, counts.imu, counts.climber
    )
}

/// Which topic of the bag is what.
struct Plan {
    images: Option<ImageTopic>,
    markers: Option<String>,
    imu: String,
    climber: String,
    camera: String,
    tf_static: String,
}

impl Plan {
    fn new(path: &Path, bag: &BagSummary, names: &TopicNames) -> Result<Self, ReplayError> {
        let find = |name: &'static str, type_name: &'static str| -> Result<Option<String>, ReplayError> {
            let topic = names.resolve(name);
            let Some((found, _)) = bag.topics.iter().find(|(t, count)| t.name == topic && *count > 0) else {
                return Ok(None);
            };
            if found.type_name != type_name && !found.type_name.is_empty() {
                return Err(ReplayError::WrongType {
                    path: path.to_owned(),
                    topic,
                    found: found.type_name.clone(),
                    expected: type_name.to_owned(),
                });
            }
            Ok(Some(topic))
        };
        let missing = |name: &'static str, type_name: &'static str| {
            let others: Vec<&str> = bag
                .topics
                .iter()
                .filter(|(t, count)| t.type_name == type_name && *count > 0)
                .map(|(t, _)| t.name.as_str())
                .collect();
            let hint =
                if others.is_empty() { String::new() } else { format!("; there is {}", others.join(", ")) };
            ReplayError::MissingTopic {
                path: path.to_owned(),
                topic: names.resolve(name),
                name,
                type_name,
                hint,
            }
        };
        let need = |name: &'static str, type_name: &'static str| {
            find(name, type_name)?.ok_or_else(|| missing(name, type_name))
        };
        let raw = find("climber/camera/image_raw", sensor_msgs::msg::Image::TYPE_NAME)?.map(ImageTopic::Raw);
        let images = match raw {
            Some(raw) => Some(raw),
            None => {
                find("climber/camera/image_raw/compressed", sensor_msgs::msg::CompressedImage::TYPE_NAME)?
                    .map(ImageTopic::Compressed)
            }
        };
        let markers = match &images {
            Some(_) => None,
            None => match find("climber/markers", msg::MarkerObservations::TYPE_NAME)? {
                Some(markers) => Some(markers),
                None => {
                    return Err(missing(
                        "climber/camera/image_raw/compressed",
                        sensor_msgs::msg::CompressedImage::TYPE_NAME,
                    ));
                }
            },
        };
        Ok(Self {
            images,
            markers,
            imu: need("volant/imu/data", sensor_msgs::msg::Imu::TYPE_NAME)?,
            climber: need("climber/transform", geometry_msgs::msg::TransformStamped::TYPE_NAME)?,
            camera: need("climber/camera/camera_info", sensor_msgs::msg::CameraInfo::TYPE_NAME)?,
            tf_static: names.resolve("/tf_static"),
        })
    }

    fn wanted(&self) -> Vec<String> {
        let always = [&self.imu, &self.climber, &self.camera, &self.tf_static];
        always.into_iter().chain(&self.markers).cloned().collect()
    }

    fn hand_over(&self, message: &BagMessage, to: &mut Pipeline) -> Result<(), BagError> {
        fn read<M: Message>(message: &BagMessage, to: &mut Pipeline) -> Option<M> {
            cdr::from_bytes(&message.data)
                .map_err(|error| {
                    let topic = &message.topic.name;
                    to.counts.say(topic, || format!("{topic}: a message is left out: {error}"));
                })
                .ok()
        }
        let topic = &message.topic.name;
        if *topic == self.imu {
            read(message, to).map_or(Ok(()), |m| to.imu(&m))
        } else if *topic == self.climber {
            read(message, to).map_or(Ok(()), |m| to.climber(&m))
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
