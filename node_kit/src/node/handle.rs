//! The part of a node's context that does not depend on the node's inputs.

use super::{
    clock::Clock,
    control_services::{self, SharedState},
    devices::Devices,
    diagnostics::Diagnostics,
    domain::Domain,
    endpoints::Endpoints,
    error::NodeError,
    logger::Logger,
    publisher::Publisher,
    service::OfferedService,
    subscription::Subscription,
    tf::Transforms,
};
use crate::{
    convert,
    inbox::{Control, SourceId, SourceKind, Sources},
    level::Level,
    lifecycle::LifecycleState,
    names::{NodeName, Remap},
    parameters::{CommonParameters, ParameterSet, ParameterStore, ParameterValue},
    qos::{Endpoint, Qos, QosPreset},
};
use parking_lot::{Mutex, MutexGuard};
use rig_model::{Rig, Stamp, topics};
use std::{
    sync::{Arc, Weak, atomic::Ordering},
    time::Duration,
};
use volant_msgs::{Message, rosgraph_msgs::msg::Clock as ClockMessage};

/// Subscriptions and services of one owner; they end when it drops.
#[derive(Default)]
pub(crate) struct Held {
    pub subscriptions: Vec<Subscription>,
    pub services: Vec<OfferedService>,
    /// Inbox sources of the services, and of the wake-ups by `/clock`.
    pub sources: Vec<SourceId>,
}

/// The part of a node's context that does not depend on the node's inputs: publishers, clock, log,
/// parameters, transforms, diagnostics, device threads.
///
/// A [`NodeContext`](super::NodeContext) is one with inputs and dereferences to it. The two are
/// apart so that this code, with the middleware behind it, is compiled once and not in each
/// executable.
pub struct NodeHandle {
    /// Of the shell; dropped when it is cleaned up.
    pub(crate) shell: Held,
    /// Of the node itself: parameters, lifecycle, `/clock`.
    own: Held,
    pub(super) transforms: Transforms,
    pub(crate) diagnostics: Diagnostics,
    pub(crate) devices: Devices,
    pub(crate) lifecycle: SharedState,
    pub(crate) ending: Option<Result<(), NodeError>>,
    pub(crate) clock: Clock,
    pub(crate) endpoints: Endpoints,
}

/// Names, parameters and log of a node that is to be created.
pub(crate) struct NodeParts {
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
        parts: NodeParts,
    ) -> Result<Self, NodeError> {
        let NodeParts { name, remaps, store, clock, logger, rosout } = parts;
        let mut endpoints = Endpoints::new(domain, sources, name, remaps, store, logger)?;
        if rosout {
            let publisher = endpoints.advertise_always(topics::absolute::ROSOUT, ROSOUT)?;
            endpoints.logger.connect(publisher);
        }
        let mut handle = Self {
            shell: Held::default(),
            own: Held::default(),
            transforms: Transforms::default(),
            diagnostics: Diagnostics::new(&mut endpoints)?,
            devices: Devices::default(),
            lifecycle: Arc::new(Mutex::new(LifecycleState::Unconfigured)),
            ending: None,
            clock,
            endpoints,
        };
        handle.follow_use_sim_time()?;
        Ok(handle)
    }

    /// Advertises a topic, which is silent while the node is inactive. The shell keeps the
    /// publisher; the topic ends when the last clone drops.
    ///
    /// # Errors
    /// An invalid name or override of the QoS, a topic of another type in this process, or an error
    /// of DDS.
    pub fn advertise<M: Message>(
        &mut self,
        topic: &str,
        preset: QosPreset,
    ) -> Result<Publisher<M>, NodeError> {
        let active = Arc::clone(&self.endpoints.active);
        self.endpoints.advertise_while(topic, preset.qos(Endpoint::Publisher), active)
    }

    /// Absolute name of a topic after remaps.
    ///
    /// # Errors
    /// An invalid name.
    pub fn resolve(&self, name: &str) -> Result<String, NodeError> {
        self.endpoints.resolve(name)
    }

    /// The process's participant, for publishers of bytes; [`NodeHandle::announce_writer`] makes
    /// them this node's.
    pub fn participant(&self) -> rustdds::DomainParticipant {
        self.endpoints.domain.context.domain_participant()
    }

    /// Announces a publisher of the participant as this node's.
    pub fn announce_writer(&mut self, writer: rustdds::GUID) {
        self.endpoints.node.lock().add_writer(writer.into());
    }

    /// Time of the node's clock, for stamps.
    pub fn now(&self) -> Stamp {
        self.clock.now()
    }

    /// The node's clock, for other threads.
    pub fn clock(&self) -> Clock {
        self.clock.clone()
    }

    /// The node's log, for other threads.
    pub fn logger(&self) -> Logger {
        self.endpoints.logger.clone()
    }

    /// Writes a line of the log.
    #[track_caller]
    pub fn log(&self, level: Level, text: impl AsRef<str>) {
        self.endpoints.logger.log(level, text);
    }

    /// Writes a line of the log, at most once per `key` in 5 s.
    #[track_caller]
    pub fn log_throttled(&self, level: Level, key: &str, text: impl AsRef<str>) {
        self.endpoints.logger.throttled(level, key, Duration::from_secs(5), text);
    }

    /// The node's name.
    pub fn name(&self) -> &NodeName {
        &self.endpoints.name
    }

    /// The rig, from the node's parameters.
    ///
    /// # Errors
    /// A key that is missing or invalid.
    pub fn rig(&self) -> Result<Rig, NodeError> {
        Rig::from_parameters(self.parameter_store().values()).map_err(|error| {
            NodeError::shell(format!("{error} (rig file: `--ros-args --params-file rig.yaml`)"))
        })
    }

    /// Ends the node for a reason: exit status 1 with this line.
    pub fn fail(&mut self, error: NodeError) {
        self.ending.get_or_insert(Err(error));
        self.endpoints.sources.close();
    }

    /// Ends the node because its work is done.
    pub fn finish(&mut self) {
        self.ending.get_or_insert(Ok(()));
        self.endpoints.sources.close();
    }

    pub(crate) fn parameter_store(&self) -> MutexGuard<'_, ParameterStore> {
        self.endpoints.store.lock()
    }

    /// Offers the parameter and lifecycle services.
    pub(crate) fn offer_control(&mut self) -> Result<(), NodeError> {
        let services = control_services::offer(&mut self.endpoints, &self.lifecycle)?;
        self.own.services.extend(services);
        Ok(())
    }

    /// Activates or deactivates the node's inputs and publishers.
    pub(crate) fn set_active(&mut self, active: bool) {
        self.endpoints.active.store(active, Ordering::Release);
        self.endpoints.sources.set_accepting(active);
        if active {
            // Latched topics publish what was published meanwhile.
            self.endpoints.publishers.iter().filter_map(Weak::upgrade).for_each(|p| p.retry());
        }
    }

    /// Ends the shell's subscriptions, services, transforms and statuses.
    pub(crate) fn clear_shell(&mut self) {
        let Held { subscriptions, services, sources } = std::mem::take(&mut self.shell);
        drop((subscriptions, services));
        sources.into_iter().for_each(|source| self.endpoints.sources.retire(source));
        self.transforms = Transforms::default();
        self.diagnostics.clear();
    }

    /// Publishes the diagnostics of this second.
    pub(crate) fn publish_diagnostics(&mut self) {
        let state = *self.lifecycle.lock();
        self.diagnostics.publish(&mut self.endpoints, state, self.clock.now());
    }

    /// Subscribes to `/clock` if `use_sim_time` is set, else ends the subscription.
    pub(crate) fn follow_use_sim_time(&mut self) -> Result<(), NodeError> {
        let simulated = CommonParameters::from_map(self.parameter_store().values())?.use_sim_time;
        self.clock.set_simulated(simulated);
        if !simulated {
            self.own.subscriptions.clear();
            let sources = std::mem::take(&mut self.own.sources);
            sources.into_iter().for_each(|source| self.endpoints.sources.retire(source));
        } else if self.own.subscriptions.is_empty() {
            let (clock, sources) = (self.clock.clone(), Arc::clone(&self.endpoints.sources));
            let wake = sources.add_source("clock", 1, SourceKind::Control);
            let subscription = self.endpoints.subscribe(
                topics::absolute::CLOCK,
                CLOCK,
                SourceKind::Expected,
                move |source, _, m: &Arc<ClockMessage>| {
                    clock.set(convert::stamp(&m.clock));
                    sources.touch(source);
                    sources.put_control(wake, Control::Wake);
                },
            )?;
            self.own.subscriptions.push(subscription);
            self.own.sources.push(wake);
        }
        Ok(())
    }

    /// Publishes changes on `/parameter_events`, the only use of ros2-client's copy of the
    /// parameters.
    pub(crate) fn announce(&self, changes: &[(String, ParameterValue)]) {
        use ros2_client::ParameterValue as R;
        for (name, value) in changes {
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
            let published = self.endpoints.node.lock().set_parameter(name, value);
            if let Err(reason) = published {
                self.log(Level::Debug, format!("no event for the parameter {name}: {reason}"));
            }
        }
    }
}

/// rclcpp's, with a bound.
const ROSOUT: Qos = Qos { reliable: true, transient_local: true, depth: 100, max_samples: 100 };
const CLOCK: Qos = Qos { reliable: false, transient_local: false, depth: 1, max_samples: 1 };
