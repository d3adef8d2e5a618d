//! Controls of a player, and the node that it publishes from.

use super::LiveError;
use node_kit::{
    RosArguments,
    node::{NodeContext, NodeHandle, NodeShell, Process},
};
use std::sync::{
    atomic::{AtomicBool, Ordering},
    mpsc::sync_channel,
};

/// Controls of a playback, for use from any thread.
#[derive(Debug, Default)]
pub struct PlayControl {
    stop: AtomicBool,
    paused: AtomicBool,
}

impl PlayControl {
    /// Creates controls with a paused state.
    pub fn new(paused: bool) -> Self {
        Self { stop: AtomicBool::new(false), paused: AtomicBool::new(paused) }
    }

    /// Stops the playback.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Release);
    }

    /// Whether the playback is stopped.
    pub fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }

    /// Toggles between paused and playing.
    pub fn toggle_paused(&self) {
        self.paused.fetch_xor(true, Ordering::AcqRel);
    }

    /// Whether the playback is paused.
    pub fn is_paused(&self) -> bool {
        self.paused.load(Ordering::Acquire)
    }
}

/// Node with rosbag2's name, which owns the publishers in the graph.
struct Player;

impl NodeShell for Player {
    const NAME: &'static str = "rosbag2_player";
    const ABOUT: &'static str = "plays a bag to live topics";
    type Parameters = ();
    type Input = ();

    fn handle(&mut self, _: &mut NodeContext<()>, (): ()) {}
}

/// Starts the node `rosbag2_player` with what `publish` creates on it; dropping the returned
/// process ends it.
///
/// # Errors
/// An invalid variable of the environment, DDS creates no participant, or the error of `publish`.
pub(super) fn start<T: Send + 'static>(
    publish: impl FnOnce(&mut NodeHandle) -> Result<T, LiveError> + Send + 'static,
) -> Result<(Process, T), LiveError> {
    let mut process = Process::from_environment()?;
    let (made, publishers) = sync_channel(1);
    let mut publish = Some(publish);
    process.start_with::<Player>(&RosArguments::default(), move |context, ()| {
        // Once: the publishers stay when the node is configured again.
        if let Some(publish) = publish.take() {
            // The receiver is there until this has returned.
            let _ = made.send(publish(context));
        }
        Ok(Player)
    })?;
    let publishers =
        publishers.recv().map_err(|_| LiveError::Thread { what: "the player's node" })??;
    Ok((process, publishers))
}
