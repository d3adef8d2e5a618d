//! Reference estimators: the published filter, and the pose from one image alone.

pub mod paper;
pub mod single_image;
