//! What a node has that does not depend on what comes to it.

use super::{
    NodeError,
    clock::Clock,
    control::{Control, SharedState},
    diagnostics::Diagnostics,
    domain::Domain,
    kit::Event,
    logger::Logger,
    publisher::Publishing,
    reactor::Reactor,
    tf::Tf,
    topics::Subscription,
};
use crate::{
    inbox::{Inbox, SourceCount, SourceId, now},
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

/// What a node has that does not depend on its inputs: publishers, services, clock, log, parameters, threads. A
/// [`Kit`](super::Kit) is one with inputs, and derefs to it.
///
/// It is apart from the kit so that its code, with all that middleware behind it, is compiled once and not in each executable.
pub struct NodeHandle {
    pub(crate) shell_subscriptions: Vec<Subscription>,
    pub(crate) kit_subscriptions: Vec<Subscription>,
    pub(crate) shell_services: Vec<Task<()>>,
    pub(crate) kit_services: Vec<Task<()>>,
    pub(crate) tf: Tf,
    pub(crate) diagnostics: Diagnostics,
    pub(crate) publishers: Vec<Weak<dyn Publishing>>,
    devices: Vec<JoinHandle<()>>,
    pub(super) device_sources: Vec<SourceId>,
    /// False when the devices of this start of the shell must end.
    pub(super) devices_open: Arc<AtomicBool>,
    pub(crate) lifecycle: SharedState,
    pub(crate) ending: Option<Result<(), NodeError>>,
    pub(crate) sources: Arc<dyn Sources>,
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

pub(crate) struct KitParts {
    pub name: NodeName,
    pub remaps: Vec<Remap>,
    pub store: ParameterStore,
    pub clock: Clock,
    pub logger: Logger,
    pub rosout: bool,
}

impl NodeHandle {
    pub(crate) fn new(
        domain: Arc<Domain>,
        sources: Arc<dyn Sources>,
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
        let mut handle = Self {
            shell_subscriptions: Vec::new(),
            kit_subscriptions: Vec::new(),
            shell_services: Vec::new(),
            kit_services: Vec::new(),
            tf: Tf::default(),
            diagnostics: Diagnostics::default(),
            publishers: Vec::new(),
            devices: Vec::new(),
            device_sources: Vec::new(),
            devices_open: Arc::new(AtomicBool::new(true)),
            lifecycle: SharedState::new(LifecycleState::Unconfigured),
            ending: None,
            sources,
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
            let publisher = handle.advertise_always("/rosout", ROSOUT)?;
            handle.logger.connect(publisher);
        }
        handle.connect_diagnostics()?;
        handle.follow_use_sim_time()?;
        Ok(handle)
    }

    /// The absolute name of a topic or service after remaps.
    ///
    /// # Errors
    /// A name that cannot be.
    pub fn resolve(&self, name: &str) -> Result<String, NodeError> {
        Ok(resolve(&self.name, &self.remaps, name)?)
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
        self.sources.close();
    }

    /// Ends the node because its work is done.
    pub fn finish(&mut self) {
        self.ending.get_or_insert(Ok(()));
        self.sources.close();
    }

    /// Opens or shuts the node's gates: what comes in is kept or let go, what is published goes out or not.
    pub(crate) fn set_active(&mut self, active: bool) {
        self.active.store(active, Ordering::Release);
        self.sources.set_accepting(active);
        if active {
            // Latched topics speak of what they were given meanwhile.
            self.publishers.iter().filter_map(Weak::upgrade).for_each(|p| p.retry());
        }
    }

    /// Ends the threads of devices and waits for them.
    pub(crate) fn end_devices(&mut self) {
        self.devices_open.store(false, Ordering::Release);
        for device in std::mem::take(&mut self.devices) {
            let _ = device.join();
        }
        self.device_sources.drain(..).for_each(|source| self.sources.retire(source));
        self.devices_open = Arc::new(AtomicBool::new(true));
    }

    /// Forgets what the shell subscribed, offered and timed.
    pub(crate) fn forget_shell(&mut self) {
        self.shell_subscriptions.clear();
        self.shell_services.clear();
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
