//! Live topics: [`record`] and [`play`] them, watch them with [`monitor`] and [`foxglove`].
//! Messages are passed as serialized bytes ([`raw`]), so that unknown types are recorded and played
//! too.

pub mod foxglove;
pub mod monitor;
pub mod play;
pub mod raw;
pub mod record;
pub mod tap;

/// The error of a thread that has not started, or has ended.
fn thread_ended(what: &str) -> anyhow::Error {
    anyhow::anyhow!("{what} ended too early; this is a bug, please report it")
}

/// Time of the system clock, ns since the epoch: when a message was received.
#[allow(clippy::disallowed_methods)] // a recorder is where time enters
pub(crate) fn system_nanos() -> u64 {
    let since =
        std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_nanos()).unwrap_or(u64::MAX)
}
