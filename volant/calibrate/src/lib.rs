//! `volant calibrate camera`: calibration of the camera.
//! Images yield a standard `camera_info` file, with uncertainties. Images that do not determine
//! the result are rejected, with what is missing.

pub mod camera;
pub mod images;
