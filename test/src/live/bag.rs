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
use rig_model::{ClimberSample, Stamp, topics};
use rig_simulator::inertial::{Message as Sensed, Sensors};
use std::path::Path;
use volant_msgs::{
    Message, cdr, geometry_msgs::msg::TransformStamped, sensor_msgs::msg::JointState,
};

/// Poses of the truth per second.
const TRUTH_RATE: f64 = 200.0;

/// Writes the run, from half a second before `epoch` (the scenario's zero) on, as a rosbag2 folder.
///
/// # Errors
/// The file exists or is not writable.
pub fn write(
    path: &Path,
    scenario: &Scenario,
    epoch: Stamp,
    sent: &Sent,
    received: &Received,
) -> Result<(), BagError> {
    let begin = epoch.plus_seconds(-LEAD);
    let options = WriteOptions { compression: Compression::None, ..WriteOptions::default() };
    let mut bag = BagWriter::create(path, options)?;
    let mut entries = Vec::new();
    let e = &mut entries;
    put(&mut bag, e, topics::absolute::COMPRESSED_IMAGE, &Qos::SENSOR, &sent.images);
    put(&mut bag, e, topics::absolute::CAMERA_INFO, &Qos::SENSOR, &sent.camera_info);
    put(&mut bag, e, topics::absolute::JOINT_STATES, &Qos::RELIABLE, &sent.joints);
    write_received(&mut bag, e, topics::absolute::IMU, &Qos::SENSOR, begin, &received.imu);
    write_received(
        &mut bag,
        e,
        topics::absolute::CLIMBER_TRANSFORM,
        &Qos::RELIABLE,
        begin,
        &received.climber,
    );
    write_received(
        &mut bag,
        e,
        topics::absolute::MARKERS,
        &Qos::RELIABLE,
        begin,
        &received.markers,
    );
    write_received(
        &mut bag,
        e,
        topics::absolute::ODOMETRY,
        &Qos::RELIABLE,
        begin,
        &received.odometry,
    );
    write_received(
        &mut bag,
        e,
        topics::absolute::FUSED_POSE,
        &Qos::RELIABLE,
        begin,
        &received.fused_pose,
    );
    write_received(
        &mut bag,
        e,
        topics::absolute::VISUAL_POSE,
        &Qos::RELIABLE,
        begin,
        &received.visual_pose,
    );
    write_received(
        &mut bag,
        e,
        topics::absolute::MARKER_UPDATES,
        &Qos::RELIABLE,
        begin,
        &received.marker_updates,
    );
    write_received(&mut bag, e, topics::absolute::TF, &Qos::RELIABLE, begin, &received.tf);
    write_received(
        &mut bag,
        e,
        topics::absolute::DIAGNOSTICS,
        &Qos::RELIABLE,
        begin,
        &received.diagnostics,
    );
    // Latched: received before the run, belonging into it.
    let fixed: Vec<_> =
        received.tf_static.iter().map(|(at, m)| ((*at).max(begin), m.as_ref().clone())).collect();
    put(&mut bag, e, topics::absolute::TF_STATIC, &Qos::LATCHED, &fixed);
    let poses: Vec<_> = (0..=((scenario.duration() + LEAD) * TRUTH_RATE) as usize)
        .map(|i| {
            let t = i as f64 / TRUTH_RATE - LEAD;
            let stamp = epoch.plus_seconds(t);
            (stamp, truth(scenario, t, stamp))
        })
        .collect();
    put(&mut bag, e, topics::absolute::GROUND_TRUTH, &Qos::RELIABLE, &poses);
    entries.sort_by_key(|(time, ..)| *time);
    for (time, topic, data) in &entries {
        bag.write(*topic, *time, *time, data)?;
    }
    bag.finish()?;
    Ok(())
}

/// Writes what ideal sensors record of a scenario, without nodes: markers, IMU samples, the truth,
/// and the climber as the messages that `climber` makes of it, on the topic of their type.
///
/// # Errors
/// The file exists or is not writable.
pub fn from_sensors<M: ClimberMessage>(
    path: &Path,
    scenario: &Scenario,
    mut climber: impl FnMut(&ClimberSample) -> M,
) -> Result<(), BagError> {
    let mut bag = BagWriter::create(path, WriteOptions::default())?;
    let frames = &scenario.rig.frames;
    let mut entries = Vec::new();
    let (mut imu, mut markers, mut poses, mut truths) = (vec![], vec![], vec![], vec![]);
    let sensors =
        Sensors::new(&scenario.motion, &scenario.rig, &scenario.camera, &scenario.sensors);
    for (at, message) in sensors.record() {
        match message {
            Sensed::Imu(s) => imu.push((at, convert::imu_message(&frames.imu, &s, None, None))),
            Sensed::Markers(o) => markers.push((at, convert::markers_message(&frames.camera, &o))),
            // Received when it was read: its driver is beside it.
            Sensed::Climber(s) => poses.push((s.stamp, climber(&s))),
        }
    }
    let epoch = scenario.sensors.epoch;
    let info = convert::camera_message(&frames.camera, epoch, &scenario.camera);
    for i in 0..=(scenario.duration() * TRUTH_RATE) as usize {
        let t = i as f64 / TRUTH_RATE;
        truths.push((epoch.plus_seconds(t), truth(scenario, t, epoch.plus_seconds(t))));
    }
    let e = &mut entries;
    put(&mut bag, e, topics::absolute::CAMERA_INFO, &Qos::SENSOR, &[(epoch, info)]);
    put(&mut bag, e, topics::absolute::IMU, &Qos::SENSOR, &imu);
    put(&mut bag, e, M::TOPIC, &Qos::RELIABLE, &poses);
    put(&mut bag, e, topics::absolute::MARKERS, &Qos::RELIABLE, &markers);
    put(&mut bag, e, topics::absolute::GROUND_TRUTH, &Qos::RELIABLE, &truths);
    entries.sort_by_key(|(time, ..)| *time);
    for (time, topic, data) in &entries {
        bag.write(*topic, *time, *time, data)?;
    }
    bag.finish()?;
    Ok(())
}

/// Message with the climber's pose.
pub trait ClimberMessage: Message {
    /// Its topic.
    const TOPIC: &'static str;
}

impl ClimberMessage for JointState {
    const TOPIC: &'static str = topics::absolute::JOINT_STATES;
}

impl ClimberMessage for TransformStamped {
    const TOPIC: &'static str = topics::absolute::CLIMBER_TRANSFORM;
}

type Entry = (u64, bag::TopicId, Vec<u8>);

fn put<M: Message>(
    bag: &mut BagWriter,
    entries: &mut Vec<Entry>,
    name: &str,
    qos: &Qos,
    messages: &[(Stamp, M)],
) {
    let topic = bag.add_topic(Topic::of::<M>(name, qos));
    entries.extend(
        messages.iter().map(|(at, m)| (at.as_nanos().unsigned_abs(), topic, cdr::to_bytes(m))),
    );
}

fn write_received<M: Message>(
    bag: &mut BagWriter,
    entries: &mut Vec<Entry>,
    name: &str,
    qos: &Qos,
    from: Stamp,
    messages: &TopicLog<M>,
) {
    let topic = bag.add_topic(Topic::of::<M>(name, qos));
    let kept = messages.iter().filter(|(at, _)| *at >= from);
    entries.extend(
        kept.map(|(at, m)| (at.as_nanos().unsigned_abs(), topic, cdr::to_bytes(m.as_ref()))),
    );
}
