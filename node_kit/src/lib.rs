//! What rclcpp gives a node and ros2-client does not.
//!
//! A node is a [`NodeShell`](node::NodeShell): it says its parameters ([`parameters!`]), subscribes and advertises in
//! `start`, and gets every message and device event in order of arrival in `handle`. In flows what `--ros-args`, the
//! environment and the network say; out flow publications, `/rosout`, `/diagnostics`, `/tf` and services.
//!
//! Without the feature `dds` there is no middleware, thread or signal in here: names, parameters, `--ros-args`, QoS
//! and [`convert`], the one place where ROS messages and `rig_model`'s types meet.

pub mod args;
pub mod convert;
pub mod environment;
pub mod files;
#[cfg(feature = "dds")]
mod inbox;
pub mod level;
pub mod lifecycle;
pub mod names;
#[cfg(feature = "dds")]
pub mod node;
pub mod parameters;
pub mod qos;

pub use args::RosArguments;
pub use level::Level;
pub use names::NodeName;
#[cfg(feature = "dds")]
pub use node::{
    Clock, DeviceSender, Health, Kit, Logger, NodeError, NodeShell, Process, Publisher, Responder, run_node,
    run_node_with,
};
pub use parameters::{ParameterError, ParameterSet};
pub use qos::QosPreset;
pub use rig_model::Stamp;

/// The allocator of the executables (`#[global_allocator]`); a larger program that embeds a node chooses its own.
///
/// A reliable publisher keeps up to 8192 samples for a reader that was killed until that one's lease is over (50 s). glibc's allocator
/// keeps the memory for good, because younger pieces lie behind the old ones; this one gives it back.
#[cfg(feature = "dds")]
pub use tikv_jemallocator::Jemalloc as Allocator;
