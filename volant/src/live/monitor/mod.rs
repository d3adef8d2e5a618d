//! Monitor of live nodes: poses with their uncertainty, markers, rates, delays, losses,
//! diagnostics. [`Watch`] subscribes to live topics and yields [`Snapshot`]s, which are shown as
//! text ([`plain`]) or on a terminal ([`screen`]).

pub mod plain;
pub mod screen;
mod snapshot;
mod state;

pub use snapshot::{Flow, InputLine, PoseState, RigState, Snapshot, TopicLine};

use super::{
    system_nanos,
    tap::{Sample, Subscription, Tap},
};
use anyhow::Result;
use node_kit::environment::{DiscoveryRange, Network};
use parking_lot::Mutex;
use rig_model::topics::absolute::{CLOCK, DIAGNOSTICS, PARAMETER_EVENTS, ROSOUT, TF, TF_STATIC};
use state::Monitor;
use std::{collections::BTreeMap, sync::Arc};
use volant_msgs::diagnostic_msgs::msg::DiagnosticStatus;

/// Name of the node.
const NODE: &str = "_volant_monitor";

/// Subscriptions to live topics, and what they received.
pub struct Watch {
    // Dropped before their tap.
    subscriptions: BTreeMap<String, Subscription>,
    tap: Tap,
    monitor: Arc<Mutex<Monitor>>,
    namespace: String,
    images: bool,
    /// [`Snapshot::place`].
    place: String,
    /// Whether the DDS domain must be joined again.
    lost: bool,
    /// What failed in the last poll.
    failure: Option<String>,
}

impl Watch {
    /// Joins the domain that the environment names, and watches the topics under a namespace and
    /// those of the whole graph (`/diagnostics`, `/tf`); empty: all. Subscribing to `images` adds
    /// network load.
    ///
    /// # Errors
    /// A variable of the environment is invalid, or the domain cannot be joined.
    pub fn start(namespace: &str, images: bool) -> Result<Self> {
        let network = Network::from_environment()?;
        let range = match network.range {
            DiscoveryRange::Localhost => "this host alone",
            DiscoveryRange::Subnet => "the local network",
        };
        let mut place = format!("DDS domain {} on {range}", network.domain_id);
        let namespace = namespace.trim_matches('/').to_owned();
        if !namespace.is_empty() {
            place += &format!(" in the namespace /{namespace}");
        }
        Ok(Self {
            subscriptions: BTreeMap::new(),
            tap: Tap::join(NODE)?,
            monitor: Arc::default(),
            namespace,
            images,
            place,
            lost: false,
            failure: None,
        })
    }

    /// Subscribes to new topics; call it a few times a second. What fails is tried again in the
    /// next poll, and is among the diagnostics until then.
    pub fn poll(&mut self) {
        self.failure = self.try_poll().err().map(|error| error.to_string());
    }

    fn try_poll(&mut self) -> Result<()> {
        self.lost |= self.tap.loss().is_some();
        if self.lost {
            self.subscriptions.clear();
            self.tap = Tap::join(NODE)?;
            self.lost = false;
        }
        let mut result = Ok(());
        let offers = self.tap.offers();
        for offer in &offers {
            let (name, type_name) = (&offer.topic.name, &offer.topic.type_name);
            if !self.concerns(name) {
                continue;
            }
            let image =
                matches!(&**type_name, "sensor_msgs/msg/Image" | "sensor_msgs/msg/CompressedImage");
            let known = !offer.topic.definition.is_empty();
            let subscribed = known && (!image || self.images);
            self.monitor.lock().discover(offer, subscribed);
            if subscribed && !self.subscriptions.contains_key(name) {
                let (monitor, topic) = (Arc::clone(&self.monitor), offer.topic.clone());
                let take = move |sample: Sample| monitor.lock().add(&topic, &sample);
                match self.tap.subscribe(offer, take) {
                    Ok(subscription) => {
                        self.subscriptions.insert(name.clone(), subscription);
                    }
                    Err(error) => result = Err(error),
                }
            }
        }
        self.monitor.lock().retain_published(|name| offers.iter().any(|o| o.topic.name == name));
        result
    }

    /// Summarizes what was received until now.
    pub fn snapshot(&self) -> Snapshot {
        let mut snapshot = self.monitor.lock().snapshot(system_nanos());
        snapshot.place.clone_from(&self.place);
        if let Some(failure) = &self.failure {
            let status = DiagnosticStatus {
                level: DiagnosticStatus::ERROR,
                hardware_id: "volant monitor".into(),
                name: "subscriptions".into(),
                message: format!("{failure}; it is tried again"),
                ..DiagnosticStatus::default()
            };
            snapshot.statuses.insert(0, status);
        }
        snapshot
    }

    fn concerns(&self, topic: &str) -> bool {
        let is_plumbing =
            [PARAMETER_EVENTS, ROSOUT, "/transition_event"].iter().any(|t| topic.ends_with(t));
        let is_ours = self.namespace.is_empty()
            || [DIAGNOSTICS, TF, TF_STATIC, CLOCK].contains(&topic)
            || topic.starts_with(&format!("/{}/", self.namespace));
        is_ours && !is_plumbing
    }
}
