//! ROS 2 node runtime over ros2-client 0.12.1, with what rclcpp has and ros2-client lacks:
//! `--ros-args`, parameters with descriptors, lifecycle, clock, tf, diagnostics, intra-process
//! transport.
//!
//! A node implements [`NodeShell`]: it declares its parameters ([`parameters!`]),
//! subscribes and advertises in `start`, and receives every message and device event in order of
//! arrival in `handle`. [`node::join`] is the only function that creates a DDS participant.
//!
//! Without the feature `dds` there is no middleware, thread or signal: names, parameters,
//! `--ros-args`, QoS and [`convert`], the one place that converts between ROS messages and
//! `rig_model`'s types.

pub mod args;
pub mod console;
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
#[cfg(feature = "dds")]
pub mod scheduling;

pub use args::RosArguments;
pub use level::Level;
pub use names::NodeName;
#[cfg(feature = "dds")]
pub use node::{
    Clock, DeviceSender, Health, Logger, NodeContext, NodeError, NodeShell, Process, Publisher,
    Responder, run_node,
};
pub use parameters::{ParameterError, ParameterSet};
pub use qos::QosPreset;
pub use rig_model::Stamp;
pub use ros_parameters::parameters;

/// The allocator of the executables (`#[global_allocator]`); a larger program that embeds a node
/// chooses its own.
///
/// A reliable publisher keeps up to 8192 samples for a reader that was killed until its lease is
/// over (50 s). glibc's allocator keeps that memory for good, because newer allocations lie behind
/// it; this one returns it.
#[cfg(feature = "dds")]
pub use mimalloc::MiMalloc as Allocator;
