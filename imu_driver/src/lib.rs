//! The inertial unit's driver: bytes of an Xsens MTx (or a newer unit) in, inertial samples out.
//!
//! In flow bytes with the instant of their arrival; out flow bytes to write, [`rig_model::ImuSample`]s with the instant
//! at which they were **measured**, and events that say what is going on. [`protocol`] is the wire format alone.

pub mod protocol;

pub mod fake_unit;
pub mod orientation;

pub mod clock_fit;
pub mod device_time;
pub mod driver;

#[cfg(feature = "node")]
pub mod node;
#[cfg(feature = "serial")]
pub mod serial;
