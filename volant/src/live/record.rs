//! Records live topics to a bag.
//! One thread receives and stamps samples, one writes the bag, and the caller's thread polls
//! discovery for new topics. A bounded queue connects the first two; what it drops is counted.

use super::{
    tap::{Offer, Sample, Subscription, Tap},
    thread_ended,
};
use crate::stopwatch::Stopwatch;
use anyhow::Result;
use bag::{BagError, BagSummary, BagWriter, Topic, WriteOptions};
use chrono::{DateTime, Utc};
use node_kit::node::Loss;
use parking_lot::Mutex;
use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel},
    },
    time::{Duration, SystemTime},
};

/// Name of the node.
const NODE: &str = "rosbag2_recorder";

/// Messages that may wait for the disk: 4 s of 30 raw images/s and 400 Hz of IMU samples.
const QUEUE: usize = 2048;
/// Period of flushing: a recorder that is killed loses at most this time.
const FLUSH: Duration = Duration::from_secs(1);
/// Period of polling discovery.
const LOOK: Duration = Duration::from_millis(50);

/// Options of a recording.
#[derive(Clone, Debug)]
pub struct RecordOptions {
    /// Bag to write.
    pub output: PathBuf,
    /// Absolute names of the topics; empty: all.
    pub topics: Vec<String>,
    /// Excluded topics: absolute names, or relative ones that are excluded in every namespace.
    pub exclude: Vec<String>,
    /// Options of the bag.
    pub write: WriteOptions,
    /// Duration; `None`: until stopped.
    pub duration: Option<Duration>,
}

/// Progress of a recording.
#[derive(Clone, Debug, Default)]
pub struct RecordStatus {
    /// Received messages.
    pub messages: u64,
    /// Bytes of the received messages.
    pub bytes: u64,
    /// Messages that the full queue dropped.
    pub dropped: u64,
    /// Messages lost in transport, by gaps in their publishers' sequence numbers.
    pub lost: u64,
    /// Recorded topics.
    pub topics: usize,
    /// Requested topics without a publisher so far.
    pub unpublished: Vec<String>,
    /// Why a topic was not subscribed, or the DDS domain not joined again, each once; both are
    /// tried again.
    pub failures: Vec<String>,
}

impl RecordStatus {
    fn fail(&mut self, error: &anyhow::Error) {
        let text = error.to_string();
        if !self.failures.contains(&text) {
            self.failures.push(text);
        }
    }
}

/// Result of a recording.
#[derive(Debug)]
pub struct RecordReport {
    /// The bag.
    pub bag: BagSummary,
    /// Its status at the end.
    pub status: RecordStatus,
    /// Why the DDS domain was joined again during the recording; messages published meanwhile are
    /// missing.
    pub losses: Vec<Loss>,
}

enum Item {
    /// A new topic; topics are numbered from 0.
    Topic(Topic),
    /// A message of the topic of this number.
    Message(usize, Sample),
}

/// Records until `stop` is set or the duration is over; calls `progress` regularly. What fails
/// after the start, such as a subscription, is tried again.
///
/// # Errors
/// The DDS domain cannot be joined at the start, or the bag is not writable.
pub fn record(
    options: &RecordOptions,
    stop: &AtomicBool,
    mut progress: impl FnMut(&RecordStatus),
) -> Result<RecordReport> {
    // Joined first: a recording that cannot start leaves no file.
    let tap = Tap::join(NODE)?;
    let bag = BagWriter::create(&options.output, options.write)?;
    let status = Arc::new(Mutex::new(RecordStatus::default()));
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
    let watch = Stopwatch::start();
    let mut takers = Takers {
        subscriptions: BTreeMap::new(),
        topics: BTreeMap::new(),
        tap,
        items,
        status: &status,
    };
    let (mut losses, mut lost) = (vec![], false);
    while !stop.load(Ordering::Acquire) && !failed.load(Ordering::Acquire) {
        if options.duration.is_some_and(|d| watch.elapsed() >= d) {
            break;
        }
        if !lost && let Some(loss) = takers.tap.loss() {
            losses.push(loss);
            lost = true;
            // The topics keep their numbers, and discovery finds them again.
            takers.subscriptions.clear();
        }
        if lost {
            match Tap::join(NODE) {
                Ok(tap) => (takers.tap, lost) = (tap, false),
                Err(error) => status.lock().fail(&error),
            }
        }
        let offers = if lost { vec![] } else { takers.tap.offers() };
        for offer in offers {
            let name = &offer.topic.name;
            let selected = options.topics.is_empty() || options.topics.contains(name);
            if selected
                && !options.exclude.iter().any(|topic| is_meant(topic, name))
                && let Err(error) = takers.add(offer)
            {
                status.lock().fail(&error);
            }
        }
        status.lock().unpublished = takers.unpublished(&options.topics);
        // A copy: a slow terminal must not keep samples waiting.
        let now = status.lock().clone();
        progress(&now);
        std::thread::sleep(LOOK);
    }
    status.lock().unpublished = takers.unpublished(&options.topics);
    // Dropping the subscriptions and the tap closes the queue, and the writer closes the bag.
    drop(takers);
    let bag = writer.join().map_err(|_| thread_ended("the bag's writer"))??;
    let status = status.lock().clone();
    Ok(RecordReport { bag, status, losses })
}

/// Whether the absolute or relative name `topic` means the topic `name`.
fn is_meant(topic: &str, name: &str) -> bool {
    topic == name || !topic.starts_with('/') && name.ends_with(&format!("/{topic}"))
}

fn write_all(mut bag: BagWriter, queue: &Receiver<Item>) -> Result<BagSummary, BagError> {
    let mut ids = vec![];
    let mut flushed = Stopwatch::start();
    loop {
        match queue.recv_timeout(FLUSH) {
            Ok(Item::Topic(topic)) => ids.push(bag.add_topic(topic)),
            Ok(Item::Message(topic, sample)) => {
                if let Some(id) = ids.get(topic) {
                    bag.write(*id, sample.log_time, sample.publish_time, &sample.data)?;
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

struct Takers<'a> {
    // Dropped before their tap.
    subscriptions: BTreeMap<String, Subscription>,
    /// Number of each topic in the queue.
    topics: BTreeMap<String, usize>,
    tap: Tap,
    items: SyncSender<Item>,
    status: &'a Arc<Mutex<RecordStatus>>,
}

impl Takers<'_> {
    /// Those of the requested topics that had no publisher yet.
    fn unpublished(&self, requested: &[String]) -> Vec<String> {
        requested.iter().filter(|t| !self.topics.contains_key(*t)).cloned().collect()
    }

    fn add(&mut self, offer: Offer) -> Result<()> {
        if self.subscriptions.contains_key(&offer.topic.name) {
            return Ok(());
        }
        let index = match self.topics.get(&offer.topic.name) {
            Some(index) => *index,
            None => {
                if self.items.send(Item::Topic(offer.topic.clone())).is_err() {
                    // The writer failed; the caller's loop detects it.
                    return Ok(());
                }
                let index = self.topics.len();
                self.topics.insert(offer.topic.name.clone(), index);
                index
            }
        };
        let (items, status) = (self.items.clone(), Arc::clone(self.status));
        let subscription = self.tap.subscribe(&offer, move |sample| {
            let (bytes, lost) = (sample.data.len() as u64, sample.lost);
            let sent = items.try_send(Item::Message(index, sample));
            let mut status = status.lock();
            status.lost += lost;
            match sent {
                Ok(()) => {
                    status.messages += 1;
                    status.bytes += bytes;
                }
                // Full; or the writer failed, and the recording ends with its reason.
                Err(_) => status.dropped += 1,
            }
        })?;
        self.subscriptions.insert(offer.topic.name, subscription);
        self.status.lock().topics = self.topics.len();
        Ok(())
    }
}

/// Name of a bag that starts at `time`, in UTC: `volant_2026-11-23T20-15-00Z`.
pub fn bag_name(time: SystemTime) -> String {
    DateTime::<Utc>::from(time).format("volant_%Y-%m-%dT%H-%M-%SZ").to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_relative_name_means_every_namespace() {
        for (topic, name, meant) in [
            ("/a/b", "/a/b", true),
            ("/a/b", "/rig1/a/b", false),
            ("a/b", "/a/b", true),
            ("a/b", "/rig1/a/b", true),
            ("a/b", "/a/b/c", false),
            ("a/b", "/aa/b", false),
        ] {
            assert_eq!(is_meant(topic, name), meant, "{topic} {name}");
        }
    }

    #[test]
    fn a_failure_that_is_tried_again_is_noted_once() {
        let mut status = RecordStatus::default();
        for what in ["the subscription of /a", "the subscription of /a", "the subscription of /b"] {
            status.fail(&anyhow::anyhow!("{what}: no memory"));
        }
        assert_eq!(status.failures.len(), 2);
    }

    #[test]
    fn a_bag_is_named_in_utc() {
        let time = SystemTime::UNIX_EPOCH + Duration::from_secs(1_709_210_096);
        assert_eq!(bag_name(time), "volant_2024-02-29T12-34-56Z");
    }
}
