//! Declared parameters of a node ([`parameters!`](macro@crate::parameters)): store, messages and
//! text.

mod common;
pub mod messages;
mod store;
mod tables;

#[cfg(feature = "dds")]
pub(crate) use common::CommonParameters;
pub use common::common_descriptors;
pub use ros_parameters::{
    Descriptor, ParameterError, ParameterKind, ParameterMap, ParameterSet, ParameterType,
    ParameterValue,
};
pub use store::{Changes, ParameterStore};
pub use tables::{help_table, markdown_table, yaml_file};
