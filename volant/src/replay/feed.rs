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
    Lost(Vec<String>),
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
    bytes_read: Arc<AtomicU64>,
    losses: Vec<String>,
    threads: Vec<JoinHandle<()>>,
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
        let bytes_read = Arc::new(AtomicU64::new(0));
        let (job_sender, jobs) = sync_channel::<Job>(AHEAD);
        let jobs = Arc::new(Mutex::new(jobs));
        let compressed = matches!(images, Some(ImageTopic::Compressed(_)));
        let mut threads = vec![];
        for _ in 0..workers.max(1) {
            let jobs = jobs.clone();
            threads.push(std::thread::spawn(move || decode_all(&jobs, compressed)));
        }
        let (slot_sender, slots) = sync_channel(8 * AHEAD);
        let reading = bytes_read.clone();
        threads.push(std::thread::spawn(move || {
            read_all(reader, images.as_ref(), &wanted, &slot_sender, &job_sender, &reading);
        }));
        Ok(Self { slots: Some(slots), bytes_read, losses: vec![], threads })
    }

    /// Returns the next item, and waits for its image to be decoded; `None` at the end.
    ///
    /// # Errors
    /// The operating system fails to read the bag.
    pub fn take(&mut self) -> Result<Option<Fed>, BagError> {
        while let Some(slot) = self.slots.as_ref().and_then(|slots| slots.recv().ok()) {
            let fed = match slot {
                Slot::Lost(losses) => {
                    self.losses.extend(losses);
                    continue;
                }
                Slot::Message(message) => Fed::Message(message),
                Slot::Image(image) => {
                    Fed::Image(image.recv().unwrap_or_else(|_| Err("the decoder has ended".into())))
                }
                Slot::Failed(error) => return Err(error),
            };
            return Ok(Some(fed));
        }
        Ok(None)
    }

    /// Bytes of the bag read so far.
    pub fn bytes_read(&self) -> u64 {
        self.bytes_read.load(Ordering::Relaxed)
    }

    /// Losses of the bag that were found up to the last item that was returned; all of them at its
    /// end.
    pub fn losses(&self) -> &[String] {
        &self.losses
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
    bytes_read: &AtomicU64,
) {
    let mut reported = 0;
    loop {
        let next = reader.next_message();
        // In their place, so that a consumer that ends early knows the same ones each time.
        let losses = reader.losses()[reported..].to_vec();
        reported += losses.len();
        if !losses.is_empty() && slots.send(Slot::Lost(losses)).is_err() {
            return;
        }
        let slot = match next {
            Ok(Some(message)) => {
                bytes_read.store(reader.bytes_read(), Ordering::Relaxed);
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
            Ok(None) => return,
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
