//! The peers and our own tracker behind one call: a frame in, points and a pose out, with the time
//! of each stage.

mod april;
mod aruco;
mod ours;
mod pose;
mod recipe;
pub mod sift;

pub use april::{AprilTag, tag_frame};
pub use aruco::Aruco;
pub use ours::Ours;
pub use pose::{camera_matrix, gauss_newton, point2, point3, pose_from_centroids, solve_pnp};
pub use recipe::Recipe;
pub use sift::Sift;

use crate::scene::Frame;
use anyhow::Result;
use nalgebra::{Isometry3, Vector2};
use std::time::Duration;

/// Plate that a method detects.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Carrier {
    /// Four colored squares.
    Markers,
    /// A tag36h11 tag.
    Tag,
    Texture,
    /// A chessboard.
    Board,
}

/// What a method made of one frame.
#[derive(Clone, Debug, Default)]
pub struct Estimate {
    pub camera_from_volant: Option<Isometry3<f64>>,
    /// Measured points: number of the marker or corner, px.
    pub points: Vec<(usize, Vector2<f64>)>,
    /// Time of each stage, in the order of [`About::stages`].
    pub stages: Vec<Duration>,
}

pub struct About {
    pub name: &'static str,
    /// Plate that the method detects.
    pub carrier: Carrier,
    pub stages: &'static [&'static str],
}

/// A way to a pose.
pub trait Method {
    fn about(&self) -> About;
    /// Processes the next frame. The conversion to gray for methods that need it is not counted.
    fn estimate(&mut self, frame: &Frame) -> Result<Estimate>;
    /// Resets the tracking, where there is any: the next frame is searched as a whole.
    fn forget(&mut self) {}
}
