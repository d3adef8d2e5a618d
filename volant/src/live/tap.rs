//! Live topics as bytes: discovered publishers, and samples of any type.
//! A [`Tap`] lists [`Offer`]s from discovery and passes [`Sample`]s on its own thread.

use super::{
    raw::{Raw, RawAdapter, ros_type_name},
    system_nanos,
};
use anyhow::{Result, anyhow};
use bag::{Qos, Topic, qos_to_yaml};
use futures_lite::StreamExt;
use node_kit::{
    environment::Network,
    node::{
        AnnouncedReader, BareNode, Loss, MiddlewareWatch, Reactor, Task, ros_topic,
        unlimited_policies, with_type_hash,
    },
};
use rustdds::{GUID, RTPSEntity, Subscriber, no_key::DataReader};
use std::{
    collections::{BTreeMap, HashMap},
    pin::pin,
};
use volant_msgs::MessageInfo;

/// A published topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Offer {
    /// Description for a bag.
    pub topic: Topic,
    /// QoS that is compatible with all of its publishers.
    pub qos: Qos,
    /// Number of publishers.
    pub publishers: usize,
}

/// One message of a live topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Time of reception, ns since the epoch.
    pub log_time: u64,
    /// Time of publication, ns since the epoch.
    pub publish_time: u64,
    /// GUID of the publisher.
    pub writer: [u8; 16],
    /// Samples of this publisher that were lost in transport before this one, by the gap in the
    /// sequence numbers.
    pub lost: u64,
    /// CDR bytes with their encapsulation header.
    pub data: Vec<u8>,
}

/// Node that subscribes to topics as bytes; dropping it ends its subscriptions.
pub struct Tap {
    /// Dropped first: its tasks hold the readers.
    reactor: Reactor,
    node: BareNode,
    middleware: MiddlewareWatch,
    subscriber: Option<Subscriber>,
}

/// A subscription; dropping it ends it.
#[must_use]
#[allow(dead_code, reason = "held for their drop")]
pub struct Subscription(Task<()>, AnnouncedReader);

impl Tap {
    /// Joins the domain that the environment names, with its discovery range and security, as a
    /// node of this name. `ros2 node list` hides one that begins with `_`.
    ///
    /// # Errors
    /// As [`BareNode::join`], or an invalid variable of the environment.
    pub fn join(name: &str) -> Result<Self> {
        let (node, middleware) = BareNode::join(&Network::from_environment()?, name)?;
        Ok(Self { reactor: Reactor::start("tap")?, node, middleware, subscriber: None })
    }

    /// Why the middleware has failed, if it has: the caller drops the subscriptions and joins
    /// another tap.
    pub fn loss(&mut self) -> Option<Loss> {
        self.middleware.loss()
    }

    /// Topics with a publisher, sorted by name.
    pub fn offers(&self) -> Vec<Offer> {
        let mut offers: BTreeMap<String, Offer> = BTreeMap::new();
        for writer in self.node.participant().discovered_writers() {
            let data = &writer.publication_topic_data;
            let (Some(name), Some(type_name)) =
                (data.topic_name.strip_prefix("rt"), ros_type_name(&data.type_name))
            else {
                continue;
            };
            let reliable =
                matches!(data.reliability, Some(rustdds::policy::Reliability::Reliable { .. }));
            let latched =
                matches!(data.durability, Some(rustdds::policy::Durability::TransientLocal));
            let offer = offers.entry(name.to_owned()).or_insert_with(|| {
                let info = MessageInfo::by_name(&type_name);
                let hash = info
                    .map(|i| i.rihs01_hash.to_owned())
                    .or_else(|| type_hash(&writer.user_data))
                    .unwrap_or_default();
                let topic = Topic {
                    name: name.to_owned(),
                    definition: info.map(|i| i.definition.to_owned()).unwrap_or_default(),
                    type_hash: hash,
                    type_name,
                    message_encoding: "cdr".to_owned(),
                    offered_qos_profiles: String::new(),
                };
                Offer { topic, qos: Qos::LATCHED, publishers: 0 }
            });
            offer.publishers += 1;
            offer.qos.reliable &= reliable;
            offer.qos.transient_local &= latched;
        }
        offers
            .into_values()
            .map(|mut offer| {
                // The offered QoS; the depth, which discovery does not transmit, is a guess for
                // players.
                let depth = if offer.qos.transient_local { 1 } else { 10 };
                offer.topic.offered_qos_profiles = qos_to_yaml(&Qos { depth, ..offer.qos });
                offer
            })
            .collect()
    }

    /// Subscribes to a topic; `take` runs on the tap's thread and must not block.
    ///
    /// # Errors
    /// DDS does not create the subscription.
    pub fn subscribe(
        &mut self,
        offer: &Offer,
        mut take: impl FnMut(Sample) + Send + 'static,
    ) -> Result<Subscription> {
        let topic = &offer.topic;
        let failed = |reason: String| anyhow!("the subscription of {}: {reason}", topic.name);
        // Samples are read as they arrive, so few wait. A busy computer can stop this thread for a
        // second, and samples beyond the depth are then lost (30 images of up to a megabyte, or 400
        // IMU samples).
        let large = ["Image", "PointCloud2"].iter().any(|t| topic.type_name.ends_with(t));
        let qos = Qos { depth: if large { 32 } else { 512 }, ..offer.qos };
        let qos = unlimited_policies(&qos, rustdds::Duration::ZERO).build();
        let qos = with_type_hash(qos, &topic.type_hash);
        let subscriber = match &self.subscriber {
            Some(subscriber) => subscriber.clone(),
            None => {
                let made = self
                    .node
                    .participant()
                    .create_subscriber(&qos)
                    .map_err(|e| failed(e.to_string()))?;
                self.subscriber.insert(made).clone()
            }
        };
        let dds_topic = ros_topic(self.node.participant(), &topic.name, &topic.type_name, &qos)?;
        let reader: DataReader<Raw, RawAdapter> = subscriber
            .create_datareader_no_key(&dds_topic, Some(qos))
            .map_err(|e| failed(e.to_string()))?;
        let announced = self.node.announce_reader(reader.guid());
        let task = self.reactor.spawn(async move {
            let mut numbers = HashMap::<GUID, i64>::new();
            let mut samples = pin!(reader.async_sample_stream());
            while let Some(sample) = samples.next().await {
                let Ok(sample) = sample else { continue };
                let log_time = system_nanos();
                let info = sample.sample_info();
                let publish_time = info.source_timestamp().map_or(log_time, nanos);
                let (writer, number) =
                    (info.publication_handle(), i64::from(info.sample_identity().sequence_number));
                // Publishers come and go; the map must stay bounded.
                if numbers.len() > 256 {
                    numbers.clear();
                }
                let before = numbers.insert(writer, number);
                let lost = before.map_or(0, |b| u64::try_from(number - b - 1).unwrap_or(0));
                let Raw(data) = sample.into_value();
                take(Sample { log_time, publish_time, writer: writer.to_bytes(), lost, data });
            }
        });
        Ok(Subscription(task, announced))
    }
}

/// Type hash of REP-2016 in the endpoint's user data, as rmw writes it: `typehash=RIHS01_…;`.
fn type_hash(user_data: &[u8]) -> Option<String> {
    let text = String::from_utf8_lossy(user_data);
    // RustDDS gives the parameter's value, which begins with the length.
    let hash = text.split_once("typehash=")?.1.split(';').next()?;
    hash.starts_with("RIHS01_").then(|| hash.to_owned())
}

/// Converts DDS's unit of 2⁻³² s to ns.
fn nanos(time: rustdds::Timestamp) -> u64 {
    let ticks = time.to_ticks();
    (ticks >> 32) * 1_000_000_000 + (((ticks & 0xffff_ffff) * 1_000_000_000) >> 32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_of_a_type_that_is_not_built_in_comes_from_its_publisher() {
        assert_eq!(type_hash(b"typehash=RIHS01_ab12;").as_deref(), Some("RIHS01_ab12"));
        assert_eq!(type_hash(b"enclave=/;typehash=RIHS01_0;").as_deref(), Some("RIHS01_0"));
        assert_eq!(type_hash(b"\x12\0\0\0typehash=RIHS01_0;\0\0").as_deref(), Some("RIHS01_0"));
        assert_eq!(type_hash(b"typehash=MD5_0;"), None);
        assert_eq!(type_hash(b""), None);
    }
}
