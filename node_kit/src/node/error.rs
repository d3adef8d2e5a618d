//! Why a node ends before it was asked to.

use crate::{args::ArgumentError, names::NameError, parameters::ParameterError};
use rig_model::RigError;
use thiserror::Error;

/// Why a node cannot start or go on.
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
    /// The rig's part of the parameters.
    #[error("{source}; is `--ros-args --params-file rig.yaml` given?")]
    Rig {
        /// What is wrong with it.
        #[from]
        source: RigError,
    },
    /// The same topic with two types in one process.
    #[error("the topic {topic} is {there} in this process already, not {here}; remap one of the two")]
    TypeClash {
        /// Absolute name.
        topic: String,
        /// The type that was asked for.
        here: &'static str,
        /// The type that it has.
        there: &'static str,
    },
    /// The middleware refused to make something.
    #[error("DDS cannot make {what}: {reason}")]
    Middleware {
        /// Participant, publisher, subscription or service, with its name.
        what: String,
        /// What it said.
        reason: String,
    },
    /// The middleware's threads are gone.
    #[error(
        "the DDS middleware ended: it was interrupted (the process was stopped and continued), the computer slept, or its clock was set back; start again"
    )]
    MiddlewareEnded,
    /// An environment variable that cannot be.
    #[error("the environment variable {name}={value} is not understood; expected {expected}")]
    Environment {
        /// Its name.
        name: &'static str,
        /// Its value.
        value: String,
        /// What it may be.
        expected: &'static str,
    },
    /// The system refused a thread or a signal handler.
    #[error("the system refused {what}: {source}")]
    System {
        /// What was asked for.
        what: String,
        /// What it said.
        source: std::io::Error,
    },
    /// What the node itself says: which file, topic or device, and what to do.
    #[error("{message}")]
    Shell {
        /// One line.
        message: String,
    },
    /// A defect: the node's thread panicked.
    #[error("the node {node} stopped on an internal error: {message}; please report it")]
    Panicked {
        /// The node.
        node: String,
        /// The panic's text.
        message: String,
    },
}

impl NodeError {
    /// A node's own reason: one line that names the file, topic or device, and the remedy.
    pub fn shell(message: impl Into<String>) -> Self {
        Self::Shell { message: message.into() }
    }

    /// Is the command line wrong (exit status 2) rather than the work impossible (1)?
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::Arguments(e) if e.is_usage())
            || matches!(self, Self::Name(_))
            || matches!(self, Self::Parameter(ParameterError::Unknown { origin, .. }) if origin == "-p")
    }
}
