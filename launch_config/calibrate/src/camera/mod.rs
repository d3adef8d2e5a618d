//! The camera from pictures of a chessboard (Zhang's method, as OpenCV has it).

pub mod board;
pub mod command;
pub mod coverage;
pub mod solve;
pub mod yaml;

pub use board::{Board, View, find};
pub use coverage::Coverage;
pub use solve::{Calibration, LensModel, Options, calibrate};
pub use yaml::camera_info_yaml;
