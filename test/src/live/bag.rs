//! The run as a bag: what the hardware said, what the nodes said, and the truth, in order of receipt.

use super::{
    heard::{Heard, Received},
    messages::truth,
    scenario::Scenario,
    stand::{LEAD, Said},
};
use launch_config::bag::{BagError, BagWriter, Compression, QosProfile, Topic, WriteOptions};
use rig_model::Stamp;
use std::path::Path;
use volant_msgs::{Message, cdr};

/// Poses of the truth per second.
const TRUTH_RATE: f64 = 200.0;

/// Writes the run, from half a second before `epoch` (the scenario's zero) on, as a rosbag2 folder.
///
/// # Errors
/// A place that cannot be written to or is taken.
pub fn write(
    path: &Path,
    scenario: &Scenario,
    epoch: Stamp,
    said: &Said,
    heard: &Heard,
) -> Result<(), BagError> {
    let begin = epoch.plus_seconds(-LEAD);
    let options = WriteOptions { compression: Compression::None, ..WriteOptions::default() };
    let mut bag = BagWriter::create(path, options)?;
    let mut entries = Vec::new();
    let e = &mut entries;
    put(&mut bag, e, "/climber/camera/image_raw/compressed", &QosProfile::SENSOR, &said.images);
    put(&mut bag, e, "/climber/camera/camera_info", &QosProfile::SENSOR, &said.camera_info);
    put(&mut bag, e, "/climber/joint_states", &QosProfile::RELIABLE, &said.joints);
    put_heard(&mut bag, e, "/volant/imu/data", &QosProfile::SENSOR, begin, &heard.imu);
    put_heard(&mut bag, e, "/climber/transform", &QosProfile::RELIABLE, begin, &heard.climber);
    put_heard(&mut bag, e, "/climber/markers", &QosProfile::RELIABLE, begin, &heard.markers);
    put_heard(&mut bag, e, "/volant/odometry", &QosProfile::RELIABLE, begin, &heard.odometry);
    put_heard(&mut bag, e, "/volant/fused_pose", &QosProfile::RELIABLE, begin, &heard.fused_pose);
    put_heard(&mut bag, e, "/volant/visual_pose", &QosProfile::RELIABLE, begin, &heard.visual_pose);
    put_heard(&mut bag, e, "/volant/marker_updates", &QosProfile::RELIABLE, begin, &heard.marker_updates);
    put_heard(&mut bag, e, "/tf", &QosProfile::RELIABLE, begin, &heard.tf);
    put_heard(&mut bag, e, "/diagnostics", &QosProfile::RELIABLE, begin, &heard.diagnostics);
    // Latched: heard before the run, belonging into it.
    let fixed: Vec<_> =
        heard.tf_static.iter().map(|(at, m)| ((*at).max(begin), m.as_ref().clone())).collect();
    put(&mut bag, e, "/tf_static", &QosProfile::LATCHED, &fixed);
    let poses: Vec<_> = (0..=((scenario.duration() + LEAD) * TRUTH_RATE) as usize)
        .map(|i| {
            let t = i as f64 / TRUTH_RATE - LEAD;
            let stamp = epoch.plus_seconds(t);
            (stamp, truth(scenario, t, stamp))
        })
        .collect();
    put(&mut bag, e, "/ground_truth/odometry", &QosProfile::RELIABLE, &poses);
    entries.sort_by_key(|(time, ..)| *time);
    for (time, topic, data) in &entries {
        bag.write(*topic, *time, *time, data)?;
    }
    bag.finish()?;
    Ok(())
}

type Entry = (u64, launch_config::bag::TopicId, Vec<u8>);

fn put<M: Message>(
    bag: &mut BagWriter,
    entries: &mut Vec<Entry>,
    name: &str,
    qos: &QosProfile,
    messages: &[(Stamp, M)],
) {
    let topic = bag.add_topic(Topic::of::<M>(name, qos));
    entries.extend(messages.iter().map(|(at, m)| (at.as_nanos().unsigned_abs(), topic, cdr::to_bytes(m))));
}

fn put_heard<M: Message>(
    bag: &mut BagWriter,
    entries: &mut Vec<Entry>,
    name: &str,
    qos: &QosProfile,
    from: Stamp,
    messages: &Received<M>,
) {
    let topic = bag.add_topic(Topic::of::<M>(name, qos));
    let kept = messages.iter().filter(|(at, _)| *at >= from);
    entries.extend(kept.map(|(at, m)| (at.as_nanos().unsigned_abs(), topic, cdr::to_bytes(m.as_ref()))));
}
