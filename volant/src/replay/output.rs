//! The bag that a replay writes: each message logged at its stamp, sorted by stamp.

use super::topic_names::TopicNames;
use bag::{BagError, BagSummary, BagWriter, Qos, Topic, TopicId, WriteOptions};
use pose_fusion::{Output, messages};
use rig_model::{Frames, Rig, Stamp, topics};
use std::{
    cmp::Reverse,
    collections::{BinaryHeap, HashMap},
    path::Path,
};
use volant_msgs::{
    Message, cdr,
    geometry_msgs::msg::{PoseWithCovarianceStamped, TransformStamped},
    msg,
    nav_msgs::msg::Odometry,
    tf2_msgs::msg::TFMessage,
};

/// Longest delay of an output after its stamp, s; outputs wait here to be sorted.
const PATIENCE: f64 = 2.0;
/// The same for smoothed odometry, s: a minute is smoothed at a time, with twenty more seconds of
/// measurements.
const PATIENCE_SMOOTHED: f64 = 90.0;

/// Writer of the outputs.
#[derive(Debug)]
pub(super) struct OutputBag {
    bag: BagWriter,
    frames: Frames,
    /// By their names before remapping.
    topics: HashMap<&'static str, TopicId>,
    waiting: BinaryHeap<Reverse<(u64, u64, Entry)>>,
    count: u64,
    newest: u64,
    patience: f64,
}

/// Topics of a bag that is being created.
struct Adding<'a> {
    bag: &'a mut BagWriter,
    names: &'a TopicNames,
    topics: HashMap<&'static str, TopicId>,
}

impl Adding<'_> {
    fn add<M: Message>(&mut self, name: &'static str, qos: &Qos) {
        let id = self.bag.add_topic(Topic::of::<M>(&self.names.resolve(name), qos));
        self.topics.insert(name, id);
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
    pub(super) fn create(
        path: &Path,
        options: WriteOptions,
        names: &TopicNames,
        rig: &Rig,
        first: Stamp,
        smooth: bool,
    ) -> Result<Self, BagError> {
        let mut bag = BagWriter::create(path, options)?;
        let mut adding = Adding { bag: &mut bag, names, topics: HashMap::new() };
        let qos = &Qos::RELIABLE;
        adding.add::<msg::MarkerObservations>(topics::MARKERS, qos);
        adding.add::<TransformStamped>(topics::CLIMBER_TRANSFORM, qos);
        adding.add::<Odometry>(topics::ODOMETRY, qos);
        adding.add::<PoseWithCovarianceStamped>(topics::FUSED_POSE, qos);
        adding.add::<PoseWithCovarianceStamped>(topics::POSE, qos);
        adding.add::<msg::PoseStatus>(topics::STATUS, qos);
        adding.add::<Odometry>(topics::PREDICTED_ODOMETRY, qos);
        adding.add::<msg::Swing>(topics::SWING, qos);
        adding.add::<PoseWithCovarianceStamped>(topics::VISUAL_POSE, qos);
        adding.add::<msg::MarkerUpdates>(topics::MARKER_UPDATES, qos);
        adding.add::<TFMessage>(topics::absolute::TF, qos);
        adding.add::<TFMessage>(topics::absolute::TF_STATIC, &Qos::LATCHED);
        if smooth {
            adding.add::<Odometry>(topics::SMOOTHED_ODOMETRY, qos);
        }
        let topics = adding.topics;
        let mut output = Self {
            bag,
            frames: rig.frames.clone(),
            topics,
            waiting: BinaryHeap::new(),
            count: 0,
            newest: 0,
            patience: if smooth { PATIENCE_SMOOTHED } else { PATIENCE },
        };
        let transforms = node_kit::convert::static_transforms(rig, first);
        output.put(topics::absolute::TF_STATIC, first, &transforms)?;
        Ok(output)
    }

    /// Writes an output of the filter, except for warnings.
    pub(super) fn fused(&mut self, output: &Output) -> Result<(), BagError> {
        match output {
            Output::Odometry(o) => {
                self.put(topics::ODOMETRY, o.stamp, &messages::odometry(o, &self.frames))?;
                self.put(topics::FUSED_POSE, o.stamp, &messages::fused_pose(o, &self.frames))?;
                self.put(topics::POSE, o.stamp, &messages::pose(o, &self.frames))?;
                self.transform(o.stamp, messages::transform(o, &self.frames))
            }
            Output::Status(s) => {
                self.put(topics::STATUS, s.stamp, &messages::status(s, &self.frames))
            }
            Output::Predicted(o) => {
                self.put(topics::PREDICTED_ODOMETRY, o.stamp, &messages::odometry(o, &self.frames))
            }
            Output::Swing(s) => self.put(topics::SWING, s.stamp, &messages::swing(s, &self.frames)),
            Output::VisualPose(p) => {
                self.put(topics::VISUAL_POSE, p.stamp, &messages::visual_pose(p, &self.frames))
            }
            Output::MarkerUpdates(u) => {
                let message = messages::marker_updates(u, &self.frames);
                self.put(topics::MARKER_UPDATES, u.stamp, &message)
            }
            Output::Warning(_) => Ok(()),
        }
    }

    /// Writes a transform to `/tf`.
    pub(super) fn transform(&mut self, at: Stamp, to: TransformStamped) -> Result<(), BagError> {
        self.put(topics::absolute::TF, at, &TFMessage { transforms: vec![to] })
    }

    /// Closes the bag.
    pub(super) fn finish(mut self) -> Result<BagSummary, BagError> {
        self.write_until(u64::MAX)?;
        self.bag.finish()
    }

    /// Writes a message to a topic that [`Self::create`] added, by its name before remapping.
    pub(super) fn put<M: Message>(
        &mut self,
        topic: &'static str,
        at: Stamp,
        message: &M,
    ) -> Result<(), BagError> {
        let time = u64::try_from(at.as_nanos()).unwrap_or(0);
        let entry = Entry { topic: self.topics[topic], data: cdr::to_bytes(message) };
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
