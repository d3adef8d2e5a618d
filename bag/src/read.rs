//! Reads a bag from its first message to its last, in the order in which they were logged.

use super::{
    BagError, BagMessage, Topic,
    file_reader::{FileReader, file_size},
    folder::{files_of, is_mcap_file},
    metadata::join,
    summary,
};
use std::{
    collections::{BTreeMap, BTreeSet, VecDeque},
    io::{Read, Seek},
    path::{Path, PathBuf},
};

/// Contents of a bag.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BagSummary {
    /// Topics by name, with their number of messages.
    pub topics: Vec<(Topic, u64)>,
    /// First and last log time, ns, if there is a message.
    pub span: Option<(u64, u64)>,
    /// Bytes of all files.
    pub bytes: u64,
    /// The files.
    pub files: Vec<PathBuf>,
    /// Whether each file ends with MCAP's footer, which rosbag2 requires, and none is damaged, as
    /// far as it was read.
    pub complete: bool,
    /// Descriptions of what is lost of the files that were read completely because their closing
    /// records are missing, one sentence each, as [`BagReader::losses`].
    pub losses: Vec<String>,
}

impl BagSummary {
    /// Messages on a topic.
    pub fn count(&self, topic: &str) -> u64 {
        let on_it = self.topics.iter().filter(|(t, _)| t.name == topic);
        on_it.fold(0, |sum, (_, n)| sum.saturating_add(*n))
    }

    /// Names of the topics of a type that have messages, sorted. A topic whose publishers offer
    /// different QoS has several entries in [`BagSummary::topics`], and one name.
    pub fn topics_of(&self, type_name: &str) -> Vec<&str> {
        let topics = self.topics.iter().filter(|(t, n)| *n > 0 && t.type_name == type_name);
        let names: BTreeSet<&str> = topics.map(|(topic, _)| topic.name.as_str()).collect();
        names.into_iter().collect()
    }

    /// All messages.
    pub fn messages(&self) -> u64 {
        self.topics.iter().fold(0, |sum, (_, n)| sum.saturating_add(*n))
    }
}

/// Reader of a bag.
#[derive(Debug)]
pub struct BagReader {
    waiting: VecDeque<PathBuf>,
    current: Option<FileReader>,
    bytes_before: u64,
    /// Messages that are read and not yet returned, by log time and then by their order in the bag.
    pending: BTreeMap<(u64, u64), BagMessage>,
    /// Bytes in `pending`, and their limit.
    pending_bytes: usize,
    largest_pending: usize,
    /// Earliest log time of the group that was read last: messages logged before it can be
    /// returned, ns.
    horizon: Option<u64>,
    read: u64,
    losses: Vec<String>,
}

/// Bytes of pending messages beyond which the earliest is returned, in order or not: a bag in which
/// one early message follows each late one would otherwise be held in memory completely.
const LARGEST_PENDING: usize = 512 << 20;
/// Memory of a message beside its data, bytes.
const PER_MESSAGE: usize = 128;

impl BagReader {
    /// Opens a lone `.mcap` file or a rosbag2 folder.
    ///
    /// # Errors
    /// No such path, an empty or foreign file, a folder without `metadata.yaml` or with missing
    /// files.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        let mut files: VecDeque<PathBuf> = files_of(path)?.into();
        // Each file's magic is checked now rather than in the middle of a run.
        let mut first = None;
        for file in &files {
            let reader = FileReader::open(file)?;
            first.get_or_insert(reader);
        }
        files.pop_front();
        Ok(Self::over(first, files))
    }

    /// Reads an MCAP file from any input; errors and losses name it `name`.
    ///
    /// # Errors
    /// The input does not start with MCAP's magic.
    pub fn from_reader(name: &Path, input: impl Read + Send + 'static) -> Result<Self, BagError> {
        Ok(Self::over(Some(FileReader::of(name, Box::new(input))?), VecDeque::new()))
    }

    fn over(current: Option<FileReader>, waiting: VecDeque<PathBuf>) -> Self {
        Self {
            waiting,
            current,
            bytes_before: 0,
            pending: BTreeMap::new(),
            pending_bytes: 0,
            largest_pending: LARGEST_PENDING,
            horizon: None,
            read: 0,
            losses: vec![],
        }
    }

    /// Reads the closing records of an MCAP file of `size` bytes; `None` where they are missing or
    /// damaged.
    pub fn closing_records(file: &mut (impl Read + Seek), size: u64) -> Option<BagSummary> {
        summary::summary_of(file, size)
    }

    /// Summarizes a bag from the files' closing records, or by reading all of it where they are
    /// missing.
    ///
    /// # Errors
    /// As [`BagReader::open`], or a file is unreadable.
    pub fn summary(path: &Path) -> Result<BagSummary, BagError> {
        let files = files_of(path)?;
        let mut topics: BTreeMap<Topic, u64> = BTreeMap::new();
        let mut summary = BagSummary { complete: true, ..BagSummary::default() };
        for file in &files {
            summary.bytes += file_size(file)?;
            if let Some(found) = summary::read_summary(file) {
                for (topic, count) in found.topics {
                    let sum = topics.entry(topic).or_default();
                    *sum = sum.saturating_add(count);
                }
                summary.span = join(summary.span, found.span);
            } else {
                let mut reader = FileReader::open(file)?;
                while let Some(group) = reader.next_group()? {
                    for message in group {
                        let time = message.log_time;
                        summary.span = join(summary.span, Some((time, time)));
                        if let Some(count) = topics.get_mut(&*message.topic) {
                            *count += 1;
                        } else {
                            topics.insert((*message.topic).clone(), 1);
                        }
                    }
                }
                // The end of a compressed file is not accessible without reading it all.
                let compressed = file.extension().is_some() && !is_mcap_file(file);
                let ends = compressed || summary::has_footer(file);
                summary.complete &= ends && reader.losses.is_empty();
                summary.losses.append(&mut reader.losses);
            }
        }
        summary.files = files;
        summary.topics = topics.into_iter().collect();
        Ok(summary)
    }

    /// Reads the next message, `None` at the end. Damaged parts of a file are skipped and described
    /// by [`BagReader::losses`].
    ///
    /// # Errors
    /// The operating system fails to read a file. The calls after it return the messages that were
    /// read before.
    pub fn next_message(&mut self) -> Result<Option<BagMessage>, BagError> {
        loop {
            let ready = match (self.pending.first_key_value(), self.horizon) {
                (Some(((time, _), _)), Some(horizon)) => *time < horizon,
                (Some(_), None) => self.at_end(),
                (None, _) if self.at_end() => return Ok(None),
                (None, _) => false,
            };
            if ready || self.pending_bytes > self.largest_pending {
                let message = self.pending.pop_first().map(|(_, message)| message);
                let size = message.as_ref().map_or(0, |m| m.data.len() + PER_MESSAGE);
                self.pending_bytes = self.pending_bytes.saturating_sub(size);
                return Ok(message);
            }
            if let Err(error) = self.read_group() {
                (self.current, self.horizon) = (None, None);
                return Err(error);
            }
        }
    }

    /// Bytes read so far, of [`BagSummary::bytes`] (decompressed bytes of a compressed file).
    pub fn bytes_read(&self) -> u64 {
        self.bytes_before + self.current.as_ref().map_or(0, |file| file.offset)
    }

    /// Descriptions of what was lost, one sentence each, with the file's name.
    pub fn losses(&self) -> &[String] {
        &self.losses
    }

    fn at_end(&self) -> bool {
        self.current.is_none()
    }

    fn read_group(&mut self) -> Result<(), BagError> {
        let Some(file) = &mut self.current else {
            self.horizon = None;
            return Ok(());
        };
        let group = file.next_group();
        self.losses.append(&mut file.losses);
        if let Some(group) = group? {
            // An empty chunk does not move the horizon.
            if let Some(earliest) = group.iter().map(|m| m.log_time).min() {
                self.horizon = Some(earliest);
            }
            for message in group {
                self.pending_bytes += message.data.len() + PER_MESSAGE;
                self.pending.insert((message.log_time, self.read), message);
                self.read += 1;
            }
        } else {
            self.bytes_before += file.offset;
            let next = self.waiting.pop_front();
            self.current = next.map(|path| FileReader::open(&path)).transpose()?;
            if self.current.is_none() {
                self.horizon = None;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BagWriter, Qos, WriteOptions};
    use volant_msgs::std_msgs::msg::String as Text;

    /// An early message follows each late one, so that no message is ever certain to be the next.
    #[test]
    fn a_bag_without_order_is_read_in_bounded_memory() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("x.mcap");
        let options = WriteOptions { chunk_bytes: 1000, ..WriteOptions::default() };
        let mut bag = BagWriter::create(&path, options).unwrap();
        let topic = bag.add_topic(Topic::of::<Text>("/text", &Qos::RELIABLE));
        for k in 0..500 {
            bag.write(topic, 1_000_000 - k, 0, &[0; 200]).unwrap();
        }
        bag.finish().unwrap();
        for (bound, ordered) in [(LARGEST_PENDING, true), (10_000, false)] {
            let mut bag = BagReader::open(&path).unwrap();
            bag.largest_pending = bound;
            let (mut times, mut most) = (vec![], 0);
            while let Some(message) = bag.next_message().unwrap() {
                times.push(message.log_time);
                most = most.max(bag.pending_bytes);
            }
            assert_eq!(times.len(), 500);
            assert_eq!(times.is_sorted(), ordered);
            // One chunk's messages more than the bound.
            assert!(most < bound.saturating_add(5_000), "{most}");
            assert_eq!(bag.pending_bytes, 0);
        }
    }
}
