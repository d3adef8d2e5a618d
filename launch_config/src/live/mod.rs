//! Bags and live topics: [`record`] and [`play`]; live topics to look at: [`monitor`] and [`foxglove`].
//!
//! Messages pass as the bytes that they are on the wire ([`raw`]), so that any type is recorded and played, known or not.

pub mod foxglove;
pub mod monitor;
pub mod play;
mod player;
pub mod raw;
pub mod record;
pub mod tap;

use crate::bag::BagError;
use node_kit::environment::{EnvironmentError, Network};
use rustdds::{DomainParticipant, DomainParticipantBuilder};
use thiserror::Error;

/// Why nothing can be recorded or played.
#[derive(Debug, Error)]
pub enum LiveError {
    /// The bag.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The environment.
    #[error(transparent)]
    Environment(#[from] EnvironmentError),
    /// The middleware says no.
    #[error("{what}: {reason}")]
    Middleware {
        /// What was tried.
        what: String,
        /// Its reason.
        reason: String,
    },
    /// A thread cannot be started, or is gone.
    #[error("{what} ended too early; this is a fault of the program, please report it")]
    Thread {
        /// Which.
        what: &'static str,
    },
    /// An address that cannot be served at.
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
    /// A bag without messages to play.
    #[error("{path}: there is nothing to play{why}")]
    Nothing {
        /// The bag.
        path: String,
        /// What left nothing.
        why: String,
    },
}

/// A participant in the domain that the environment names.
pub(crate) fn join() -> Result<DomainParticipant, LiveError> {
    let network = Network::from_environment()?;
    let mut builder = DomainParticipantBuilder::new(network.domain_id);
    if let Some(addresses) = network.only_addresses() {
        builder = builder.with_only_networks(addresses);
    }
    builder.build().map_err(|e| LiveError::Middleware {
        what: format!("the participant in domain {}", network.domain_id),
        reason: e.to_string(),
    })
}

/// Nanoseconds of the system's clock: when a message was received.
#[allow(clippy::disallowed_methods)] // a recorder is where time enters
pub(crate) fn system_nanos() -> u64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}
