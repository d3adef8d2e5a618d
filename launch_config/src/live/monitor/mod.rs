//! A look at live nodes on a terminal: poses with their uncertainty, markers, rates, delays, what is lost, diagnostics.
//!
//! In flow live topics ([`Watch`]), out flow [`Snapshot`]s, as text ([`plain`]) or on a terminal ([`screen`]).

pub mod plain;
pub mod screen;
mod state;

pub use state::{
    Flow, InputLine, MarkerState, Monitor, PoseState, RigState, Snapshot, StatusLine, TopicLine,
};

use super::{
    LiveError, system_nanos,
    tap::{Subscription, Tap},
};
use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
};

/// What is looked at.
#[derive(Clone, Debug, Default)]
pub struct WatchOptions {
    /// Only topics under this namespace, and those of the whole graph (`/diagnostics`, `/tf`); empty: all.
    pub namespace: String,
    /// Images too: to measure them here they must be sent here.
    pub images: bool,
}

/// Watches live topics.
pub struct Watch {
    // Dropped before the tap that they are of.
    subscriptions: BTreeMap<String, Subscription>,
    tap: Tap,
    monitor: Arc<Mutex<Monitor>>,
    options: WatchOptions,
}

impl Watch {
    /// Joins the domain that the environment names.
    ///
    /// # Errors
    /// A variable that cannot be, or DDS's refusal.
    pub fn start(options: WatchOptions) -> Result<Self, LiveError> {
        Ok(Self { subscriptions: BTreeMap::new(), tap: Tap::join()?, monitor: Arc::default(), options })
    }

    /// Takes up topics that are new; to be called a few times a second.
    ///
    /// # Errors
    /// DDS's refusal.
    pub fn look(&mut self) -> Result<(), LiveError> {
        if self.tap.loss().is_some() {
            self.subscriptions.clear();
            self.tap = Tap::join()?;
        }
        let offers = self.tap.offers();
        for offer in &offers {
            let (name, type_name) = (&offer.topic.name, &offer.topic.type_name);
            if !self.concerns(name) {
                continue;
            }
            let image = matches!(&**type_name, "sensor_msgs/msg/Image" | "sensor_msgs/msg/CompressedImage");
            let known = !offer.topic.definition.is_empty();
            let taken = known && (!image || self.options.images);
            lock(&self.monitor).offered(name, type_name, offer.publishers, taken);
            if taken && !self.subscriptions.contains_key(name) {
                let (monitor, topic) = (Arc::clone(&self.monitor), offer.topic.clone());
                let subscription =
                    self.tap.subscribe(offer, move |sample| lock(&monitor).take(&topic, &sample))?;
                self.subscriptions.insert(name.clone(), subscription);
            }
        }
        lock(&self.monitor).gone(|name| offers.iter().any(|o| o.topic.name == name));
        Ok(())
    }

    /// What there is to show now.
    pub fn snapshot(&self) -> Snapshot {
        lock(&self.monitor).snapshot(system_nanos())
    }

    fn concerns(&self, topic: &str) -> bool {
        let namespace = self.options.namespace.trim_matches('/');
        let plumbing =
            ["/parameter_events", "/rosout", "/transition_event"].iter().any(|t| topic.ends_with(t));
        !plumbing
            && (namespace.is_empty()
                || ["/diagnostics", "/tf", "/tf_static", "/clock"].contains(&topic)
                || topic
                    .strip_prefix('/')
                    .and_then(|t| t.strip_prefix(namespace))
                    .is_some_and(|t| t.starts_with('/')))
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
