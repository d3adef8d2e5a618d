//! The inertial unit's driver: bytes of an Xsens MTx (or a newer unit) in, inertial samples out.
//!
//! In flow bytes with the instant of their arrival; out flow bytes to write, [`rig_model::ImuSample`]s with the instant
//! at which they were **measured**, and events that say what is going on.
//!
//! | module | in → out |
//! | --- | --- |
//! | [`protocol`] | bytes → frames → values in SI units: the wire format alone |
//! | [`driver`] | bytes and time → bytes to write, samples, events |
//! | [`device_time`], [`clock_fit`] | counters and arrivals → stamps |
//! | [`orientation`] | the unit's global frame → east-north-up |
//! | [`log`] | recorded bytes → a table |
//! | [`fake_unit`] | a unit that is not there |
//!
//! All of these are pure. The features add the outside: `serial` the port, `node` the ROS 2 node, `cli` the tool
//! `volant imu`, `fake` a pseudo-terminal for the fake unit.

pub mod clock_fit;
pub mod device_time;
pub mod driver;
pub mod fake_unit;
pub mod log;
#[cfg(feature = "node")]
pub mod node;
pub mod orientation;
pub mod protocol;
#[cfg(feature = "serial")]
pub mod serial;
#[cfg(feature = "cli")]
#[allow(clippy::print_stdout, reason = "a tool for people")]
pub mod tool;
