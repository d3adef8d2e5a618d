//! A run as a bag: data of the simulated hardware, messages of the nodes, and the truth, in order
//! of receipt.

use super::{
    hardware::LEAD,
    received::{Received, TopicLog},
    scenario::Scenario,
};
use bag::{BagError, BagWriter, Compression, Qos, Topic, WriteOptions};
use nalgebra::Matrix6;
use node_kit::convert;
use rig_model::{ClimberSample, Sample, Stamp, topics::absolute as topics};
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

    fn put<M: Message>(&mut self, name: &str, qos: &Qos, log: &TopicLog<M>) {
        let topic = self.bag.add_topic(Topic::of::<M>(name, qos));
        let kept = log.iter().filter(|(at, _)| *at >= self.begin);
        self.entries.extend(
            kept.map(|(at, m)| (at.as_nanos().unsigned_abs(), topic, cdr::to_bytes(m.as_ref()))),
        );
    }

    fn put_truth(&mut self, scenario: &Scenario, epoch: Stamp, lead: f64) {
        let count = ((scenario.duration() + lead) * TRUTH_RATE) as usize;
        let (frames, none) = (&scenario.rig.frames, Matrix6::zeros());
        let (world, volant) = (&frames.world, &frames.volant);
        let truth = |i: usize| {
            let t = i as f64 / TRUTH_RATE - lead;
            let (stamp, k) = (epoch.plus_seconds(t), scenario.motion.kinematics(t));
            let (pose, rate) = (&k.world_from_volant, &k.angular_velocity);
            let velocity = pose.rotation.inverse() * k.velocity;
            let message = convert::odometry_message(
                world, volant, stamp, pose, &none, &velocity, rate, &none,
            );
            (stamp, Arc::new(message))
        };
        let poses: TopicLog<_> = (0..=count).map(truth).collect();
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
    received: &Received,
) -> Result<(), BagError> {
    let begin = epoch.plus_seconds(-LEAD);
    let options = WriteOptions { compression: Compression::None, ..WriteOptions::default() };
    let mut run = Run::create(path, options, begin)?;
    run.put(topics::COMPRESSED_IMAGE, SENSOR, &received.images);
    run.put(topics::CAMERA_INFO, SENSOR, &received.camera_info);
    run.put(topics::JOINT_STATES, RELIABLE, &received.joints);
    run.put(topics::IMU, SENSOR, &received.imu);
    run.put(topics::CLIMBER_TRANSFORM, RELIABLE, &received.climber);
    run.put(topics::MARKERS, RELIABLE, &received.markers);
    run.put(topics::ODOMETRY, RELIABLE, &received.odometry);
    run.put(topics::POSE, RELIABLE, &received.pose);
    run.put(topics::STATUS, RELIABLE, &received.status);
    run.put(topics::FUSED_POSE, RELIABLE, &received.fused_pose);
    run.put(topics::VISUAL_POSE, RELIABLE, &received.visual_pose);
    run.put(topics::MARKER_UPDATES, RELIABLE, &received.marker_updates);
    run.put(topics::TF, RELIABLE, &received.tf);
    run.put(topics::DIAGNOSTICS, RELIABLE, &received.diagnostics);
    // Latched: received before the run, belonging into it.
    let fixed: Vec<_> =
        received.tf_static.iter().map(|(at, m)| ((*at).max(begin), Arc::clone(m))).collect();
    run.put(topics::TF_STATIC, &Qos::LATCHED, &fixed);
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
    for (at, sample) in scenario.simulated_sensors().record() {
        match sample {
            Sample::Imu(s) => {
                imu.push((at, Arc::new(convert::imu_message(&frames.imu, &s, None, None))));
            }
            Sample::Markers(o) => {
                markers.push((at, Arc::new(convert::markers_message(&frames.camera, &o))));
            }
            // Received when it was read: its driver is beside it.
            Sample::Climber(s) => poses.push((s.stamp, Arc::new(climber(&s)))),
            Sample::Camera(_) => {}
        }
    }
    let info = convert::camera_message(&frames.camera, epoch, &scenario.camera);
    run.put(topics::CAMERA_INFO, SENSOR, &vec![(epoch, Arc::new(info))]);
    run.put(topics::IMU, SENSOR, &imu);
    run.put(topic, RELIABLE, &poses);
    run.put(topics::MARKERS, RELIABLE, &markers);
    run.put_truth(scenario, epoch, 0.0);
    run.finish()
}
