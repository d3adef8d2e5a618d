//! Adaptation: noise levels and disturbances identified from the measurements themselves.

pub mod camera_shake;
pub mod disturbances;
pub mod encoder_noise;
pub mod images;
pub mod imu_integrity;
pub mod imu_noise;
pub mod innovation_scale;
pub mod layout_misfit;
pub mod stamp_jitter;
pub mod stationary;
pub mod unreported_motion;
