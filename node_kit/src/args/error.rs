//! Errors of the command line.

use std::path::Path;
use thiserror::Error;

/// An invalid command line, or an unusable parameter file.
#[derive(Debug, Error)]
#[error("{message}")]
pub struct ArgumentError {
    message: String,
    usage: bool,
}

impl ArgumentError {
    /// A mistake of the command line itself.
    pub(crate) fn usage(message: impl Into<String>) -> Self {
        Self { message: message.into(), usage: true }
    }

    /// An option without a value.
    pub(crate) fn no_value(option: &str, expected: &str) -> Self {
        Self::usage(format!("`{option}` needs {expected} after it"))
    }

    /// A malformed rule, assignment, level or number after an option.
    pub(crate) fn malformed(option: &str, text: &str, expected: &str) -> Self {
        Self::usage(format!("`{option} {text}` is not understood; expected {expected}"))
    }

    /// An invalid parameter file.
    pub(super) fn file(path: &Path, reason: impl std::fmt::Display) -> Self {
        Self { message: format!("the parameter file {}: {reason}", path.display()), usage: false }
    }

    /// Returns whether the command line itself is wrong (exit status 2) rather than a file that it
    /// names (1).
    pub fn is_usage(&self) -> bool {
        self.usage
    }
}
