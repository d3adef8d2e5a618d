//! What a node works with.

use super::{
    domain::Domain,
    error::NodeError,
    handle::{NodeHandle, NodeParts},
    service::Responder,
    timers::Timers,
};
use crate::{
    inbox::{Event, Inbox, SourceKind, Sources, now},
    level::Level,
    qos::{Endpoint, QosPreset},
};
use std::{
    fmt::Display,
    ops::{Deref, DerefMut},
    sync::Arc,
    time::{Duration, Instant},
};
use volant_msgs::{Message, Service};

/// What a node works with: its topics, clock, log, parameters, timers and device threads; most of
/// it is a [`NodeHandle`]'s.
///
/// It belongs to the node's own thread. What other threads need
/// ([`Publisher`](super::Publisher), [`Logger`](super::Logger),
/// [`DeviceSender`](super::DeviceSender), [`Clock`](super::Clock)) is cloned out of it.
pub struct NodeContext<I: Send + 'static> {
    handle: NodeHandle,
    timers: Timers<I>,
    pub(crate) inbox: Arc<Inbox<I>>,
}

impl<I: Send + 'static> Deref for NodeContext<I> {
    type Target = NodeHandle;

    fn deref(&self) -> &NodeHandle {
        &self.handle
    }
}

impl<I: Send + 'static> DerefMut for NodeContext<I> {
    fn deref_mut(&mut self) -> &mut NodeHandle {
        &mut self.handle
    }
}

/// Result of a subscription's closure.
pub trait IntoInput<I> {
    /// Returns the input; `None` for a message that is only counted.
    ///
    /// # Errors
    /// Why the message is rejected; an empty text is not logged.
    fn into_input(self) -> Result<Option<I>, String>;
}

impl<I> IntoInput<I> for Option<I> {
    fn into_input(self) -> Result<Option<I>, String> {
        self.map(Some).ok_or_else(String::new)
    }
}

impl<I, E: Display> IntoInput<I> for Result<I, E> {
    fn into_input(self) -> Result<Option<I>, String> {
        self.map(Some).map_err(|e| e.to_string())
    }
}

/// The input of a message that changes something; others are only counted.
#[derive(Debug)]
pub struct IfChanged<R>(pub Option<R>);

impl<I, R: IntoInput<I>> IntoInput<I> for IfChanged<R> {
    fn into_input(self) -> Result<Option<I>, String> {
        self.0.map_or(Ok(None), R::into_input)
    }
}

impl<I: Send + 'static> NodeContext<I> {
    pub(crate) fn new(
        domain: Arc<Domain>,
        inbox: Arc<Inbox<I>>,
        parts: NodeParts,
    ) -> Result<Self, NodeError> {
        let handle = NodeHandle::new(domain, inbox.clone(), parts)?;
        Ok(Self { handle, timers: Timers::default(), inbox })
    }

    /// Subscribes to a topic. `make` turns each message into an input of the node, on the thread
    /// that received it, and must be quick. A message for which it returns `None` or an error is
    /// counted as refused; errors are logged at most once in 5 s.
    ///
    /// The diagnostics report the topic as missing while nothing arrives on it.
    ///
    /// # Errors
    /// An invalid name or override of the QoS, a topic of another type in this process, or an error
    /// of DDS.
    pub fn subscribe<M: Message, R: IntoInput<I>>(
        &mut self,
        topic: &str,
        preset: QosPreset,
        make: impl Fn(Arc<M>) -> R + Send + Sync + 'static,
    ) -> Result<(), NodeError> {
        self.make_subscription(topic, preset, SourceKind::Expected, make)
    }

    /// Subscribes like [`NodeContext::subscribe`], without a report while the topic is missing.
    ///
    /// # Errors
    /// As [`NodeContext::subscribe`].
    pub fn subscribe_optional<M: Message, R: IntoInput<I>>(
        &mut self,
        topic: &str,
        preset: QosPreset,
        make: impl Fn(Arc<M>) -> R + Send + Sync + 'static,
    ) -> Result<(), NodeError> {
        self.make_subscription(topic, preset, SourceKind::Optional, make)
    }

    /// Ends the subscriptions of a topic, with the messages that wait or were received in part.
    pub fn unsubscribe(&mut self, topic: &str) {
        if let Ok(name) = self.resolve(topic) {
            self.shell.subscriptions.retain(|s| s.topic != name);
        }
    }

    fn make_subscription<M: Message, R: IntoInput<I>>(
        &mut self,
        topic: &str,
        preset: QosPreset,
        kind: SourceKind,
        make: impl Fn(Arc<M>) -> R + Send + Sync + 'static,
    ) -> Result<(), NodeError> {
        let (logger, inbox) = (self.logger(), self.inbox.clone());
        if preset == QosPreset::Image {
            self.endpoints.domain.check_socket_buffers(&logger);
        }
        let subscription = self.endpoints.subscribe(
            topic,
            preset.qos(Endpoint::Subscription),
            kind,
            move |source, name, m| match make(Arc::clone(m)).into_input() {
                Ok(Some(input)) => inbox.put(source, Event::Input(input), now()),
                Ok(None) => inbox.touch(source),
                Err(reason) => {
                    inbox.refuse(source);
                    if !reason.is_empty() {
                        logger.throttled(
                            Level::Warn,
                            name,
                            Duration::from_secs(5),
                            format!("a message on {name} is rejected: {reason}"),
                        );
                    }
                }
            },
        )?;
        self.shell.subscriptions.push(subscription);
        Ok(())
    }

    /// Offers a service. `make` turns a request and its [`Responder`] into an input of the node. At
    /// most 16 requests wait; one more drops the oldest.
    ///
    /// # Errors
    /// An invalid name, or an error of DDS.
    pub fn serve<S: Service>(
        &mut self,
        name: &str,
        make: impl Fn(S::Request, Responder<S>) -> I + Send + Sync + 'static,
    ) -> Result<(), NodeError> {
        let inbox = self.inbox.clone();
        let source =
            inbox.add_source(&self.endpoints.resolve_service(name)?, 16, SourceKind::Service);
        self.shell.sources.push(source);
        let service = self.endpoints.serve::<S, _>(name, move |request| {
            let (responder, response) = Responder::new();
            inbox.put(source, Event::Input(make(request, responder)), now());
            async move { response.recv().await.ok() }
        })?;
        self.shell.services.push(service);
        Ok(())
    }

    /// Yields an input every `period` of the node's clock (simulated time with `use_sim_time`). A
    /// node that is late gets one input for all missed periods.
    pub fn timer(&mut self, period: Duration, make: impl FnMut() -> I + Send + 'static) {
        self.timers.add(period, make);
    }

    pub(crate) fn next_timer(&self) -> Option<Instant> {
        self.timers.next(&self.clock)
    }

    pub(crate) fn due_timers(&mut self) -> Vec<I> {
        self.timers.due(&self.handle.clock)
    }

    /// Activates or deactivates the node's inputs, publishers and timers.
    pub(crate) fn set_active(&mut self, active: bool) {
        self.handle.set_active(active);
        if active {
            self.timers.restart();
        }
    }

    /// Ends everything that the shell subscribed, offered and timed.
    pub(crate) fn clear_shell(&mut self) {
        self.handle.clear_shell();
        self.timers.clear();
    }
}
