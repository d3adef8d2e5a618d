//! Threads of a node's devices, and how they hand events to the node.

use super::{context::NodeContext, error::NodeError, handle::NodeHandle};
use crate::inbox::{Event, Inbox, SourceId, SourceKind, Sources, now};
use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
};

/// Device threads of one start of the shell.
#[derive(Default)]
pub(crate) struct Devices {
    threads: Vec<JoinHandle<()>>,
    sources: Vec<SourceId>,
    /// Set when the threads must end.
    ending: Arc<AtomicBool>,
}

impl NodeHandle {
    /// Starts a named thread for a device. It must end soon after [`DeviceSender::is_open`] becomes
    /// false, because the node's end waits for it.
    ///
    /// # Errors
    /// The system refuses the thread.
    pub fn spawn(
        &mut self,
        name: &str,
        work: impl FnOnce() + Send + 'static,
    ) -> Result<(), NodeError> {
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(work)
            .map_err(|error| NodeError::System { what: format!("the thread {name}"), error })?;
        self.devices.threads.push(thread);
        Ok(())
    }

    /// Ends the threads of devices, waits for them and retires their sources.
    pub(crate) fn end_devices(&mut self) {
        let Devices { threads, sources, ending } = std::mem::take(&mut self.devices);
        ending.store(true, Ordering::Release);
        for thread in threads {
            let _ = thread.join();
        }
        sources.into_iter().for_each(|source| self.endpoints.sources.retire(source));
    }
}

impl<I: Send + 'static> NodeContext<I> {
    /// Creates a source of the inbox for a device. At most `depth` of its events wait; one more
    /// drops the oldest.
    pub fn device_sender(&mut self, name: &str, depth: usize) -> DeviceSender<I> {
        let source = self.inbox.add_source(name, depth, SourceKind::Optional);
        self.devices.sources.push(source);
        DeviceSender { inbox: self.inbox.clone(), source, ending: Arc::clone(&self.devices.ending) }
    }
}

/// Puts a device's events into the node's inbox, in order with the messages. Clones share one
/// source.
pub struct DeviceSender<I> {
    inbox: Arc<Inbox<I>>,
    source: SourceId,
    ending: Arc<AtomicBool>,
}

impl<I> Clone for DeviceSender<I> {
    fn clone(&self) -> Self {
        Self { inbox: self.inbox.clone(), source: self.source, ending: Arc::clone(&self.ending) }
    }
}

impl<I: Send + 'static> DeviceSender<I> {
    /// Puts an event into the inbox without waiting. Returns false when the node has ended and the
    /// device's thread should end too.
    pub fn send(&self, input: I) -> bool {
        self.inbox.put(self.source, Event::Input(input), now());
        self.is_open()
    }

    /// Counts data of the device that could not be used.
    pub fn refuse(&self) {
        self.inbox.refuse(self.source);
    }

    /// Returns whether the node still runs. A device's thread checks this at least every 0.2 s,
    /// because the end of the node waits for it.
    pub fn is_open(&self) -> bool {
        !self.ending.load(Ordering::Acquire) && !self.inbox.is_closed()
    }
}
