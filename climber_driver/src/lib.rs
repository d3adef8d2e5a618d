//! The crane's encoders tell where the climber is: readings of its three joints flow in, `world_from_climber` flows out.
//!
//! [`Climber`] is the core: [`Climber::handle`] takes a [`JointReading`] and when it was received, [`Climber::poll`] gives
//! a [`rig_model::ClimberSample`] or says by name why the reading was refused. It knows no clock and no middleware.

mod climber;
mod config;
#[cfg(feature = "node")]
pub mod node;
mod refusal;

pub use climber::{Climber, Counts, JointReading, Output, Warning};
pub use config::{Axis, ClimberConfig, ConfigError, JointCalibration};
pub use refusal::Refusal;
