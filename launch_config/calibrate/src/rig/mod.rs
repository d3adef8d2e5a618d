//! The rig from a recording: where the camera sits on the climber, how the inertial unit sits on the platform, and where the
//! markers are, refined together by bundle adjustment with uncertainties.
//!
//! The platform swings freely, so images alone say nothing about the rig: what ties it together is gravity and the
//! inertial unit between the images, and the encoders. What a recording's motion does not determine keeps its value
//! and is named.

mod arrow;
pub mod command;
mod estimate;
mod inertial;
mod problem;
mod recording;

pub use estimate::{Estimate, Row, refine_rig};
pub use recording::{Recording, Shot};
