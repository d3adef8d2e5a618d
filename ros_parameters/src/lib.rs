//! ROS 2 parameter files: parameter values, the YAML that holds them, and the rules by which rcl
//! reads it.
//!
//! No middleware. `rig_model` reads the rig file with it, `node_kit` the files and `-p` arguments
//! of a node.

pub mod edit;
mod file;
pub mod yaml;

pub use file::{ParameterFile, ParameterFileError, ParameterMap, ParameterValue, parse_value};
