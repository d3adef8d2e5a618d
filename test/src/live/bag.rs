//! A run as a bag: data of the simulated hardware, messages of the nodes, and the truth, in order
//! of receipt.

use super::{
    hardware::{LEAD, Sent},
    messages::truth,
    received::{Received, TopicLog},
    scenario::Scenario,
};
use bag::{BagError, BagWriter, Compression, Qos, Topic, WriteOptions};
use node_kit::convert;
use rig_model::{ClimberSample, Stamp, topics::absolute as topics};
use rig_simulator::inertial::Message as Sensed;
use std::{path::Path, sync::Arc};
use volant_msgs::{Message, cdr};

/// Poses of the truth per second.
const TRUTH_RATE: f64 = 200.0;
const SENSOR: &Qos = &Qos::SENSOR;
const RELIABLE: &Qos = &Qos::RELIABLE;

/// A bag whose messages are written in order of receipt at the end.
struct Run {
    bag: BagWriter,
    entries: Vec<(u64, bag::TopicId, Vec<u8>)>,
    /// Messages before it are left out.
    begin: Stamp,
}

impl Run {
    fn create(path: &Path, options: WriteOptions, begin: Stamp) -> Result<Self, BagError> {
        Ok(Self { bag: BagWriter::create(path, options)?, entries: Vec::new(), begin })
    }

    fn put_each<'m, M: Message + 'm>(
        &mut self,
        name: &str,
        qos: &Qos,
        messages: impl Iterator<Item = (Stamp, &'m M)>,
    ) {
        let topic = self.bag.add_topic(Topic::of::<M>(name, qos));
        let kept = messages.filter(|(at, _)| *at >= self.begin);
        self.entries
            .extend(kept.map(|(at, m)| (at.as_nanos().unsigned_abs(), topic, cdr::to_bytes(m))));
    }

    fn put<M: Message>(&mut self, name: &str, qos: &Qos, messages: &[(Stamp, M)]) {
        self.put_each(name, qos, messages.iter().map(|(at, m)| (*at, m)));
    }

    fn put_log<M: Message>(&mut self, name: &str, qos: &Qos, log: &TopicLog<M>) {
        self.put_each(name, qos, log.iter().map(|(at, m)| (*at, m.as_ref())));
    }

    fn put_truth(&mut self, scenario: &Scenario, epoch: Stamp, lead: f64) {
        let count = ((scenario.duration() + lead) * TRUTH_RATE) as usize;
        let times = (0..=count).map(|i| i as f64 / TRUTH_RATE - lead);
        let poses: Vec<_> = times
            .map(|t| (t, epoch.plus_seconds(t)))
            .map(|(t, stamp)| (stamp, truth(scenario, t, stamp)))
            .collect();
        self.put(topics::GROUND_TRUTH, RELIABLE, &poses);
    }

    fn finish(mut self) -> Result<(), BagError> {
        self.entries.sort_by_key(|(time, ..)| *time);
        for (time, topic, data) in &self.entries {
            self.bag.write(*topic, *time, *time, data)?;
        }
        self.bag.finish()?;
        Ok(())
    }
}

/// Writes the run, from half a second before `epoch` (the scenario's zero) on, as a rosbag2 folder.
pub fn write(
    path: &Path,
    scenario: &Scenario,
    epoch: Stamp,
    sent: &Sent,
    received: &Received,
) -> Result<(), BagError> {
    let begin = epoch.plus_seconds(-LEAD);
    let options = WriteOptions { compression: Compression::None, ..WriteOptions::default() };
    let mut run = Run::create(path, options, begin)?;
    run.put(topics::COMPRESSED_IMAGE, SENSOR, &sent.images);
    run.put(topics::CAMERA_INFO, SENSOR, &sent.camera_info);
    run.put(topics::JOINT_STATES, RELIABLE, &sent.joints);
    run.put_log(topics::IMU, SENSOR, &received.imu);
    run.put_log(topics::CLIMBER_TRANSFORM, RELIABLE, &received.climber);
    run.put_log(topics::MARKERS, RELIABLE, &received.markers);
    run.put_log(topics::ODOMETRY, RELIABLE, &received.odometry);
    run.put_log(topics::POSE, RELIABLE, &received.pose);
    run.put_log(topics::STATUS, RELIABLE, &received.status);
    run.put_log(topics::FUSED_POSE, RELIABLE, &received.fused_pose);
    run.put_log(topics::VISUAL_POSE, RELIABLE, &received.visual_pose);
    run.put_log(topics::MARKER_UPDATES, RELIABLE, &received.marker_updates);
    run.put_log(topics::TF, RELIABLE, &received.tf);
    run.put_log(topics::DIAGNOSTICS, RELIABLE, &received.diagnostics);
    // Latched: received before the run, belonging into it.
    let fixed: Vec<_> =
        received.tf_static.iter().map(|(at, m)| ((*at).max(begin), Arc::clone(m))).collect();
    run.put_log(topics::TF_STATIC, &Qos::LATCHED, &fixed);
    run.put_truth(scenario, epoch, LEAD);
    run.finish()
}

/// Writes what ideal sensors record of a scenario, without nodes: markers, IMU samples, the truth,
/// and the climber on `topic` as the messages that `climber` makes of it. An existing file is
/// replaced when the new one is complete.
pub fn from_sensors<M: Message>(
    path: &Path,
    scenario: &Scenario,
    topic: &str,
    mut climber: impl FnMut(&ClimberSample) -> M,
) -> Result<(), BagError> {
    let (frames, epoch) = (&scenario.rig.frames, scenario.sensors.epoch);
    let options = WriteOptions { replace: true, ..WriteOptions::default() };
    let mut run = Run::create(path, options, Stamp::default())?;
    let (mut imu, mut markers, mut poses) = (vec![], vec![], vec![]);
    for (at, message) in scenario.simulated_sensors().record() {
        match message {
            Sensed::Imu(s) => imu.push((at, convert::imu_message(&frames.imu, &s, None, None))),
            Sensed::Markers(o) => markers.push((at, convert::markers_message(&frames.camera, &o))),
            // Received when it was read: its driver is beside it.
            Sensed::Climber(s) => poses.push((s.stamp, climber(&s))),
        }
    }
    let info = convert::camera_message(&frames.camera, epoch, &scenario.camera);
    run.put(topics::CAMERA_INFO, SENSOR, &[(epoch, info)]);
    run.put(topics::IMU, SENSOR, &imu);
    run.put(topic, RELIABLE, &poses);
    run.put(topics::MARKERS, RELIABLE, &markers);
    run.put_truth(scenario, epoch, 0.0);
    run.finish()
}
