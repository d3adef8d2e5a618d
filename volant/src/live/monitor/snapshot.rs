//! What the monitor shows: poses, markers, rates and diagnostics at one time.

use nalgebra::{Isometry3, Vector3};
use volant_msgs::{
    diagnostic_msgs::msg::DiagnosticStatus,
    msg::{MarkerObservation, PoseStatus},
};

/// The estimates and measurements of one rig.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RigState {
    /// `volant/odometry`: `world_from_volant` and its twist in the volant frame.
    pub odometry: Option<PoseState>,
    /// `volant/visual_pose`: `world_from_volant` from one image alone.
    pub visual: Option<PoseState>,
    /// `climber/markers`.
    pub markers: Vec<MarkerObservation>,
    /// Arrival of the markers, ns.
    pub markers_at: u64,
    /// Arrival of `volant/status`, ns, and the message.
    pub status: Option<(u64, PoseStatus)>,
}

/// A pose with its standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseState {
    /// Time of arrival, ns.
    pub at: u64,
    /// Position, m.
    pub position: Vector3<f64>,
    /// Roll, pitch, yaw (fixed axes x, y, z), degrees.
    pub angles: [f64; 3],
    /// Standard deviations of the position, m.
    pub position_sigma: [f64; 3],
    /// Standard deviations of the rotation about the axes, degrees.
    pub angle_sigma: [f64; 3],
    /// Linear and angular speed, m/s and degrees/s, where the message has a twist.
    pub speed: Option<[f64; 2]>,
}

/// What the monitor shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// Rigs by namespace, such as `/rig1`; empty for the root.
    pub rigs: Vec<(String, RigState)>,
    /// Topics by name.
    pub topics: Vec<TopicLine>,
    /// The nodes' own counts of their inputs.
    pub inputs: Vec<InputLine>,
    /// Diagnostics without their values, worst first; the node is in `hardware_id` alone.
    pub statuses: Vec<DiagnosticStatus>,
    /// Time of the snapshot, ns.
    pub now: u64,
    /// Where topics are searched: domain, discovery range, namespace.
    pub place: String,
}

/// A published topic.
#[derive(Clone, Debug, PartialEq)]
pub struct TopicLine {
    /// Absolute name.
    pub name: String,
    /// Number of publishers.
    pub publishers: usize,
    /// Received messages; `None` if the monitor does not subscribe.
    pub flow: Option<Flow>,
}

/// Rate and delay of a topic.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flow {
    /// Rate over the last 5 s, Hz; 0 where it is silent, `None` for a latched topic.
    pub rate: Option<f64>,
    /// Mean and largest time from stamp to arrival, s.
    pub delay: Option<(f64, f64)>,
    /// Messages received since the start.
    pub count: u64,
    /// Messages lost in transport.
    pub lost: u64,
}

/// A node's own count of one of its inputs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InputLine {
    /// Fully qualified name of the node.
    pub node: String,
    /// The topic or device.
    pub input: String,
    /// Rate, Hz.
    pub rate: f64,
    /// Messages dropped from the full input queue.
    pub dropped: u64,
    /// Messages rejected as unusable.
    pub rejected: u64,
    /// Messages lost in transport.
    pub lost: u64,
}

impl PoseState {
    /// Converts a received pose; `at` in ns, `speed` in m/s and degrees/s.
    pub(super) fn new(
        at: u64,
        pose: &Isometry3<f64>,
        covariance: &[f64; 36],
        speed: Option<[f64; 2]>,
    ) -> Self {
        let (roll, pitch, yaw) = pose.rotation.euler_angles();
        let sigma = |i: usize| covariance[i * 7].max(0.0).sqrt();
        Self {
            at,
            position: pose.translation.vector,
            angles: [roll, pitch, yaw].map(f64::to_degrees),
            position_sigma: [sigma(0), sigma(1), sigma(2)],
            angle_sigma: [sigma(3), sigma(4), sigma(5)].map(f64::to_degrees),
            speed,
        }
    }
}
