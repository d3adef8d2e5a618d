//! The hardware's publishers and the subscriber to the nodes' topics.

use super::lock;
use crate::live::received::{Received, TopicLog};
use imu_driver::simulated_imu::pty::now;
use node_kit::{
    node::{IfChanged, NodeContext, NodeError, Process, Publisher},
    qos::QosPreset,
};
use rig_model::topics;
use std::sync::{Arc, Mutex, mpsc::SyncSender};
use volant_msgs::{
    Message,
    sensor_msgs::msg::{CameraInfo, CompressedImage, JointState},
};

/// Publishers of the hardware's threads.
#[derive(Clone)]
pub(super) struct Publishers {
    pub(super) image: Publisher<CompressedImage>,
    pub(super) camera_info: Publisher<CameraInfo>,
    pub(super) joints: Publisher<JointState>,
}

impl Publishers {
    /// Starts the node of camera and encoders on the climber's computer; its publishers go to the
    /// hardware's threads.
    pub(super) fn start(
        climber: &mut Process,
        sender: SyncSender<Publishers>,
    ) -> Result<(), NodeError> {
        climber.start_closure("rig_simulator", move |context: &mut NodeContext<()>| {
            let publishers = Publishers {
                image: context.advertise(topics::COMPRESSED_IMAGE, QosPreset::Image)?,
                camera_info: context.advertise(topics::CAMERA_INFO, QosPreset::CameraInfo)?,
                joints: context.advertise(topics::JOINT_STATES, QosPreset::State)?,
            };
            // The channel holds one entry, and its receiver outlives this call.
            let _ = sender.send(publishers);
            Ok(|_: &mut NodeContext<()>, ()| ())
        })
    }
}

/// Starts a node on the platform's computer that keeps the messages of all topics of the nodes.
pub(super) fn start_subscriber(
    platform: &mut Process,
    received: Arc<Mutex<Received>>,
) -> Result<(), NodeError> {
    platform.start_closure("rig_subscriber", move |context: &mut NodeContext<()>| {
        use QosPreset::{Latched, Sensor, State};
        let received = &received;
        subscribe(context, topics::ODOMETRY, State, received, |h| &mut h.odometry)?;
        subscribe(context, topics::VISUAL_POSE, State, received, |h| &mut h.visual_pose)?;
        subscribe(context, topics::MARKER_UPDATES, State, received, |h| &mut h.marker_updates)?;
        subscribe(context, topics::absolute::DIAGNOSTICS, State, received, |h| &mut h.diagnostics)?;
        subscribe(context, topics::POSE, State, received, |h| &mut h.pose)?;
        subscribe(context, topics::STATUS, State, received, |h| &mut h.status)?;
        subscribe(context, topics::FUSED_POSE, State, received, |h| &mut h.fused_pose)?;
        subscribe(context, topics::IMU, Sensor, received, |h| &mut h.imu)?;
        subscribe(context, topics::MARKERS, State, received, |h| &mut h.markers)?;
        subscribe(context, topics::CLIMBER_TRANSFORM, State, received, |h| &mut h.climber)?;
        subscribe(context, topics::absolute::TF, State, received, |h| &mut h.tf)?;
        subscribe(context, topics::absolute::TF_STATIC, Latched, received, |h| &mut h.tf_static)?;
        Ok(|_: &mut NodeContext<()>, ()| ())
    })
}

/// Where the messages of a topic are kept.
pub(super) type ListOf<M> = fn(&mut Received) -> &mut TopicLog<M>;

/// Keeps every message of a topic with its time of receipt, read on the receiving thread.
fn subscribe<M: Message>(
    context: &mut NodeContext<()>,
    topic: &str,
    preset: QosPreset,
    received: &Arc<Mutex<Received>>,
    list: ListOf<M>,
) -> Result<(), NodeError> {
    let received = Arc::clone(received);
    context.subscribe_optional(topic, preset, move |message: Arc<M>| {
        list(&mut lock(&received)).push((now(), message));
        IfChanged::<Option<()>>(None)
    })
}
