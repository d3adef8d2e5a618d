//! Live topics: [`record`] and [`play`] them, watch them with [`monitor`] and [`foxglove`].
//! Messages are passed as serialized bytes ([`raw`]), so that unknown types are recorded and played
//! too.

pub mod foxglove;
pub mod monitor;
pub mod play;
mod player;
pub mod raw;
pub mod record;
pub mod tap;

use bag::BagError;
use node_kit::{environment::EnvironmentError, node::NodeError};
use thiserror::Error;

/// Why live topics are not accessible.
#[derive(Debug, Error)]
pub enum LiveError {
    /// The bag.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The environment.
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    /// Joining the domain failed.
    #[error(transparent)]
    Join(#[from] NodeError),
    /// An operation of the middleware failed.
    #[error("{what}: {reason}")]
    Middleware {
        /// What failed.
        what: String,
        /// Its reason.
        reason: String,
    },
    /// A thread has not started, or has ended.
    #[error("{what} ended too early; this is a bug, please report it")]
    Thread {
        /// Which.
        what: &'static str,
    },
    /// The server's address is not available.
    #[error("{address}: {source}; is another server there? Give another address or port")]
    Address {
        /// Which.
        address: std::net::SocketAddr,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The terminal.
    #[error("the terminal: {source}; `--once` or a pipe writes plain text")]
    Terminal {
        /// The system's reason.
        source: std::io::Error,
    },
    /// The bag holds no messages to play.
    #[error("{path}: nothing to play{why}")]
    Nothing {
        /// The bag.
        path: String,
        /// Why no message is left.
        why: String,
    },
}

/// Time of the system clock, ns since the epoch: when a message was received.
#[allow(clippy::disallowed_methods)] // a recorder is where time enters
pub(crate) fn system_nanos() -> u64 {
    let since =
        std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}
