//! What a node is given to work with.

use super::{
    NodeError,
    control::Control,
    diagnostics::Health,
    domain::Domain,
    handle::{KitParts, NodeHandle},
    timers::Timer,
};
use crate::inbox::{Inbox, SourceId, now};
use std::{
    ops::{Deref, DerefMut},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};
use volant_msgs::geometry_msgs::msg::TransformStamped;

/// An entry of the node's inbox.
pub(crate) enum Event<I> {
    /// For the shell.
    Input(I),
    /// For the node itself.
    Control(Control),
    /// Time has moved: look at the timers.
    Wake,
}

/// What a node has: its topics, clock, log, parameters, timers and threads; most of it is a [`NodeHandle`]'s. It belongs to the
/// node's own thread; what other threads need ([`Publisher`](super::Publisher), [`Logger`](super::Logger), [`DeviceSender`],
/// [`Clock`](super::Clock)) is cloned out of it.
pub struct Kit<I: Send + 'static> {
    handle: NodeHandle,
    pub(crate) timers: Vec<Timer<I>>,
    pub(crate) inbox: Inbox<Event<I>>,
}

impl<I: Send + 'static> Deref for Kit<I> {
    type Target = NodeHandle;

    fn deref(&self) -> &NodeHandle {
        &self.handle
    }
}

impl<I: Send + 'static> DerefMut for Kit<I> {
    fn deref_mut(&mut self) -> &mut NodeHandle {
        &mut self.handle
    }
}

/// Puts a device's events into the node's inbox, in order with the messages. Clones share one place in it.
pub struct DeviceSender<I> {
    inbox: Inbox<Event<I>>,
    source: SourceId,
    open: Arc<AtomicBool>,
}

impl<I> Clone for DeviceSender<I> {
    fn clone(&self) -> Self {
        Self { inbox: self.inbox.clone(), source: self.source, open: Arc::clone(&self.open) }
    }
}

impl<I> DeviceSender<I> {
    /// Hands an event over; never waits. `false` when the node has ended and the device's thread should too.
    pub fn send(&self, input: I) -> bool {
        self.inbox.put(self.source, Event::Input(input), now());
        self.is_open()
    }

    /// Counts something that came from the device and could not be used.
    pub fn refuse(&self) {
        self.inbox.refuse(self.source);
    }

    /// Does the node still run? A device's thread looks at least every 0.2 s, or the node's end waits for it.
    pub fn is_open(&self) -> bool {
        self.open.load(Ordering::Acquire) && !self.inbox.is_closed()
    }
}

// What takes `&mut self` and is often given something of the node itself, such as its time: through `deref_mut` the borrows would
// clash.
impl<I: Send + 'static> Kit<I> {
    pub(crate) fn new(
        domain: Arc<Domain>,
        inbox: Inbox<Event<I>>,
        parts: KitParts,
    ) -> Result<Self, NodeError> {
        let handle = NodeHandle::new(domain, Arc::new(inbox.clone()), parts)?;
        Ok(Self { handle, timers: Vec::new(), inbox })
    }

    /// A place in the inbox for a device: at most `depth` of its events wait, the oldest is dropped for one more.
    pub fn device_sender(&mut self, name: &str, depth: usize) -> DeviceSender<I> {
        let source = self.inbox.add_source(name, depth, false);
        self.device_sources.push(source);
        DeviceSender { inbox: self.inbox.clone(), source, open: Arc::clone(&self.devices_open) }
    }

    /// [`NodeHandle::diagnose`].
    pub fn diagnose(&mut self, name: &str, health: Health, message: &str, values: &[(&str, String)]) {
        self.handle.diagnose(name, health, message, values);
    }

    /// [`NodeHandle::send_transform`].
    ///
    /// # Errors
    /// Its own.
    pub fn send_transform(&mut self, transform: TransformStamped) -> Result<(), NodeError> {
        self.handle.send_transform(transform)
    }

    /// [`NodeHandle::send_static_transform`].
    ///
    /// # Errors
    /// Its own.
    pub fn send_static_transform(&mut self, transform: TransformStamped) -> Result<(), NodeError> {
        self.handle.send_static_transform(transform)
    }

    /// Opens or shuts the node's gates: what comes in is kept or let go, what is published goes out or not.
    pub(crate) fn set_active(&mut self, active: bool) {
        self.handle.set_active(active);
        if active {
            // Timers count from here.
            let now = now();
            for timer in &mut self.timers {
                (timer.next, timer.next_simulated) = (now + timer.period, None);
            }
        }
    }

    /// Forgets what the shell subscribed, offered and timed.
    pub(crate) fn forget_shell(&mut self) {
        self.handle.forget_shell();
        self.timers.clear();
    }
}
