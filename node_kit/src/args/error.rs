//! Errors of the command line.

use crate::names::NameError;
use ros_parameters::ParameterFileError;
use std::path::PathBuf;
use thiserror::Error;

/// An invalid command line (exit status 2), or an unusable parameter file (exit status 1; see
/// [`ArgumentError::is_usage`]).
#[derive(Debug, Error)]
pub enum ArgumentError {
    /// An option without a value.
    #[error("`{option}` needs {expected} after it")]
    MissingValue {
        /// The option.
        option: String,
        /// The expected value.
        expected: &'static str,
    },
    /// A malformed rule, assignment or level.
    #[error("`{option} {text}` is not understood; expected {expected}")]
    Malformed {
        /// The option.
        option: String,
        /// The text after it.
        text: String,
        /// The expected value.
        expected: &'static str,
    },
    /// An option that ROS 2 does not have.
    #[error("`{option}` is not an option of --ros-args")]
    UnknownOption {
        /// The option.
        option: String,
    },
    /// An unknown argument outside of `--ros-args`.
    #[error("`{argument}` is not known{hint}")]
    UnknownArgument {
        /// The argument.
        argument: String,
        /// ` (did you mean …?)` or nothing.
        hint: String,
    },
    /// A parameter file that cannot be read.
    #[error("the parameter file {path}: {source}")]
    Unreadable {
        /// The path as given.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A malformed parameter file.
    #[error("the parameter file {path}: {source}")]
    ParameterFile {
        /// The path as given.
        path: PathBuf,
        /// What is wrong with it.
        source: ParameterFileError,
    },
    /// A block of a parameter file whose node's name is a typing mistake.
    #[error(
        "the parameter file {path}: the block `{selector}` matches no node (did you mean \
         `{name}`?); correct its spelling"
    )]
    UnknownNode {
        /// The path as given.
        path: PathBuf,
        /// The node selector.
        selector: String,
        /// The node's name.
        name: String,
    },
    /// A node's name in `-p` or `-r` that is a typing mistake.
    #[error("`{selector}:` matches no node (did you mean `{name}:`?); correct its spelling")]
    UnknownSelector {
        /// The node's name as given.
        selector: String,
        /// The node's name.
        name: String,
    },
    /// A malformed value after `-p`.
    #[error("`-p {text}`: {source}")]
    ParameterValue {
        /// The text after `-p`.
        text: String,
        /// What is wrong with it.
        source: ParameterFileError,
    },
    /// An invalid node name or namespace.
    #[error(transparent)]
    Name(#[from] NameError),
}

impl ArgumentError {
    /// Returns whether the command line itself is wrong (exit status 2) rather than a file that it
    /// names (1).
    pub fn is_usage(&self) -> bool {
        !matches!(
            self,
            Self::Unreadable { .. } | Self::ParameterFile { .. } | Self::UnknownNode { .. }
        )
    }
}
