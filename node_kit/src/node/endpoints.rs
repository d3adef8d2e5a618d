//! A node's presence in DDS: creates its publishers, subscriptions and services.

use super::{
    domain::Domain,
    error::NodeError,
    logger::Logger,
    publisher::{Publisher, Publishing},
    reactor::Reactor,
};
use crate::{
    inbox::Sources,
    names::{NameKind, NodeName, Remap, resolve},
    parameters::ParameterStore,
    qos::{Endpoint, Qos},
};
use parking_lot::Mutex;
use rustdds::{
    DomainParticipant, QosPolicies, QosPolicyBuilder, Topic, TopicKind,
    policy::{Durability, History, Reliability, ResourceLimits},
};
use std::sync::{Arc, Weak, atomic::AtomicBool};
use volant_msgs::Message;

/// Creates a node's endpoints under its name, remaps and overrides of the QoS.
pub(crate) struct Endpoints {
    pub name: NodeName,
    pub remaps: Vec<Remap>,
    pub store: Arc<Mutex<ParameterStore>>,
    pub sources: Arc<dyn Sources>,
    pub logger: Logger,
    /// Whether the node's own publishers publish.
    pub active: Arc<AtomicBool>,
    pub publishers: Vec<Weak<dyn Publishing>>,
    // Dropped in this order: the readers' thread, the ROS node, the participant.
    pub reactor: Reactor,
    pub node: Arc<Mutex<ros2_client::Node>>,
    pub domain: Arc<Domain>,
}

impl Endpoints {
    /// Creates the ROS node in `domain`.
    ///
    /// # Errors
    /// DDS refuses the node, or the system the thread.
    pub fn new(
        domain: Arc<Domain>,
        sources: Arc<dyn Sources>,
        name: NodeName,
        remaps: Vec<Remap>,
        store: ParameterStore,
        logger: Logger,
    ) -> Result<Self, NodeError> {
        let what = || format!("the node {}", name.fully_qualified());
        let ros_name = ros2_client::NodeName::new(name.namespace(), name.base())
            .map_err(|e| NodeError::middleware(what(), e))?;
        // ros2-client 0.12.1's own parameter services have one wire format only and no
        // descriptors; its /rosout has no bound.
        let options = ros2_client::NodeOptions::new()
            .enable_rosout(false)
            .start_parameter_services(false)
            .allow_undeclared_parameters(true);
        let node = domain
            .context
            .new_node(ros_name, options)
            .map_err(|e| NodeError::middleware(what(), e))?;
        let reactor = Reactor::start(name.base())?;
        Ok(Self {
            name,
            remaps,
            store: Arc::new(Mutex::new(store)),
            sources,
            logger,
            active: Arc::new(AtomicBool::new(true)),
            publishers: Vec::new(),
            reactor,
            node: Arc::new(Mutex::new(node)),
            domain,
        })
    }

    /// Absolute name of a topic after remaps.
    pub fn resolve(&self, topic: &str) -> Result<String, NodeError> {
        Ok(resolve(&self.name, &self.remaps, NameKind::Topic, topic)?)
    }

    /// Absolute name of a service after remaps.
    pub fn resolve_service(&self, service: &str) -> Result<String, NodeError> {
        Ok(resolve(&self.name, &self.remaps, NameKind::Service, service)?)
    }

    /// Creates a publisher of the node itself, which publishes while the node is inactive too.
    pub fn advertise_always<M: Message>(
        &mut self,
        topic: &str,
        qos: Qos,
    ) -> Result<Publisher<M>, NodeError> {
        self.advertise_while(topic, qos, Arc::new(AtomicBool::new(true)))
    }

    /// Creates a publisher that is silent while `active` is false.
    pub fn advertise_while<M: Message>(
        &mut self,
        topic: &str,
        qos: Qos,
        active: Arc<AtomicBool>,
    ) -> Result<Publisher<M>, NodeError> {
        let name = self.resolve(topic)?;
        let qos = self.overridden(&name, qos, Endpoint::Publisher)?;
        let channel = self.domain.transport.channel::<M>(&name)?;
        let dds_topic = self.dds_topic::<M>(&name, &qos)?;
        let writer = self
            .node
            .lock()
            .create_publisher::<Arc<M>>(&dds_topic, None)
            .map_err(|e| NodeError::middleware(format!("the publisher of {name}"), e))?;
        let publisher = Publisher::new(name, qos, channel, writer, active);
        self.publishers.push(publisher.weak());
        self.domain.refresh();
        Ok(publisher)
    }

    /// DDS topic of a ROS topic with an absolute name.
    pub fn dds_topic<M: Message>(&self, name: &str, qos: &Qos) -> Result<Topic, NodeError> {
        let participant = &self.domain.context.domain_participant();
        let policies = with_type_hash(policies(qos), M::RIHS01_HASH);
        ros_topic(participant, name, M::TYPE_NAME, &policies)
    }

    /// The QoS with the parameters `qos_overrides.…` applied.
    pub fn overridden(
        &self,
        topic: &str,
        mut qos: Qos,
        endpoint: Endpoint,
    ) -> Result<Qos, NodeError> {
        let mut store = self.store.lock();
        for descriptor in qos.descriptors(topic, endpoint) {
            let name = descriptor.name.clone();
            if let Some(value) = store.declare_if_given(descriptor)? {
                qos = qos.with(&name, &value);
            }
        }
        Ok(qos)
    }
}

/// DDS type name of a ROS type: `sensor_msgs::msg::dds_::Imu_` for `sensor_msgs/msg/Imu`.
pub fn dds_type_name(type_name: &str) -> String {
    match type_name.rsplit_once('/') {
        Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
        None => type_name.to_owned(),
    }
}

/// Creates the DDS topic of a ROS topic with an absolute name.
///
/// # Errors
/// DDS does not create it.
pub fn ros_topic(
    participant: &DomainParticipant,
    name: &str,
    type_name: &str,
    policies: &QosPolicies,
) -> Result<Topic, NodeError> {
    participant
        .create_topic(format!("rt{name}"), dds_type_name(type_name), policies, TopicKind::NoKey)
        .map_err(|e| NodeError::middleware(format!("the topic {name}"), e))
}

/// Adds a type's RIHS01 hash to the policies of a publisher or subscription, as every rmw announces
/// it and `ros2 topic info -v` prints it. An empty hash, of an unknown type, adds nothing.
#[must_use]
pub fn with_type_hash(policies: QosPolicies, rihs01_hash: &str) -> QosPolicies {
    match rihs01_hash {
        "" => policies,
        hash => policies.with_user_data(format!("typehash={hash};").into_bytes()),
    }
}

/// DDS policies of a QoS, with its limit of samples. A full window of a reliable publisher fails at
/// once: waiting would hold up the sensor's loop.
pub(crate) fn policies(qos: &Qos) -> QosPolicies {
    let max_samples = count(qos.max_samples);
    unlimited_policies(qos, rustdds::Duration::ZERO)
        .resource_limits(ResourceLimits {
            max_samples,
            max_instances: 1,
            max_samples_per_instance: max_samples,
        })
        .build()
}

/// DDS policies of a QoS, with RustDDS's own limits of samples in place of `max_samples`.
///
/// A reliable publisher with a full window blocks for at most `max_blocking_time`.
pub fn unlimited_policies(qos: &Qos, max_blocking_time: rustdds::Duration) -> QosPolicyBuilder {
    QosPolicyBuilder::new()
        .reliability(if qos.reliable {
            Reliability::Reliable { max_blocking_time }
        } else {
            Reliability::BestEffort
        })
        .durability(if qos.transient_local {
            Durability::TransientLocal
        } else {
            Durability::Volatile
        })
        .history(History::KeepLast { depth: count(qos.depth) })
}

fn count(n: usize) -> i32 {
    i32::try_from(n).unwrap_or(i32::MAX)
}
