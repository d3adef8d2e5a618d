//! Library of the `volant` command: replay of recorded runs through the nodes' cores, evaluation of
//! estimates against the truth, and recording, playing and monitoring of live topics.

pub mod calibration;
pub mod camera_info_file;
pub mod command_line;
pub mod evaluate;
pub mod live;
pub mod markers;
pub mod parameter_update;
pub mod replay;
pub mod report;
pub mod stopwatch;
