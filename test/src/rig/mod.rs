//! A rig that does not exist: how it moves, and what its sensors say. Everything follows from a seed.

pub mod coverage;
pub mod floor;
pub mod inertial;
pub mod motion;
pub mod platform;
pub mod random;
pub mod render;

pub use render::{Covers, Exposure, Instant, Renderer, RgbImage, SceneConfig};
