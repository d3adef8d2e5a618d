//! Live topics into a bag.
//!
//! One thread takes the samples from DDS and stamps them, one writes the bag, and the caller's watches discovery for new
//! topics. A bounded queue lies between the first two; what it cannot take is counted, never silently lost.

use super::{
    LiveError, join,
    raw::{Raw, RawAdapter, policies, ros_type_name},
    system_nanos,
};
use crate::{
    bag::{BagError, BagSummary, BagWriter, Durability, QosProfile, Reliability, Topic, WriteOptions},
    stopwatch::Stopwatch,
};
use async_executor::Executor;
use futures_lite::{StreamExt, future::block_on};
use rustdds::{DomainParticipant, Subscriber, TopicKind, no_key::DataReader};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel},
    },
    time::Duration,
};
use volant_msgs::MessageInfo;

/// Messages that may wait for the disk.
const QUEUE: usize = 2048;
/// A recorder that is killed loses at most this much.
const FLUSH: Duration = Duration::from_secs(1);
/// How often discovery is asked for new topics.
const LOOK: Duration = Duration::from_millis(50);

/// What is recorded, and how.
#[derive(Clone, Debug)]
pub struct RecordOptions {
    /// The bag to write.
    pub output: PathBuf,
    /// Absolute names; empty: all.
    pub topics: Vec<String>,
    /// Absolute names that are left out.
    pub exclude: Vec<String>,
    /// How the bag is written.
    pub write: WriteOptions,
    /// Ends by itself after this time.
    pub duration: Option<Duration>,
}

/// How the recording fares.
#[derive(Debug, Default)]
pub struct RecordStatus {
    /// Messages taken.
    pub messages: AtomicU64,
    /// Bytes of them.
    pub bytes: AtomicU64,
    /// Messages that the queue could not take.
    pub dropped: AtomicU64,
    /// Topics found.
    pub topics: AtomicU64,
}

/// What a recording left.
#[derive(Debug)]
pub struct RecordReport {
    /// The bag.
    pub bag: BagSummary,
    /// Messages that the queue could not take.
    pub dropped: u64,
    /// Topics that were asked for and never seen.
    pub unseen: Vec<String>,
}

enum Item {
    /// The next one; topics are counted from 0.
    Topic(Topic),
    Message {
        topic: usize,
        log_time: u64,
        publish_time: u64,
        data: Vec<u8>,
    },
}

/// Records until `stop` is set (or the duration is over), and tells `progress` now and then how it fares.
///
/// # Errors
/// The bag cannot be written, or DDS refuses.
pub fn record(
    options: &RecordOptions,
    stop: &AtomicBool,
    mut progress: impl FnMut(&RecordStatus),
) -> Result<RecordReport, LiveError> {
    let bag = BagWriter::create(&options.output, options.write)?;
    let participant = join()?;
    let status = Arc::new(RecordStatus::default());
    let (items, queue) = sync_channel(QUEUE);
    let failed = Arc::new(AtomicBool::new(false));
    let writer = std::thread::spawn({
        let failed = failed.clone();
        move || {
            let result = write_all(bag, &queue);
            failed.store(result.is_err(), Ordering::Release);
            result
        }
    });
    let executor = Arc::new(Executor::new());
    let (end, ended) = async_channel::bounded::<()>(1);
    let taker = std::thread::spawn({
        let executor = executor.clone();
        move || {
            // An error means that the sender is gone: the recording is over.
            let _ = block_on(executor.run(ended.recv()));
        }
    });
    let watch = Stopwatch::start();
    let mut takers = Takers {
        participant: &participant,
        executor: &executor,
        items: &items,
        status: &status,
        known: BTreeMap::new(),
        subscriber: None,
    };
    let mut seen = BTreeSet::new();
    while !stop.load(Ordering::Acquire) && !failed.load(Ordering::Acquire) {
        if options.duration.is_some_and(|d| watch.elapsed() >= d) {
            break;
        }
        for (topic, qos) in offered(&participant) {
            let asked = options.topics.is_empty() || options.topics.contains(&topic.name);
            if asked && !options.exclude.contains(&topic.name) {
                seen.insert(topic.name.clone());
                takers.add(topic, &qos)?;
            }
        }
        progress(&status);
        std::thread::sleep(LOOK);
    }
    drop(takers);
    // The samples' tasks end with their executor; then nobody holds the queue's end.
    drop(end);
    let _ = taker.join();
    drop(executor);
    drop(items);
    let bag = writer.join().map_err(|_| LiveError::Thread { what: "the bag's writer" })??;
    Ok(RecordReport {
        bag,
        dropped: status.dropped.load(Ordering::Relaxed),
        unseen: options.topics.iter().filter(|t| !seen.contains(*t)).cloned().collect(),
    })
}

fn write_all(mut bag: BagWriter, queue: &Receiver<Item>) -> Result<BagSummary, BagError> {
    let mut ids = vec![];
    let mut flushed = Stopwatch::start();
    loop {
        match queue.recv_timeout(FLUSH) {
            Ok(Item::Topic(topic)) => ids.push(bag.add_topic(topic)),
            Ok(Item::Message { topic, log_time, publish_time, data }) => {
                if let Some(id) = ids.get(topic) {
                    bag.write(*id, log_time, publish_time, &data)?;
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return bag.finish(),
        }
        if flushed.elapsed() >= FLUSH {
            bag.flush()?;
            flushed = Stopwatch::start();
        }
    }
}

/// Topics with a publisher, and the QoS of a subscription that matches all of its publishers.
fn offered(participant: &DomainParticipant) -> Vec<(Topic, QosProfile)> {
    let mut topics: BTreeMap<String, (String, QosProfile)> = BTreeMap::new();
    for writer in participant.discovered_writers() {
        let data = &writer.publication_topic_data;
        let (Some(name), Some(type_name)) =
            (data.topic_name.strip_prefix("rt"), ros_type_name(&data.type_name))
        else {
            continue;
        };
        let reliable = matches!(data.reliability, Some(rustdds::policy::Reliability::Reliable { .. }));
        let latched = matches!(data.durability, Some(rustdds::policy::Durability::TransientLocal));
        let (_, qos) = topics.entry(name.to_owned()).or_insert((type_name, QosProfile::LATCHED));
        if !reliable {
            qos.reliability = Reliability::BestEffort;
        }
        if !latched {
            qos.durability = Durability::Volatile;
        }
    }
    topics
        .into_iter()
        .map(|(name, (type_name, qos))| {
            // The bag keeps what was offered; what it does not say (the depth) is a guess that suits players.
            let offered = QosProfile {
                depth: if qos.durability == Durability::TransientLocal { 1 } else { 10 },
                ..qos
            };
            let info = MessageInfo::by_name(&type_name);
            let topic = Topic {
                name,
                definition: info.map(|i| i.definition.to_owned()).unwrap_or_default(),
                type_hash: info.map(|i| i.rihs01_hash.to_owned()).unwrap_or_default(),
                type_name,
                message_encoding: "cdr".to_owned(),
                offered_qos_profiles: offered.to_yaml(),
            };
            (topic, qos)
        })
        .collect()
}

struct Takers<'a> {
    participant: &'a DomainParticipant,
    executor: &'a Arc<Executor<'static>>,
    items: &'a SyncSender<Item>,
    status: &'a Arc<RecordStatus>,
    known: BTreeMap<String, usize>,
    subscriber: Option<Subscriber>,
}

impl Takers<'_> {
    fn add(&mut self, topic: Topic, qos: &QosProfile) -> Result<(), LiveError> {
        if self.known.contains_key(&topic.name) {
            return Ok(());
        }
        let failed = |reason: String| LiveError::Middleware {
            what: format!("the subscription of {}", topic.name),
            reason,
        };
        // Samples are taken as they come, so few wait; for pictures each counts a megabyte.
        let large = ["Image", "PointCloud2"].iter().any(|t| topic.type_name.ends_with(t));
        let qos = QosProfile { depth: if large { 16 } else { 256 }, ..*qos };
        let qos = policies(&qos, rustdds::Duration::ZERO);
        let subscriber = match &self.subscriber {
            Some(subscriber) => subscriber.clone(),
            None => {
                let made = self.participant.create_subscriber(&qos).map_err(|e| failed(e.to_string()))?;
                self.subscriber.insert(made).clone()
            }
        };
        let dds_topic = self
            .participant
            .create_topic(
                format!("rt{}", topic.name),
                super::raw::dds_type_name(&topic.type_name),
                &qos,
                TopicKind::NoKey,
            )
            .map_err(|e| failed(e.to_string()))?;
        let reader: DataReader<Raw, RawAdapter> =
            subscriber.create_datareader_no_key(&dds_topic, Some(qos)).map_err(|e| failed(e.to_string()))?;
        let index = self.known.len();
        self.known.insert(topic.name.clone(), index);
        self.status.topics.store(self.known.len() as u64, Ordering::Relaxed);
        if self.items.send(Item::Topic(topic)).is_err() {
            // The writer failed; the caller's loop sees that.
            return Ok(());
        }
        let (items, status) = (self.items.clone(), self.status.clone());
        let task = async move {
            let mut samples = std::pin::pin!(reader.async_sample_stream());
            while let Some(sample) = samples.next().await {
                let Ok(sample) = sample else { continue };
                let log_time = system_nanos();
                let publish_time = sample.sample_info().source_timestamp().map_or(log_time, nanos);
                let Raw(data) = sample.into_value();
                let bytes = data.len() as u64;
                match items.try_send(Item::Message { topic: index, log_time, publish_time, data }) {
                    Ok(()) => {
                        status.messages.fetch_add(1, Ordering::Relaxed);
                        status.bytes.fetch_add(bytes, Ordering::Relaxed);
                    }
                    Err(TrySendError::Full(_)) => {
                        status.dropped.fetch_add(1, Ordering::Relaxed);
                    }
                    Err(TrySendError::Disconnected(_)) => return,
                }
            }
        };
        self.executor.spawn(task).detach();
        Ok(())
    }
}

/// DDS counts 2⁻³² s.
fn nanos(time: rustdds::Timestamp) -> u64 {
    let ticks = time.to_ticks();
    (ticks >> 32) * 1_000_000_000 + (((ticks & 0xffff_ffff) * 1_000_000_000) >> 32)
}
