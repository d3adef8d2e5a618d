//! A simulated rig: its motion and the data of its sensors. Everything follows from a seed.

pub mod coverage;
pub mod floor;
pub mod inertial;
pub mod motion;
pub mod parallel;
pub mod platform;
pub mod random;
pub mod recording;
pub mod render;
pub mod shadow;

/// Rig file of the simulated rig.
pub const RIG_YAML: &str = include_str!("../rig.yaml");

pub use render::{Covers, Exposure, Instant, Renderer, RgbImage, SceneConfig};
pub use shadow::Shadow;
