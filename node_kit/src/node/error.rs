//! Why a node ends on its own.

use crate::{
    args::ArgumentError, environment::EnvironmentError, names::NameError,
    parameters::ParameterError,
};
use std::fmt::Display;
use thiserror::Error;

/// Why a node cannot start or continue.
#[derive(Debug, Error)]
pub enum NodeError {
    /// The command line.
    #[error(transparent)]
    Arguments(#[from] ArgumentError),
    /// A node's, topic's or service's name.
    #[error(transparent)]
    Name(#[from] NameError),
    /// A parameter.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// An environment variable with an invalid value.
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    /// The system refused a thread or a signal handler.
    #[error("the system refused {what}: {error}")]
    System {
        /// What was requested.
        what: String,
        /// The system's message. The text has it, so it is no `source`: `{:#}` would repeat it.
        error: std::io::Error,
    },
    /// Any other reason: which file, topic or device, and what to do.
    #[error("{0}")]
    Other(String),
}

impl NodeError {
    /// A reason of any kind: one line that names the file, topic or device, and the remedy.
    pub fn shell(message: impl Into<String>) -> Self {
        Self::Other(message.into())
    }

    /// What the middleware could not create, with its message.
    pub(super) fn middleware(what: String, reason: impl Display) -> Self {
        Self::shell(format!("DDS cannot make {what}: {reason}"))
    }

    /// Returns whether the command line is wrong (exit status 2) rather than the work impossible
    /// (1).
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::Arguments(e) if e.is_usage())
            || matches!(self, Self::Name(_))
            || matches!(
                self,
                Self::Parameter(ParameterError::Given { origin, .. }) if origin == "-p"
            )
    }
}
