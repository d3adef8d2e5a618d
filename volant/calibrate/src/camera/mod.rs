//! Calibration of the camera from images of a chessboard (Zhang's method, by OpenCV).

mod board;
pub mod command;
mod coverage;
mod solve;
