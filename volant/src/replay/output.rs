//! The bag that a replay writes: each message logged at its stamp, sorted by stamp.

use super::topic_names::TopicNames;
use bag::{BagError, BagSummary, BagWriter, QosProfile, Topic, TopicId, WriteOptions};
use pose_fusion::{MarkerUpdateRecord, Odometry, PoseEstimate, PoseStatus, Swing, messages};
use rig_model::{ClimberSample, Frames, MarkerObservations, Rig, Stamp, topics};
use std::{cmp::Reverse, collections::BinaryHeap, path::Path};
use volant_msgs::{
    Message, cdr,
    geometry_msgs::{self, msg::PoseWithCovarianceStamped},
    msg, nav_msgs, tf2_msgs,
};

/// Longest delay of an output after its stamp, s; outputs wait here to be sorted.
const PATIENCE: f64 = 2.0;
/// The same for smoothed odometry, s: a minute is smoothed at a time, with twenty more seconds of
/// measurements.
const PATIENCE_SMOOTHED: f64 = 90.0;

/// Writer of the outputs.
#[derive(Debug)]
pub struct OutputBag {
    bag: BagWriter,
    frames: Frames,
    topics: Topics,
    waiting: BinaryHeap<Reverse<(u64, u64, Entry)>>,
    count: u64,
    newest: u64,
    patience: f64,
}

#[derive(Debug)]
struct Topics {
    markers: TopicId,
    transform: TopicId,
    odometry: TopicId,
    fused_pose: TopicId,
    pose: TopicId,
    status: TopicId,
    predicted: TopicId,
    swing: TopicId,
    visual_pose: TopicId,
    updates: TopicId,
    tf: TopicId,
    tf_static: TopicId,
    /// `None` unless smoothing was requested.
    smoothed: Option<TopicId>,
}

/// Adds topics under their remapped names.
struct Adding<'a> {
    bag: &'a mut BagWriter,
    names: &'a TopicNames,
}

impl Adding<'_> {
    fn topic<M: Message>(&mut self, name: &str) -> TopicId {
        self.bag.add_topic(Topic::of::<M>(&self.names.resolve(name), &QosProfile::RELIABLE))
    }

    fn latched<M: Message>(&mut self, name: &str) -> TopicId {
        self.bag.add_topic(Topic::of::<M>(&self.names.resolve(name), &QosProfile::LATCHED))
    }
}

#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Entry {
    topic: TopicId,
    data: Vec<u8>,
}

impl OutputBag {
    /// Creates the bag. `first` is the start of the run; `smooth`: smoothed odometry will be
    /// written.
    ///
    /// # Errors
    /// As [`BagWriter::create`].
    pub fn create(
        path: &Path,
        options: WriteOptions,
        names: &TopicNames,
        rig: &Rig,
        first: Stamp,
        smooth: bool,
    ) -> Result<Self, BagError> {
        let mut bag = BagWriter::create(path, options)?;
        let mut add = Adding { bag: &mut bag, names };
        let topics = Topics {
            markers: add.topic::<msg::MarkerObservations>(topics::MARKERS),
            transform: add.topic::<geometry_msgs::msg::TransformStamped>(topics::CLIMBER_TRANSFORM),
            odometry: add.topic::<nav_msgs::msg::Odometry>(topics::ODOMETRY),
            fused_pose: add.topic::<PoseWithCovarianceStamped>(topics::FUSED_POSE),
            pose: add.topic::<PoseWithCovarianceStamped>(topics::POSE),
            status: add.topic::<msg::PoseStatus>(topics::STATUS),
            predicted: add.topic::<nav_msgs::msg::Odometry>(topics::PREDICTED_ODOMETRY),
            swing: add.topic::<msg::Swing>(topics::SWING),
            visual_pose: add.topic::<PoseWithCovarianceStamped>(topics::VISUAL_POSE),
            updates: add.topic::<msg::MarkerUpdates>(topics::MARKER_UPDATES),
            tf: add.topic::<tf2_msgs::msg::TFMessage>(topics::absolute::TF),
            tf_static: add.latched::<tf2_msgs::msg::TFMessage>(topics::absolute::TF_STATIC),
            smoothed: smooth
                .then(|| add.topic::<nav_msgs::msg::Odometry>(topics::SMOOTHED_ODOMETRY)),
        };
        let patience = if smooth { PATIENCE_SMOOTHED } else { PATIENCE };
        let mut output = Self {
            bag,
            frames: rig.frames.clone(),
            topics,
            waiting: BinaryHeap::new(),
            count: 0,
            newest: 0,
            patience,
        };
        output.put(
            output.topics.tf_static,
            first,
            &node_kit::convert::static_transforms(rig, first),
        )?;
        Ok(output)
    }

    /// Writes `climber/markers`.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn markers(&mut self, observations: &MarkerObservations) -> Result<(), BagError> {
        let message = node_kit::convert::markers_message(&self.frames.camera, observations);
        self.put(self.topics.markers, observations.stamp, &message)
    }

    /// Writes `climber/transform` and its `/tf`.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn climber(&mut self, sample: &ClimberSample) -> Result<(), BagError> {
        let message = node_kit::convert::climber_message(sample, &self.frames);
        self.put(self.topics.transform, sample.stamp, &message)?;
        self.put(
            self.topics.tf,
            sample.stamp,
            &tf2_msgs::msg::TFMessage { transforms: vec![message] },
        )
    }

    /// Writes `volant/odometry`, `volant/fused_pose`, `volant/pose` and `/tf`.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn odometry(&mut self, o: &Odometry) -> Result<(), BagError> {
        self.put(self.topics.odometry, o.stamp, &messages::odometry(o, &self.frames))?;
        self.put(self.topics.fused_pose, o.stamp, &messages::fused_pose(o, &self.frames))?;
        self.put(self.topics.pose, o.stamp, &messages::pose(o, &self.frames))?;
        let transforms = vec![messages::transform(o, &self.frames)];
        self.put(self.topics.tf, o.stamp, &tf2_msgs::msg::TFMessage { transforms })
    }

    /// Writes `volant/status`.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn status(&mut self, status: &PoseStatus) -> Result<(), BagError> {
        self.put(self.topics.status, status.stamp, &messages::status(status, &self.frames))
    }

    /// Writes `volant/predicted_odometry`.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn predicted(&mut self, o: &Odometry) -> Result<(), BagError> {
        self.put(self.topics.predicted, o.stamp, &messages::odometry(o, &self.frames))
    }

    /// Writes `volant/swing`.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn swing(&mut self, swing: &Swing) -> Result<(), BagError> {
        self.put(self.topics.swing, swing.stamp, &messages::swing(swing, &self.frames))
    }

    /// Writes `volant/smoothed_odometry`.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn smoothed(&mut self, o: &Odometry) -> Result<(), BagError> {
        let Some(topic) = self.topics.smoothed else { return Ok(()) };
        let message = messages::odometry(o, &self.frames);
        self.put(topic, o.stamp, &message)
    }

    /// Writes `volant/visual_pose`.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn visual_pose(&mut self, pose: &PoseEstimate) -> Result<(), BagError> {
        self.put(self.topics.visual_pose, pose.stamp, &messages::visual_pose(pose, &self.frames))
    }

    /// Writes `volant/marker_updates`, the records of one image.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn marker_updates(&mut self, records: &[MarkerUpdateRecord]) -> Result<(), BagError> {
        let (Some(first), Some(message)) =
            (records.first(), messages::marker_updates(records, &self.frames))
        else {
            return Ok(());
        };
        self.put(self.topics.updates, first.stamp, &message)
    }

    /// Closes the bag.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn finish(mut self) -> Result<BagSummary, BagError> {
        self.write_until(u64::MAX)?;
        self.bag.finish()
    }

    fn put<M: Message>(&mut self, topic: TopicId, at: Stamp, message: &M) -> Result<(), BagError> {
        let time = u64::try_from(at.as_nanos()).unwrap_or(0);
        let entry = Entry { topic, data: cdr::to_bytes(message) };
        self.waiting.push(Reverse((time, self.count, entry)));
        self.count += 1;
        if time > self.newest {
            self.newest = time;
            self.write_until(time.saturating_sub((self.patience * 1e9) as u64))?;
        }
        Ok(())
    }

    fn write_until(&mut self, until: u64) -> Result<(), BagError> {
        while self.waiting.peek().is_some_and(|Reverse((time, _, _))| *time <= until) {
            if let Some(Reverse((time, _, entry))) = self.waiting.pop() {
                self.bag.write(entry.topic, time, time, &entry.data)?;
            }
        }
        Ok(())
    }
}
