//! ROS 2 parameters without middleware: their values, the YAML that holds them, the rules by which
//! rcl reads it, and their declaration.
//!
//! `rig_model` reads the rig file with it, `node_kit` the files and `-p` arguments of a node. A
//! core declares its configuration with [`parameters!`]: one row yields the field of a plain
//! struct, its default, its validation, the ROS descriptor, the line of the YAML file and the row
//! of the documentation's table.

mod descriptor;
pub mod edit;
mod file;
mod macros;
mod set;
pub mod yaml;

pub use descriptor::{Descriptor, ParameterError, ParameterKind};
pub use file::{ParameterFile, ParameterFileError, ParameterMap, ParameterValue, parse_value};
pub use set::{ParameterSet, ParameterType};
