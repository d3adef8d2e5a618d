//! Entries of a node's inbox, and the inbox as seen by code that does not know the node's inputs.

use crate::{
    inbox::{Inbox, SourceCount, SourceId, now},
    parameters::ParameterValue,
};
use async_channel::Sender;

/// Entry of a node's inbox.
pub(crate) enum Event<I> {
    /// For the shell.
    Input(I),
    /// For the node's runner.
    Control(Control),
    /// Time has moved: due timers run.
    Wake,
}

/// Request that the node's own thread answers.
pub(crate) enum Control {
    /// Sets all of the parameters or none.
    Set { changes: Vec<(String, ParameterValue)>, reply: Sender<Result<(), String>> },
    /// Changes the lifecycle state.
    Transition { id: u8, label: String, reply: Sender<bool> },
}

/// A node's inbox, whatever its inputs are.
pub(crate) trait Sources: Send + Sync {
    fn add_source(&self, name: &str, depth: usize, expected: bool) -> SourceId;
    fn add_control(&self, name: &str, depth: usize) -> SourceId;
    fn put_control(&self, source: SourceId, control: Control);
    fn wake(&self, source: SourceId);
    fn refuse(&self, source: SourceId);
    fn touch(&self, source: SourceId);
    fn lose(&self, source: SourceId, count: u64);
    fn retire(&self, source: SourceId);
    fn set_accepting(&self, accepting: bool);
    fn counts(&self) -> Vec<SourceCount>;
    fn close(&self);
}

impl<I: Send + 'static> Sources for Inbox<Event<I>> {
    fn add_source(&self, name: &str, depth: usize, expected: bool) -> SourceId {
        Self::add_source(self, name, depth, expected)
    }
    fn add_control(&self, name: &str, depth: usize) -> SourceId {
        Self::add_control(self, name, depth)
    }
    fn put_control(&self, source: SourceId, control: Control) {
        self.put(source, Event::Control(control), now());
    }
    fn wake(&self, source: SourceId) {
        self.put(source, Event::Wake, now());
    }
    fn refuse(&self, source: SourceId) {
        Self::refuse(self, source);
    }
    fn touch(&self, source: SourceId) {
        Self::touch(self, source, now());
    }
    fn lose(&self, source: SourceId, count: u64) {
        Self::lose(self, source, count);
    }
    fn retire(&self, source: SourceId) {
        Self::retire(self, source);
    }
    fn set_accepting(&self, accepting: bool) {
        Self::set_accepting(self, accepting);
    }
    fn counts(&self) -> Vec<SourceCount> {
        Self::counts(self)
    }
    fn close(&self) {
        Self::close(self);
    }
}
