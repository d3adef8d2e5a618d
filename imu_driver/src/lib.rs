//! Driver for Xsens IMUs on a serial port: bytes → samples.
//!
//! The core receives bytes with their arrival time, and outputs bytes to write,
//! [`rig_model::ImuSample`]s stamped with their time of **measurement**, and events.
//!
//! | module | content |
//! | --- | --- |
//! | [`protocol`] | bytes → frames → values in SI units |
//! | [`driver`] | state machine: search, configuration, measurement, recovery |
//! | [`device_time`], [`clock_fit`] | counters and arrival times → stamps |
//! | [`orientation`] | global frames of the device → east-north-up |
//! | [`log`] | recorded bytes → CSV |
//! | [`simulated_imu`] | simulated device |
//!
//! These modules are pure. Features add the rest: `serial` the port, `node` the ROS 2 node, `cli`
//! the command `volant imu`, `simulated` a pseudo-terminal for the simulated device.

pub mod clock_fit;
pub mod device_time;
pub mod driver;
pub mod log;
#[cfg(feature = "node")]
pub mod node;
pub mod orientation;
pub mod protocol;
#[cfg(feature = "serial")]
pub mod serial;
pub mod simulated_imu;
#[cfg(feature = "cli")]
pub mod tool;
