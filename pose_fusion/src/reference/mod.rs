//! Reference estimators: the published filter with its pose, and the pose from one image alone.

mod gyro_attitude;
pub mod marker_measurement;
pub mod paper;
pub mod published_pose;
pub mod single_image;
