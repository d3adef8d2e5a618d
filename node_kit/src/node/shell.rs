//! What a node implements.

use super::{context::NodeContext, error::NodeError};
use crate::parameters::ParameterSet;

/// A node: a thin shell around a core.
///
/// It runs on a thread of its own. Every message, device event and timer reaches it through
/// [`NodeShell::handle`], one at a time, in order of arrival.
pub trait NodeShell: Sized + 'static {
    /// Default name of the node; `-r __node:=…` overrides it.
    const NAME: &'static str;
    /// One sentence for `--help`.
    const ABOUT: &'static str = "";
    /// Parameters, besides those that every node has.
    type Parameters: ParameterSet;
    /// Inputs of [`NodeShell::handle`].
    type Input: Send + 'static;

    /// Subscribes, advertises and starts the threads of devices.
    ///
    /// # Errors
    /// Why the node cannot run; see [`NodeError::shell`]. A node that needs more than its
    /// parameters is a closure: [`Process::start_closure`](super::Process::start_closure).
    fn start(
        context: &mut NodeContext<Self::Input>,
        parameters: Self::Parameters,
    ) -> Result<Self, NodeError>;

    /// Handles one input.
    fn handle(&mut self, context: &mut NodeContext<Self::Input>, input: Self::Input);

    /// Runs once a second, before the diagnostics are published; see
    /// [`NodeHandle::diagnose`](super::NodeHandle::diagnose).
    fn tick(&mut self, _context: &mut NodeContext<Self::Input>) {}

    /// Applies a change of live parameters; `parameters` holds all of them, validated.
    ///
    /// # Errors
    /// Why the values do not fit the node's state; the change is then rejected with this reason.
    fn parameters_changed(
        &mut self,
        _context: &mut NodeContext<Self::Input>,
        _parameters: &Self::Parameters,
    ) -> Result<(), String> {
        Ok(())
    }
}
