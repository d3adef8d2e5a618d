//! Nodes on DDS: [`NodeShell`] is what a node is, [`Kit`] what it has (most of it a [`NodeHandle`]), [`run_node`] a binary's whole `main`, and
//! [`Process`] several nodes in one process.

mod clock;
mod control;
mod diagnostics;
mod domain;
mod error;
mod handle;
mod hub;
mod kit;
mod large_reply;
mod life;
mod logger;
mod middleware;
mod process;
mod publisher;
mod reactor;
mod run;
mod service;
mod tf;
mod timers;
mod topics;
mod wire;

pub use clock::{Clock, ClockWatch};
pub use diagnostics::Health;
pub use error::NodeError;
pub use handle::NodeHandle;
pub use kit::{DeviceSender, Kit};
pub use logger::Logger;
pub use middleware::{Loss, MiddlewareWatch};
pub use process::{Process, Stopper};
pub use publisher::Publisher;
pub use run::{run_node, run_node_with};
pub use service::Responder;
pub use topics::IntoInput;

use crate::parameters::ParameterSet;

/// A node: a thin shell around a core. It lives on a thread of its own, and every message, device event and timer comes
/// to it through [`NodeShell::handle`], one by one, in order of arrival.
pub trait NodeShell: Sized + 'static {
    /// Default name of the node; `-r __node:=…` gives it another.
    const NAME: &'static str;
    /// A sentence for `--help`.
    const ABOUT: &'static str = "";
    /// Its parameters, besides those that every node has.
    type Parameters: ParameterSet;
    /// What comes to it.
    type Input: Send + 'static;

    /// Subscribes, advertises, starts the threads of devices.
    ///
    /// # Errors
    /// Why the node cannot run; see [`NodeError::shell`].
    fn start(kit: &mut Kit<Self::Input>, parameters: Self::Parameters) -> Result<Self, NodeError>;

    /// One input.
    fn handle(&mut self, kit: &mut Kit<Self::Input>, input: Self::Input);

    /// Once a second, before the diagnostics go out: [`Kit::diagnose`].
    fn tick(&mut self, _kit: &mut Kit<Self::Input>) {}

    /// Live parameters have changed; `parameters` are all of them, checked. An error refuses the change, with a reason.
    ///
    /// # Errors
    /// Why these values do not fit what the node does now.
    fn parameters_changed(
        &mut self,
        _kit: &mut Kit<Self::Input>,
        _parameters: &Self::Parameters,
    ) -> Result<(), String> {
        Ok(())
    }
}
