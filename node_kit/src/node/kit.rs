//! What a node is given to work with.

use super::{
    NodeError,
    clock::Clock,
    control::{Control, SharedState},
    diagnostics::Diagnostics,
    domain::{Domain, dds_type_name},
    hub::{Deliver, SubscriberGuard},
    logger::Logger,
    publisher::{Publisher, Publishing},
    reactor::Reactor,
    tf::Tf,
    wire::Shared,
};
use crate::{
    inbox::{Inbox, SourceId, now},
    level::Level,
    lifecycle::LifecycleState,
    names::{NodeName, Remap, resolve},
    parameters::{Change, ParameterMap, ParameterStore, ParameterValue},
    qos::{Endpoint, Qos, QosPreset},
};
use async_executor::Task;
use futures_lite::StreamExt;
use rig_model::{Rig, Stamp};
use rustdds::{
    QosPolicies, QosPolicyBuilder, Topic, TopicKind,
    policy::{Durability, History, Reliability, ResourceLimits},
};
use std::{
    collections::HashMap,
    fmt::Display,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError, Weak,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};
use volant_msgs::Message;

/// An entry of the node's inbox.
pub(crate) enum Event<I> {
    /// For the shell.
    Input(I),
    /// For the node itself.
    Control(Control),
    /// Time has moved: look at the timers.
    Wake,
}

/// A timer that becomes due again and again.
pub(crate) struct Timer<I> {
    period: Duration,
    make: Box<dyn FnMut() -> I + Send>,
    /// On the steady clock.
    pub(crate) next: Instant,
    /// On simulated time; set when that is first known.
    next_simulated: Option<Stamp>,
}

struct SubscriptionHandle<I> {
    inbox: Inbox<Event<I>>,
    source: SourceId,
    // Dropped before the source is retired, so that nothing is put in any more.
    parts: Option<(SubscriberGuard, Task<()>)>,
}

impl<I> Drop for SubscriptionHandle<I> {
    fn drop(&mut self) {
        self.parts = None;
        self.inbox.retire(self.source);
    }
}

/// What a node has: its topics, clock, log, parameters, timers and threads. It belongs to the node's own thread; what other
/// threads need ([`Publisher`], [`Logger`], [`DeviceSender`], [`Clock`]) is cloned out of it.
pub struct Kit<I: Send + 'static> {
    pub(crate) shell_subscriptions: Vec<SubscriptionOf<I>>,
    pub(crate) kit_subscriptions: Vec<SubscriptionOf<I>>,
    pub(crate) shell_services: Vec<Task<()>>,
    pub(crate) kit_services: Vec<Task<()>>,
    pub(crate) tf: Tf,
    pub(crate) diagnostics: Diagnostics,
    pub(crate) timers: Vec<Timer<I>>,
    pub(crate) publishers: Vec<Weak<dyn Publishing>>,
    devices: Vec<JoinHandle<()>>,
    device_sources: Vec<SourceId>,
    /// False when the devices of this start of the shell must end.
    devices_open: Arc<AtomicBool>,
    pub(crate) lifecycle: SharedState,
    pub(crate) ending: Option<Result<(), NodeError>>,
    pub(crate) inbox: Inbox<Event<I>>,
    pub(crate) store: Arc<Mutex<ParameterStore>>,
    active: Arc<AtomicBool>,
    always: Arc<AtomicBool>,
    pub(crate) name: NodeName,
    remaps: Vec<Remap>,
    clock: Clock,
    logger: Logger,
    pub(crate) reactor: Reactor,
    pub(crate) node: ros2_client::Node,
    pub(crate) domain: Arc<Domain>,
}

/// A subscription that the kit holds for the node.
pub(crate) struct SubscriptionOf<I>(#[allow(dead_code, reason = "held for its drop")] SubscriptionHandle<I>);

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

pub(crate) struct KitParts {
    pub name: NodeName,
    pub remaps: Vec<Remap>,
    pub store: ParameterStore,
    pub clock: Clock,
    pub logger: Logger,
    pub rosout: bool,
}

impl<I: Send + 'static> Kit<I> {
    pub(crate) fn new(
        domain: Arc<Domain>,
        inbox: Inbox<Event<I>>,
        parts: KitParts,
    ) -> Result<Self, NodeError> {
        let KitParts { name, remaps, store, clock, logger, rosout } = parts;
        let failed = |reason: String| NodeError::Middleware {
            what: format!("the node {}", name.fully_qualified()),
            reason,
        };
        let ros_name =
            ros2_client::NodeName::new(name.namespace(), name.base()).map_err(|e| failed(e.to_string()))?;
        // ros2-client's own parameter services speak one mapping only and know no descriptors; its /rosout has no bound.
        let options = ros2_client::NodeOptions::new()
            .enable_rosout(false)
            .start_parameter_services(false)
            .allow_undeclared_parameters(true);
        let node = domain.context.new_node(ros_name, options).map_err(|e| failed(e.to_string()))?;
        let reactor = Reactor::start(name.base())?;
        let mut kit = Self {
            shell_subscriptions: Vec::new(),
            kit_subscriptions: Vec::new(),
            shell_services: Vec::new(),
            kit_services: Vec::new(),
            tf: Tf::default(),
            diagnostics: Diagnostics::default(),
            timers: Vec::new(),
            publishers: Vec::new(),
            devices: Vec::new(),
            device_sources: Vec::new(),
            devices_open: Arc::new(AtomicBool::new(true)),
            lifecycle: SharedState::new(LifecycleState::Unconfigured),
            ending: None,
            inbox,
            store: Arc::new(Mutex::new(store)),
            active: Arc::new(AtomicBool::new(true)),
            always: Arc::new(AtomicBool::new(true)),
            name,
            remaps,
            clock,
            logger,
            reactor,
            node,
            domain,
        };
        if rosout {
            let publisher = kit.advertise_always("/rosout", ROSOUT)?;
            kit.logger.connect(publisher);
        }
        kit.connect_diagnostics()?;
        kit.follow_use_sim_time()?;
        Ok(kit)
    }

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
    ) -> Result<SubscriptionOf<I>, NodeError> {
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

    fn raw_subscription<M: Message>(
        &mut self,
        topic: &str,
        qos: Qos,
        expected: bool,
        take: impl Fn(SourceId, &str, &Arc<M>) + Send + Sync + 'static,
    ) -> Result<SubscriptionOf<I>, NodeError> {
        let name = self.resolve(topic)?;
        let qos = self.overridden(&name, qos, Endpoint::Subscription)?;
        let channel = self.domain.hub.channel::<M>(&name)?;
        let dds_topic = self.dds_topic::<M>(&name, &qos)?;
        let subscription = self.node.create_subscription::<M>(&dds_topic, None).map_err(|e| {
            NodeError::Middleware { what: format!("the subscription of {name}"), reason: e.to_string() }
        })?;
        let source = self.inbox.add_source(&name, qos.depth, expected);
        let state = Arc::clone(&channel.state);
        let inbox = self.inbox.clone();
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
                        inbox.refuse(source);
                        continue;
                    };
                    let writer = info.publisher_gid();
                    if state.own_writers.read().unwrap_or_else(PoisonError::into_inner).contains(&writer) {
                        continue;
                    }
                    if state.foreign_writers.read().unwrap_or_else(PoisonError::into_inner).contains(&writer)
                    {
                        inbox.refuse(source);
                        continue;
                    }
                    if latest.len() > 64 {
                        latest.clear();
                    }
                    let number = info.sequence_number();
                    if let Some(before) = latest.insert(writer, number)
                        && number > before + 1
                    {
                        inbox.lose(source, u64::try_from(number - before - 1).unwrap_or(0));
                    }
                    deliver(&Arc::new(message));
                }
            }
        });
        let guard = channel.subscribe(deliver, qos.transient_local);
        self.domain.refresh();
        Ok(SubscriptionOf(SubscriptionHandle {
            inbox: self.inbox.clone(),
            source,
            parts: Some((guard, task)),
        }))
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

    /// The absolute name of a topic or service after remaps.
    ///
    /// # Errors
    /// A name that cannot be.
    pub fn resolve(&self, name: &str) -> Result<String, NodeError> {
        Ok(resolve(&self.name, &self.remaps, name)?)
    }

    /// A place in the inbox for a device: at most `depth` of its events wait, the oldest is dropped for one more.
    pub fn device_sender(&mut self, name: &str, depth: usize) -> DeviceSender<I> {
        let source = self.inbox.add_source(name, depth, false);
        self.device_sources.push(source);
        DeviceSender { inbox: self.inbox.clone(), source, open: Arc::clone(&self.devices_open) }
    }

    /// Starts a named thread for a device. It must end soon after [`DeviceSender::is_open`] becomes false: the node's
    /// end waits for it.
    ///
    /// # Errors
    /// The system refuses the thread.
    pub fn spawn(&mut self, name: &str, work: impl FnOnce() + Send + 'static) -> Result<(), NodeError> {
        let thread = std::thread::Builder::new()
            .name(name.to_owned())
            .spawn(work)
            .map_err(|source| NodeError::System { what: format!("the thread {name}"), source })?;
        self.devices.push(thread);
        Ok(())
    }

    /// An input every `period`, of the node's clock (simulated where `use_sim_time` is set). A node that is late gets one
    /// for all that it missed.
    pub fn timer(&mut self, period: Duration, make: impl FnMut() -> I + Send + 'static) {
        let period = period.max(Duration::from_micros(100));
        self.timers.push(Timer { period, make: Box::new(make), next: now() + period, next_simulated: None });
    }

    /// Now, on the node's clock: for stamps.
    pub fn now(&self) -> Stamp {
        self.clock.now()
    }

    /// The node's clock, for other threads.
    pub fn clock(&self) -> Clock {
        self.clock.clone()
    }

    /// The node's log, for other threads.
    pub fn logger(&self) -> Logger {
        self.logger.clone()
    }

    /// Writes a line of the log.
    pub fn log(&self, level: Level, text: impl AsRef<str>) {
        self.logger.log(level, text);
    }

    /// Writes a line of the log, but not for the same `key` again within 5 s.
    pub fn log_throttled(&self, level: Level, key: &str, text: impl AsRef<str>) {
        self.logger.throttled(level, key, Duration::from_secs(5), text);
    }

    /// The node's name.
    pub fn name(&self) -> &NodeName {
        &self.name
    }

    /// The rig, from the node's parameters.
    ///
    /// # Errors
    /// A key that is missing or cannot be.
    pub fn rig(&self) -> Result<Rig, NodeError> {
        Ok(Rig::from_parameters(&self.parameter_values())?)
    }

    /// Every parameter that holds now.
    pub fn parameter_values(&self) -> ParameterMap {
        self.parameter_store().values().clone()
    }

    pub(crate) fn parameter_store(&self) -> MutexGuard<'_, ParameterStore> {
        lock_store(&self.store)
    }

    /// Ends the node for a reason: exit status 1 with this line.
    pub fn fail(&mut self, error: NodeError) {
        self.ending.get_or_insert(Err(error));
        self.inbox.close();
    }

    /// Ends the node because its work is done.
    pub fn finish(&mut self) {
        self.ending.get_or_insert(Ok(()));
        self.inbox.close();
    }

    /// Opens or shuts the node's gates: what comes in is kept or let go, what is published goes out or not.
    pub(crate) fn set_active(&mut self, active: bool) {
        self.active.store(active, Ordering::Release);
        self.inbox.set_accepting(active);
        if active {
            // Latched topics speak of what they were given meanwhile.
            self.publishers.iter().filter_map(Weak::upgrade).for_each(|p| p.retry());
            // Timers count from here.
            let now = now();
            for timer in &mut self.timers {
                (timer.next, timer.next_simulated) = (now + timer.period, None);
            }
        }
    }

    /// Ends the threads of devices and waits for them.
    pub(crate) fn end_devices(&mut self) {
        self.devices_open.store(false, Ordering::Release);
        for device in std::mem::take(&mut self.devices) {
            let _ = device.join();
        }
        self.device_sources.drain(..).for_each(|source| self.inbox.retire(source));
        self.devices_open = Arc::new(AtomicBool::new(true));
    }

    /// Forgets what the shell subscribed, offered and timed.
    pub(crate) fn forget_shell(&mut self) {
        self.shell_subscriptions.clear();
        self.shell_services.clear();
        self.timers.clear();
        self.tf = Tf::default();
        self.diagnostics.forget_shell();
    }

    /// Says on `/parameter_events` which parameters there are.
    pub(crate) fn announce_parameters(&self) {
        let all: Vec<Change> =
            self.parameter_values().into_iter().map(|(name, value)| Change { name, value }).collect();
        self.announce(&all);
    }

    /// Says changes on `/parameter_events`. ros2-client's own copy of the parameters serves for nothing else.
    pub(crate) fn announce(&self, changes: &[Change]) {
        use ros2_client::ParameterValue as R;
        for Change { name, value } in changes {
            let value = match value.clone() {
                ParameterValue::Bool(x) => R::Boolean(x),
                ParameterValue::Integer(x) => R::Integer(x),
                ParameterValue::Double(x) => R::Double(x),
                ParameterValue::String(x) => R::String(x),
                ParameterValue::BoolArray(x) => R::BooleanArray(x),
                ParameterValue::IntegerArray(x) => R::IntegerArray(x),
                ParameterValue::DoubleArray(x) => R::DoubleArray(x),
                ParameterValue::StringArray(x) => R::StringArray(x),
            };
            if let Err(reason) = self.node.set_parameter(name, value) {
                self.log(Level::Debug, format!("no event for the parameter {name}: {reason}"));
            }
        }
    }

    /// Takes up `/clock` where `use_sim_time` says so, or lets it go.
    pub(crate) fn follow_use_sim_time(&mut self) -> Result<(), NodeError> {
        use rig_model::parameters::ParameterValue::Bool;
        use volant_msgs::rosgraph_msgs::msg::Clock as ClockMessage;
        let simulated = matches!(self.parameter_store().get("use_sim_time"), Some(Bool(true)));
        self.clock.set_simulated(simulated);
        if !simulated {
            self.kit_subscriptions.clear();
        } else if self.kit_subscriptions.is_empty() {
            let (clock, inbox) = (self.clock.clone(), self.inbox.clone());
            let wake = inbox.add_control("clock", 1);
            let qos = Qos { reliable: false, transient_local: false, depth: 1, max_samples: 1 };
            let subscription =
                self.raw_subscription("/clock", qos, true, move |source, _, m: &Arc<ClockMessage>| {
                    clock.set(Stamp::from_sec_nanosec(m.clock.sec, m.clock.nanosec));
                    inbox.touch(source, now());
                    inbox.put(wake, Event::Wake, now());
                })?;
            self.kit_subscriptions.push(subscription);
        }
        Ok(())
    }

    /// When the loop must look at the timers next.
    pub(crate) fn next_timer(&self) -> Option<Instant> {
        // On simulated time each /clock message wakes the loop.
        if self.clock.is_simulated() { None } else { self.timers.iter().map(|t| t.next).min() }
    }

    /// An input from a timer that is due.
    pub(crate) fn due_timer(&mut self) -> Option<I> {
        let (steady, stamp, simulated) = (now(), self.clock.now(), self.clock.is_simulated());
        self.timers.iter_mut().find_map(|timer| {
            let due = if simulated {
                let next = *timer
                    .next_simulated
                    .get_or_insert_with(|| stamp.plus_seconds(timer.period.as_secs_f64()));
                // A jump back in time (a bag that loops) starts the period anew.
                let jumped = next.seconds_since(stamp) > timer.period.as_secs_f64();
                let due = stamp >= next;
                if due || jumped {
                    timer.next_simulated = Some(stamp.plus_seconds(timer.period.as_secs_f64()));
                }
                due
            } else {
                let due = steady >= timer.next;
                if due {
                    // In step with the first time, skipping what was missed.
                    let missed = steady.duration_since(timer.next).as_nanos() / timer.period.as_nanos();
                    let steps = u32::try_from(missed).unwrap_or(u32::MAX - 1) + 1;
                    timer.next = timer
                        .period
                        .checked_mul(steps)
                        .and_then(|d| timer.next.checked_add(d))
                        .unwrap_or(steady + timer.period);
                }
                due
            };
            due.then(|| (timer.make)())
        })
    }
}

pub(crate) fn lock_store(store: &Mutex<ParameterStore>) -> MutexGuard<'_, ParameterStore> {
    store.lock().unwrap_or_else(PoisonError::into_inner)
}

/// rclcpp's, but for the bound.
const ROSOUT: Qos = Qos { reliable: true, transient_local: true, depth: 100, max_samples: 100 };

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
