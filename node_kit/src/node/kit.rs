//! What a node is given to work with.

use super::{
    NodeError,
    clock::Clock,
    control::{Control, SharedState},
    diagnostics::Diagnostics,
    domain::Domain,
    logger::Logger,
    publisher::Publishing,
    reactor::Reactor,
    tf::Tf,
    timers::Timer,
    topics::SubscriptionOf,
};
use crate::{
    inbox::{Inbox, SourceId, now},
    level::Level,
    lifecycle::LifecycleState,
    names::{NodeName, Remap, resolve},
    parameters::{Change, ParameterMap, ParameterStore, ParameterValue},
    qos::Qos,
};
use async_executor::Task;
use rig_model::{Rig, Stamp};
use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError, Weak,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};

/// An entry of the node's inbox.
pub(crate) enum Event<I> {
    /// For the shell.
    Input(I),
    /// For the node itself.
    Control(Control),
    /// Time has moved: look at the timers.
    Wake,
}

/// What a node has: its topics, clock, log, parameters, timers and threads. It belongs to the node's own thread; what other
/// threads need ([`Publisher`](super::Publisher), [`Logger`], [`DeviceSender`], [`Clock`]) is cloned out of it.
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
    pub(super) active: Arc<AtomicBool>,
    pub(super) always: Arc<AtomicBool>,
    pub(crate) name: NodeName,
    remaps: Vec<Remap>,
    pub(super) clock: Clock,
    pub(super) logger: Logger,
    pub(crate) reactor: Reactor,
    pub(crate) node: ros2_client::Node,
    pub(crate) domain: Arc<Domain>,
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
}

pub(crate) fn lock_store(store: &Mutex<ParameterStore>) -> MutexGuard<'_, ParameterStore> {
    store.lock().unwrap_or_else(PoisonError::into_inner)
}

/// rclcpp's, but for the bound.
const ROSOUT: Qos = Qos { reliable: true, transient_local: true, depth: 100, max_samples: 100 };
