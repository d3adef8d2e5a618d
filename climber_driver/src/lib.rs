//! Encoder readings of the climber → transform `world_from_climber`.
//!
//! [`Climber`] is the core: [`Climber::handle`] receives a [`rig_model::JointReading`] and the
//! time of its receipt; [`Climber::poll`] returns a [`rig_model::ClimberSample`] or a [`Warning`].
//! It uses no clock and no middleware.

mod climber;
mod config;
#[cfg(feature = "node")]
pub mod node;
mod warning;

pub use climber::{Climber, Counts, Output};
pub use config::{Axis, ClimberConfig, JointCalibration};
pub use warning::Warning;
