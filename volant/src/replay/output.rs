//! The bag that a replay writes: each message logged at its stamp, sorted by stamp.

use super::topic_names::TopicNames;
use bag::{BagError, BagSummary, BagWriter, Qos, Topic, TopicId, WriteOptions};
use pose_fusion::{Output, messages};
use rig_model::{Frames, Rig, Stamp, topics};
use std::{
    collections::{BTreeMap, HashMap},
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
    /// Messages with their topics, by time and then by their order.
    waiting: BTreeMap<(u64, u64), (TopicId, Vec<u8>)>,
    count: u64,
    newest: u64,
    patience: f64,
    /// Rig whose static transforms come with the first message.
    mountings: Option<Rig>,
}

impl OutputBag {
    /// Creates the bag. `smooth`: smoothed odometry will be written.
    pub(super) fn create(
        path: &Path,
        options: WriteOptions,
        names: &TopicNames,
        rig: &Rig,
        smooth: bool,
    ) -> Result<Self, BagError> {
        let mut output = Self {
            bag: BagWriter::create(path, options)?,
            frames: rig.frames.clone(),
            topics: HashMap::new(),
            waiting: BTreeMap::new(),
            count: 0,
            newest: 0,
            patience: if smooth { PATIENCE_SMOOTHED } else { PATIENCE },
            mountings: Some(rig.clone()),
        };
        let qos = &Qos::RELIABLE;
        output.add::<msg::MarkerObservations>(names, topics::MARKERS, qos);
        output.add::<TransformStamped>(names, topics::CLIMBER_TRANSFORM, qos);
        output.add::<Odometry>(names, topics::ODOMETRY, qos);
        output.add::<PoseWithCovarianceStamped>(names, topics::FUSED_POSE, qos);
        output.add::<PoseWithCovarianceStamped>(names, topics::POSE, qos);
        output.add::<msg::PoseStatus>(names, topics::STATUS, qos);
        output.add::<Odometry>(names, topics::PREDICTED_ODOMETRY, qos);
        output.add::<msg::Swing>(names, topics::SWING, qos);
        output.add::<PoseWithCovarianceStamped>(names, topics::VISUAL_POSE, qos);
        output.add::<msg::MarkerUpdates>(names, topics::MARKER_UPDATES, qos);
        output.add::<TFMessage>(names, topics::absolute::TF, qos);
        output.add::<TFMessage>(names, topics::absolute::TF_STATIC, &Qos::LATCHED);
        if smooth {
            output.add::<Odometry>(names, topics::SMOOTHED_ODOMETRY, qos);
        }
        Ok(output)
    }

    fn add<M: Message>(&mut self, names: &TopicNames, name: &'static str, qos: &Qos) {
        let id = self.bag.add_topic(Topic::of::<M>(&names.resolve(name), qos));
        self.topics.insert(name, id);
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
        // The input's log time may be years after its stamps: a bag that was played and recorded.
        if let Some(rig) = self.mountings.take() {
            let transforms = node_kit::convert::static_transforms(&rig, at);
            self.put(topics::absolute::TF_STATIC, at, &transforms)?;
        }
        let time = u64::try_from(at.as_nanos()).unwrap_or(0);
        let entry = (self.topics[topic], cdr::to_bytes(message));
        self.waiting.insert((time, self.count), entry);
        self.count += 1;
        if time > self.newest {
            self.newest = time;
            self.write_until(time.saturating_sub((self.patience * 1e9) as u64))?;
        }
        Ok(())
    }

    fn write_until(&mut self, until: u64) -> Result<(), BagError> {
        while let Some(first) = self.waiting.first_entry()
            && first.key().0 <= until
        {
            let ((time, _), (topic, data)) = first.remove_entry();
            self.bag.write(topic, time, time, &data)?;
        }
        Ok(())
    }
}
