//! Live topics into a bag.
//!
//! One thread takes the samples from DDS and stamps them, one writes the bag, and the caller's watches discovery for new
//! topics. A bounded queue lies between the first two; what it cannot take is counted, never silently lost.

use super::{
    LiveError,
    tap::{Offer, Sample, Subscription, Tap},
};
use crate::{
    bag::{BagError, BagSummary, BagWriter, Topic, WriteOptions},
    stopwatch::Stopwatch,
};
use node_kit::node::Loss;
use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel},
    },
    time::Duration,
};

/// Messages that may wait for the disk. (At 30 raw images/s and 400 Hz a disk may stand still for 4 s.)
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
    /// Messages that were lost on the way, by the gaps in their publishers' numbering.
    pub lost: AtomicU64,
    /// Topics found.
    pub topics: AtomicU64,
    /// How often the DDS domain was joined anew.
    pub joined_anew: AtomicU64,
}

/// What a recording left.
#[derive(Debug)]
pub struct RecordReport {
    /// The bag.
    pub bag: BagSummary,
    /// Messages that the queue could not take.
    pub dropped: u64,
    /// Messages that were lost on the way, by the gaps in their publishers' numbering.
    pub lost: u64,
    /// Topics that were asked for and never seen.
    pub unseen: Vec<String>,
    /// Why the DDS domain was joined anew in mid-recording; what was published meanwhile is missing.
    pub losses: Vec<Loss>,
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
    let tap = Tap::join()?;
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
    let watch = Stopwatch::start();
    let mut takers =
        Takers { subscriptions: BTreeMap::new(), topics: BTreeMap::new(), tap, items, status: &status };
    let mut losses = vec![];
    while !stop.load(Ordering::Acquire) && !failed.load(Ordering::Acquire) {
        if options.duration.is_some_and(|d| watch.elapsed() >= d) {
            break;
        }
        if let Some(loss) = takers.tap.loss() {
            losses.push(loss);
            takers.join_anew()?;
        }
        for offer in takers.tap.offers() {
            let name = &offer.topic.name;
            let asked = options.topics.is_empty() || options.topics.contains(name);
            if asked && !options.exclude.contains(name) {
                takers.add(offer)?;
            }
        }
        progress(&status);
        std::thread::sleep(LOOK);
    }
    let unseen = options.topics.iter().filter(|t| !takers.topics.contains_key(*t)).cloned().collect();
    // With the subscriptions and the tap the last ends of the queue drop, and the writer closes the bag.
    drop(takers);
    let bag = writer.join().map_err(|_| LiveError::Thread { what: "the bag's writer" })??;
    Ok(RecordReport {
        bag,
        dropped: status.dropped.load(Ordering::Relaxed),
        lost: status.lost.load(Ordering::Relaxed),
        unseen,
        losses,
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

struct Takers<'a> {
    // Dropped before the tap that they are of.
    subscriptions: BTreeMap<String, Subscription>,
    /// Where each stands in the bag.
    topics: BTreeMap<String, usize>,
    tap: Tap,
    items: SyncSender<Item>,
    status: &'a Arc<RecordStatus>,
}

impl Takers<'_> {
    /// The topics stay what they are in the bag; discovery brings them again.
    fn join_anew(&mut self) -> Result<(), LiveError> {
        self.subscriptions.clear();
        self.tap = Tap::join()?;
        self.status.joined_anew.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }

    fn add(&mut self, offer: Offer) -> Result<(), LiveError> {
        if self.subscriptions.contains_key(&offer.topic.name) {
            return Ok(());
        }
        let index = match self.topics.get(&offer.topic.name) {
            Some(index) => *index,
            None => {
                if self.items.send(Item::Topic(offer.topic.clone())).is_err() {
                    // The writer failed; the caller's loop sees that.
                    return Ok(());
                }
                let index = self.topics.len();
                self.topics.insert(offer.topic.name.clone(), index);
                index
            }
        };
        let (items, status) = (self.items.clone(), Arc::clone(self.status));
        let subscription = self.tap.subscribe(&offer, move |sample| {
            let Sample { log_time, publish_time, lost, data, .. } = sample;
            let bytes = data.len() as u64;
            status.lost.fetch_add(lost, Ordering::Relaxed);
            match items.try_send(Item::Message { topic: index, log_time, publish_time, data }) {
                Ok(()) => {
                    status.messages.fetch_add(1, Ordering::Relaxed);
                    status.bytes.fetch_add(bytes, Ordering::Relaxed);
                }
                // Disconnected: the writer failed, and the recording ends with its reason.
                Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {
                    status.dropped.fetch_add(1, Ordering::Relaxed);
                }
            }
        })?;
        self.subscriptions.insert(offer.topic.name, subscription);
        self.status.topics.store(self.topics.len() as u64, Ordering::Relaxed);
        Ok(())
    }
}
