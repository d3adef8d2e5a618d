//! Reads ahead: one thread reads the bag, others decode its images, and everything is returned in
//! the bag's order.

use super::topic_names::TopicNames;
use bag::{BagError, BagMessage, BagReader, BagSummary};
use marker_tracker::{OwnedImage, decode_compressed, from_encoding};
use parking_lot::Mutex;
use rig_model::{Stamp, topics};
use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread::JoinHandle,
};
use volant_msgs::{
    Message, cdr,
    sensor_msgs::msg::{CompressedImage, Image},
};

/// Limit of waiting images, decoded or not; bounds the memory.
const AHEAD: usize = 16;

/// Usual number of threads that decode images: one per core.
pub fn decoding_threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Topic with images.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ImageTopic {
    /// `sensor_msgs/Image`.
    Raw(String),
    /// `sensor_msgs/CompressedImage`.
    Compressed(String),
}

impl ImageTopic {
    /// Topic with the rig's images in a bag, raw ones preferred: see [`TopicNames::choose`].
    ///
    /// # Errors
    /// Several topics with images, and none is the rig's.
    pub fn of(bag: &BagSummary, names: &TopicNames) -> anyhow::Result<Option<Self>> {
        let alternatives = [
            (topics::IMAGE, Image::TYPE_NAME),
            (topics::COMPRESSED_IMAGE, CompressedImage::TYPE_NAME),
        ];
        let found = names.choose(bag, &alternatives)?;
        let kinds = [Self::Raw, Self::Compressed];
        Ok(found.map(|(place, name)| kinds[place](name)))
    }

    /// All topics with images of a bag, raw ones first.
    pub fn all(bag: &BagSummary) -> Vec<Self> {
        let names = |kind| bag.topics_of(kind).into_iter().map(str::to_owned);
        let raw = names(Image::TYPE_NAME).map(Self::Raw);
        raw.chain(names(CompressedImage::TYPE_NAME).map(Self::Compressed)).collect()
    }

    /// Name of the topic.
    pub fn name(&self) -> &str {
        match self {
            Self::Raw(name) | Self::Compressed(name) => name,
        }
    }
}

/// Item of a feed, in the order in which the bag logged it.
#[derive(Debug)]
pub enum Fed {
    /// A message other than an image.
    Message(BagMessage),
    /// An image with its stamp, or why it is unusable.
    Image(Decoded),
}

/// A decoded image with its stamp, or why it is unusable.
pub type Decoded = Result<(Stamp, OwnedImage), String>;

enum Slot {
    Message(BagMessage),
    Image(Receiver<Decoded>),
    Failed(BagError),
}

struct Job {
    data: Vec<u8>,
    done: SyncSender<Decoded>,
}

/// Reader of a bag that reads ahead.
pub struct Feed {
    slots: Option<Receiver<Slot>>,
    shared: Arc<Shared>,
    threads: Vec<JoinHandle<()>>,
}

#[derive(Default)]
struct Shared {
    bytes_read: AtomicU64,
    losses: Mutex<Vec<String>>,
}

impl Feed {
    /// Starts to read; messages on topics other than `wanted` and the images' are skipped.
    ///
    /// # Errors
    /// As [`BagReader::open`].
    pub fn start(
        path: &Path,
        images: Option<ImageTopic>,
        wanted: Vec<String>,
        workers: usize,
    ) -> Result<Self, BagError> {
        let reader = BagReader::open(path)?;
        let shared = Arc::new(Shared::default());
        let (job_sender, jobs) = sync_channel::<Job>(AHEAD);
        let jobs = Arc::new(Mutex::new(jobs));
        let compressed = matches!(images, Some(ImageTopic::Compressed(_)));
        let mut threads = vec![];
        for _ in 0..workers.max(1) {
            let jobs = jobs.clone();
            threads.push(std::thread::spawn(move || decode_all(&jobs, compressed)));
        }
        let (slot_sender, slots) = sync_channel(8 * AHEAD);
        let reading = shared.clone();
        threads.push(std::thread::spawn(move || {
            read_all(reader, images.as_ref(), &wanted, &slot_sender, &job_sender, &reading);
        }));
        Ok(Self { slots: Some(slots), shared, threads })
    }

    /// Returns the next item, and waits for its image to be decoded; `None` at the end.
    ///
    /// # Errors
    /// The operating system fails to read the bag.
    pub fn take(&mut self) -> Result<Option<Fed>, BagError> {
        let Some(slot) = self.slots.as_ref().and_then(|slots| slots.recv().ok()) else {
            return Ok(None);
        };
        match slot {
            Slot::Message(message) => Ok(Some(Fed::Message(message))),
            Slot::Image(image) => {
                let image = image.recv().unwrap_or_else(|_| Err("the decoder has ended".into()));
                Ok(Some(Fed::Image(image)))
            }
            Slot::Failed(error) => Err(error),
        }
    }

    /// Bytes of the bag read so far.
    pub fn bytes_read(&self) -> u64 {
        self.shared.bytes_read.load(Ordering::Relaxed)
    }

    /// Losses in the bag, after its end is reached.
    pub fn losses(&self) -> Vec<String> {
        self.shared.losses.lock().clone()
    }
}

impl Drop for Feed {
    fn drop(&mut self) {
        // Dropping the receivers ends threads that wait to send.
        self.slots = None;
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

fn read_all(
    mut reader: BagReader,
    images: Option<&ImageTopic>,
    wanted: &[String],
    slots: &SyncSender<Slot>,
    jobs: &SyncSender<Job>,
    shared: &Shared,
) {
    loop {
        let slot = match reader.next_message() {
            Ok(Some(message)) => {
                shared.bytes_read.store(reader.bytes_read(), Ordering::Relaxed);
                if images.is_some_and(|i| i.name() == message.topic.name) {
                    let (done, image) = sync_channel(1);
                    if jobs.send(Job { data: message.data, done }).is_err() {
                        return;
                    }
                    Slot::Image(image)
                } else if wanted.contains(&message.topic.name) {
                    Slot::Message(message)
                } else {
                    continue;
                }
            }
            Ok(None) => {
                shared.losses.lock().extend_from_slice(reader.losses());
                return;
            }
            Err(error) => Slot::Failed(error),
        };
        let failed = matches!(slot, Slot::Failed(_));
        if slots.send(slot).is_err() || failed {
            return;
        }
    }
}

fn decode_all(jobs: &Mutex<Receiver<Job>>, compressed: bool) {
    loop {
        // One worker at a time waits for a job.
        let Ok(job) = jobs.lock().recv() else { return };
        let result = if compressed { compressed_image(&job.data) } else { raw_image(&job.data) };
        // The feed may have been dropped; receiving the next job detects it.
        let _ = job.done.send(result);
    }
}

fn compressed_image(data: &[u8]) -> Decoded {
    let message: CompressedImage = cdr::from_bytes(data).map_err(|e| e.to_string())?;
    let image = decode_compressed(&message.format, &message.data).map_err(|e| e.to_string())?;
    Ok((node_kit::convert::stamp(&message.header.stamp), image))
}

fn raw_image(data: &[u8]) -> Decoded {
    let message: Image = cdr::from_bytes(data).map_err(|e| e.to_string())?;
    let at = node_kit::convert::stamp(&message.header.stamp);
    let mut scratch = OwnedImage::default();
    let view = from_encoding(
        at,
        message.width as usize,
        message.height as usize,
        &message.encoding,
        message.is_bigendian != 0,
        message.step as usize,
        &message.data,
        &mut scratch,
    )
    .map_err(|e| e.to_string())?;
    let (width, height, step, format) = (view.width, view.height, view.step, view.format);
    let converted = view.data.as_ptr() != message.data.as_ptr();
    let data = if converted { scratch.data } else { message.data };
    Ok((at, OwnedImage { width, height, step, format, data }))
}
