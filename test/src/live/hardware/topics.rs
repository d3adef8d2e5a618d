//! The hardware's publishers and the subscriber to the nodes' topics.

use super::lock;
use crate::live::received::{Received, TopicLog};
use imu_driver::simulated_imu::pty::now;
use node_kit::{
    node::{NodeContext, NodeError, NodeShell, Publisher},
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

/// The climber's computer: camera and encoders.
pub(super) struct RigPublisher;

impl NodeShell for RigPublisher {
    const NAME: &'static str = "rig_simulator";
    const ABOUT: &'static str = "the simulated rig's camera and encoders";
    type Parameters = ();
    type Input = ();

    fn handle(&mut self, _: &mut NodeContext<()>, (): ()) {}
}

impl RigPublisher {
    /// Advertises the topics and sends their publishers to the hardware's threads.
    pub(super) fn advertise(
        context: &mut NodeContext<()>,
        sender: &SyncSender<Publishers>,
    ) -> Result<Self, NodeError> {
        let publishers = Publishers {
            image: context.advertise(topics::COMPRESSED_IMAGE, QosPreset::Image)?,
            camera_info: context.advertise(topics::CAMERA_INFO, QosPreset::CameraInfo)?,
            joints: context.advertise(topics::JOINT_STATES, QosPreset::State)?,
        };
        // The channel holds one entry, and its receiver outlives this call.
        let _ = sender.send(publishers);
        Ok(Self)
    }
}

/// The platform's computer: a subscriber to the nodes' topics.
pub(super) struct RigSubscriber;

impl NodeShell for RigSubscriber {
    const NAME: &'static str = "rig_subscriber";
    const ABOUT: &'static str = "receives the messages of the simulated rig's nodes";
    type Parameters = ();
    type Input = ();

    fn handle(&mut self, _: &mut NodeContext<()>, (): ()) {}
}

impl RigSubscriber {
    /// Subscribes to all topics of the nodes and keeps their messages.
    pub(super) fn subscribe(
        context: &mut NodeContext<()>,
        received: &Arc<Mutex<Received>>,
    ) -> Result<Self, NodeError> {
        use QosPreset::{Latched, Sensor, State};
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
        Ok(Self)
    }
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
        None
    })
}
