//! Calibration of the camera from images of a chessboard (Zhang's method, by OpenCV).

pub mod board;
pub mod command;
pub mod coverage;
pub mod solve;

pub use board::{Board, View, find};
pub use coverage::Coverage;
pub use solve::{Calibration, LensModel, Options, calibrate};
