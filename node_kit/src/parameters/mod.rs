//! Parameters, declared once: one row of [`parameters!`](crate::parameters!) yields the field of a
//! plain struct, its validation, the ROS descriptor, the line of the YAML file and the row of the
//! documentation's table.

mod common;
mod descriptor;
mod macros;
pub mod messages;
mod set;
mod store;
mod tables;

#[cfg(feature = "dds")]
pub(crate) use common::START_TYPE_DESCRIPTION_SERVICE;
pub use common::common_descriptors;
pub use descriptor::{Descriptor, ParameterError, ParameterKind};
pub use ros_parameters::{ParameterMap, ParameterValue};
pub use set::{ParameterSet, ParameterType};
pub use store::{Change, ParameterStore};
pub use tables::{help_table, markdown_table, yaml_file};
