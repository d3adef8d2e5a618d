//! A node's subscriptions and publishers.

use super::{
    NodeError,
    domain::dds_type_name,
    handle::{NodeHandle, Sources},
    hub::{Deliver, SubscriberGuard},
    kit::{Event, Kit},
    publisher::Publisher,
    wire::Shared,
};
use crate::{
    inbox::{SourceId, now},
    level::Level,
    qos::{Endpoint, Qos, QosPreset},
};
use async_executor::Task;
use futures_lite::StreamExt;
use rustdds::{
    QosPolicies, QosPolicyBuilder, Topic, TopicKind,
    policy::{Durability, History, Reliability, ResourceLimits},
};
use std::{
    collections::HashMap,
    fmt::Display,
    sync::{Arc, PoisonError, atomic::AtomicBool},
    time::Duration,
};
use volant_msgs::Message;

/// A subscription that the kit holds for the node; it ends when it drops.
pub(crate) struct Subscription {
    sources: Arc<dyn Sources>,
    source: SourceId,
    // Dropped before the source is retired, so that nothing is put in any more.
    parts: Option<(SubscriberGuard, Task<()>)>,
}

impl Drop for Subscription {
    fn drop(&mut self) {
        self.parts = None;
        self.sources.retire(self.source);
    }
}

/// What a subscription's closure may return.
pub trait IntoInput<I> {
    /// The input, or why there is none (an empty text says nothing).
    fn into_input(self) -> Result<I, String>;
}

impl<I> IntoInput<I> for Option<I> {
    fn into_input(self) -> Result<I, String> {
        self.ok_or_else(String::new)
    }
}

impl<I, E: Display> IntoInput<I> for Result<I, E> {
    fn into_input(self) -> Result<I, String> {
        self.map_err(|e| e.to_string())
    }
}

impl<I: Send + 'static> Kit<I> {
    /// Subscribes. `make` turns each message into an input of the node, on the thread that brought it, and must be
    /// quick; `None` or an error refuses it, which is counted (and an error is logged, at most once in 5 s).
    ///
    /// The diagnostics name the topic while nothing comes on it.
    ///
    /// # Errors
    /// A name or an override of its QoS that cannot be, a topic of another type in this process, or DDS's refusal.
    pub fn subscribe<M: Message, R: IntoInput<I>>(
        &mut self,
        topic: &str,
        preset: QosPreset,
        make: impl Fn(Arc<M>) -> R + Send + Sync + 'static,
    ) -> Result<(), NodeError> {
        let subscription = self.make_subscription(topic, preset, true, make)?;
        self.shell_subscriptions.push(subscription);
        Ok(())
    }

    /// [`Kit::subscribe`] to a topic that need not be there: the diagnostics do not miss it.
    ///
    /// # Errors
    /// As [`Kit::subscribe`].
    pub fn subscribe_optional<M: Message, R: IntoInput<I>>(
        &mut self,
        topic: &str,
        preset: QosPreset,
        make: impl Fn(Arc<M>) -> R + Send + Sync + 'static,
    ) -> Result<(), NodeError> {
        let subscription = self.make_subscription(topic, preset, false, make)?;
        self.shell_subscriptions.push(subscription);
        Ok(())
    }

    fn make_subscription<M: Message, R: IntoInput<I>>(
        &mut self,
        topic: &str,
        preset: QosPreset,
        expected: bool,
        make: impl Fn(Arc<M>) -> R + Send + Sync + 'static,
    ) -> Result<Subscription, NodeError> {
        if preset == QosPreset::Image {
            self.domain.check_socket_buffers(&self.logger);
        }
        let logger = self.logger.clone();
        let inbox = self.inbox.clone();
        self.raw_subscription(topic, preset.qos(Endpoint::Subscription), expected, move |source, name, m| {
            match make(Arc::clone(m)).into_input() {
                Ok(input) => inbox.put(source, Event::Input(input), now()),
                Err(reason) => {
                    inbox.refuse(source);
                    if !reason.is_empty() {
                        logger.throttled(
                            Level::Warn,
                            name,
                            Duration::from_secs(5),
                            format!("a message on {name} is refused: {reason}"),
                        );
                    }
                }
            }
        })
    }
}

impl NodeHandle {
    pub(super) fn raw_subscription<M: Message>(
        &mut self,
        topic: &str,
        qos: Qos,
        expected: bool,
        take: impl Fn(SourceId, &str, &Arc<M>) + Send + Sync + 'static,
    ) -> Result<Subscription, NodeError> {
        let name = self.resolve(topic)?;
        let qos = self.overridden(&name, qos, Endpoint::Subscription)?;
        let channel = self.domain.hub.channel::<M>(&name)?;
        let dds_topic = self.dds_topic::<M>(&name, &qos)?;
        let subscription = self.node.create_subscription::<M>(&dds_topic, None).map_err(|e| {
            NodeError::Middleware { what: format!("the subscription of {name}"), reason: e.to_string() }
        })?;
        let source = self.sources.add_source(&name, qos.depth, expected);
        let state = Arc::clone(&channel.state);
        let sources = Arc::clone(&self.sources);
        let deliver: Deliver<M> = {
            let name = name.clone();
            Arc::new(move |message| take(source, &name, message))
        };
        let task = self.reactor.spawn({
            let deliver = Arc::clone(&deliver);
            async move {
                let mut stream = std::pin::pin!(subscription.async_stream());
                let mut latest: HashMap<ros2_client::Gid, i64> = HashMap::new();
                while let Some(received) = stream.next().await {
                    let Ok((message, info)) = received else {
                        sources.refuse(source);
                        continue;
                    };
                    let writer = info.publisher_gid();
                    if state.own_writers.read().unwrap_or_else(PoisonError::into_inner).contains(&writer) {
                        continue;
                    }
                    if state.foreign_writers.read().unwrap_or_else(PoisonError::into_inner).contains(&writer)
                    {
                        sources.refuse(source);
                        continue;
                    }
                    if latest.len() > 64 {
                        latest.clear();
                    }
                    let number = info.sequence_number();
                    if let Some(before) = latest.insert(writer, number)
                        && number > before + 1
                    {
                        sources.lose(source, u64::try_from(number - before - 1).unwrap_or(0));
                    }
                    deliver(&Arc::new(message));
                }
            }
        });
        let guard = channel.subscribe(deliver, qos.transient_local);
        self.domain.refresh();
        Ok(Subscription { sources: Arc::clone(&self.sources), source, parts: Some((guard, task)) })
    }

    /// Advertises. The publisher is the shell's to keep; it ends when it drops.
    ///
    /// # Errors
    /// A name or an override of its QoS that cannot be, a topic of another type in this process, or DDS's refusal.
    pub fn advertise<M: Message>(
        &mut self,
        topic: &str,
        preset: QosPreset,
    ) -> Result<Publisher<M>, NodeError> {
        let active = Arc::clone(&self.active);
        self.make_publisher(topic, preset.qos(Endpoint::Publisher), active)
    }

    /// A publisher that speaks while the node is inactive too: what the kit itself has to say.
    pub(crate) fn advertise_always<M: Message>(
        &mut self,
        topic: &str,
        qos: Qos,
    ) -> Result<Publisher<M>, NodeError> {
        let always = Arc::clone(&self.always);
        self.make_publisher(topic, qos, always)
    }

    fn make_publisher<M: Message>(
        &mut self,
        topic: &str,
        qos: Qos,
        active: Arc<AtomicBool>,
    ) -> Result<Publisher<M>, NodeError> {
        let name = self.resolve(topic)?;
        let qos = self.overridden(&name, qos, Endpoint::Publisher)?;
        let channel = self.domain.hub.channel::<M>(&name)?;
        let dds_topic = self.dds_topic::<M>(&name, &qos)?;
        let writer = self.node.create_publisher::<Shared<M>>(&dds_topic, None).map_err(|e| {
            NodeError::Middleware { what: format!("the publisher of {name}"), reason: e.to_string() }
        })?;
        let publisher = Publisher::new(name, qos, channel, writer, active);
        self.publishers.push(publisher.weak());
        self.domain.refresh();
        Ok(publisher)
    }

    fn dds_topic<M: Message>(&self, name: &str, qos: &Qos) -> Result<Topic, NodeError> {
        self.domain
            .context
            .domain_participant()
            .create_topic(format!("rt{name}"), dds_type_name(M::TYPE_NAME), &policies(qos), TopicKind::NoKey)
            .map_err(|e| NodeError::Middleware { what: format!("the topic {name}"), reason: e.to_string() })
    }

    /// The QoS with what the parameters `qos_overrides.…` say.
    fn overridden(&mut self, topic: &str, mut qos: Qos, endpoint: Endpoint) -> Result<Qos, NodeError> {
        let mut store = self.parameter_store();
        for descriptor in qos.descriptors(topic, endpoint) {
            let name = descriptor.name.clone();
            if let Some(value) = store.declare_if_given(descriptor)? {
                qos = qos.with(&name, &value);
            }
        }
        Ok(qos)
    }
}

pub(crate) fn policies(qos: &Qos) -> QosPolicies {
    let count = |n: usize| i32::try_from(n).unwrap_or(i32::MAX);
    QosPolicyBuilder::new()
        .reliability(if qos.reliable {
            // Zero: a full window refuses at once. Waiting would hold up the sensor's loop.
            Reliability::Reliable { max_blocking_time: rustdds::Duration::ZERO }
        } else {
            Reliability::BestEffort
        })
        .durability(if qos.transient_local { Durability::TransientLocal } else { Durability::Volatile })
        .history(History::KeepLast { depth: count(qos.depth) })
        .resource_limits(ResourceLimits {
            max_samples: count(qos.max_samples),
            max_instances: 1,
            max_samples_per_instance: count(qos.max_samples),
        })
        .build()
}
