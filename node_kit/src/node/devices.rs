//! Threads of a node's devices, and how they hand events to the node.

use super::error::NodeError;
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

impl Devices {
    pub fn spawn(
        &mut self,
        name: &str,
        work: impl FnOnce() + Send + 'static,
    ) -> Result<(), NodeError> {
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(work)
            .map_err(|error| NodeError::System { what: format!("the thread {name}"), error })?;
        self.threads.push(thread);
        Ok(())
    }

    pub fn sender<I: Send + 'static>(
        &mut self,
        inbox: &Arc<Inbox<I>>,
        name: &str,
        depth: usize,
    ) -> DeviceSender<I> {
        let source = inbox.add_source(name, depth, SourceKind::Optional);
        self.sources.push(source);
        DeviceSender { inbox: inbox.clone(), source, ending: Arc::clone(&self.ending) }
    }

    /// Ends the threads, waits for them and retires their sources.
    pub fn end(&mut self, inbox: &dyn Sources) {
        let Self { threads, sources, ending } = std::mem::take(self);
        ending.store(true, Ordering::Release);
        for thread in threads {
            let _ = thread.join();
        }
        sources.into_iter().for_each(|source| inbox.retire(source));
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
