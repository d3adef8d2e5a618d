//! Inputs: each message is checked and brought into the form that the time line holds.

pub mod climber_track;
pub mod imu;
pub mod imu_stamps;
pub mod markers;
