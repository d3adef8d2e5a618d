//! Why a node ends on its own.

use crate::{
    args::ArgumentError, environment::EnvironmentError, names::NameError,
    parameters::ParameterError, scheduling::SchedulingError,
};
use rig_model::RigError;
use std::{fmt::Display, path::PathBuf};
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
    /// The rig's part of the parameters.
    #[error("{source}; is `--ros-args --params-file rig.yaml` given?")]
    Rig {
        /// What is wrong with it.
        #[from]
        source: RigError,
    },
    /// The same topic with two types in one process.
    #[error(
        "the topic {topic} is {there} in this process already, not {here}; remap one of the two"
    )]
    TypeClash {
        /// Absolute name.
        topic: String,
        /// The requested type.
        here: &'static str,
        /// The existing type.
        there: &'static str,
    },
    /// The middleware could not create something.
    #[error("DDS cannot make {what}: {reason}")]
    Middleware {
        /// Participant, publisher, subscription or service, with its name.
        what: String,
        /// The middleware's message.
        reason: String,
    },
    /// Security is enforced, and the enclave cannot be used.
    #[error("DDS security: the enclave {enclave} of the keystore {keystore}: {reason}")]
    Security {
        /// Absolute name of the enclave.
        enclave: String,
        /// `ROS_SECURITY_KEYSTORE`.
        keystore: PathBuf,
        /// What is missing, and the remedy.
        reason: String,
    },
    /// The middleware's threads are gone.
    #[error(
        "the DDS middleware ended: it was interrupted (the process was stopped and continued), \
         the computer was suspended, or its clock was set back; start again"
    )]
    MiddlewareEnded,
    /// Priority, affinity or memory lock of the process.
    #[error(transparent)]
    Scheduling(#[from] SchedulingError),
    /// An environment variable with an invalid value.
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    /// The system refused a thread or a signal handler.
    #[error("the system refused {what}: {source}")]
    System {
        /// What was requested.
        what: String,
        /// The system's message.
        source: std::io::Error,
    },
    /// The node's own reason: which file, topic or device, and what to do.
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

    /// What the middleware could not create, with its message.
    pub(super) fn middleware(what: String, reason: impl Display) -> Self {
        Self::Middleware { what, reason: reason.to_string() }
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
