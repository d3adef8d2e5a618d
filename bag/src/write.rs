//! Writes a bag as rosbag2 does: a lone `.mcap` file, or a folder whose files are split by size or
//! time.

use super::{
    BagError, BagSummary, Topic,
    file_reader::file_size,
    file_writer::{Compression, FileWriter},
    folder::is_mcap_file,
    metadata::{self, FileContents, join},
    qos_from_yaml,
};
use node_kit::files::{self, OutputFile, Pending};
use std::{
    fs, io,
    path::{Path, PathBuf},
};
use volant_msgs::{Message, tf2_msgs::msg::TFMessage};

/// Different messages of a latched topic with transforms, such as `/tf_static`, that a new file
/// repeats. It has one publisher per driver, and the transforms of the latest alone would not do.
const MOST_TRANSFORMS: usize = 64;

/// How a bag is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriteOptions {
    /// Compression of the chunks.
    pub compression: Compression,
    /// A chunk is closed beyond this many bytes.
    pub chunk_bytes: u64,
    /// Bytes of messages after which a new file is started (folders only).
    pub split_bytes: Option<u64>,
    /// Duration after which a new file is started, ns (folders only).
    pub split_nanos: Option<u64>,
    /// Files that are kept when a new one is started: the oldest of this bag are removed (folders
    /// only; at least 1). Each new file then begins with the latest message of every transient
    /// local topic, logged when the file was started.
    pub keep: Option<usize>,
    /// Whether an existing file is replaced; a folder never is.
    pub replace: bool,
    /// Whether a new bag bears its own name from the start, as a recording does: its messages are
    /// readable after a kill. Else it has a temporary name until it is finished.
    pub in_place: bool,
}

impl Default for WriteOptions {
    fn default() -> Self {
        Self {
            compression: Compression::Zstd,
            chunk_bytes: 1 << 20,
            split_bytes: None,
            split_nanos: None,
            keep: None,
            replace: false,
            in_place: false,
        }
    }
}

/// Identifier of a topic in a [`BagWriter`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TopicId(usize);

/// Writer of a bag. Without [`BagWriter::finish`] nothing is left of it; of one that is written in
/// place the closing records are missing, and the messages up to the last [`BagWriter::flush`] are
/// readable.
#[derive(Debug)]
pub struct BagWriter {
    path: PathBuf,
    /// `None`: a lone file.
    folder: Option<PathBuf>,
    /// Temporary name of the folder.
    pending: Option<Pending>,
    options: WriteOptions,
    topics: Vec<WrittenTopic>,
    files: Vec<FileContents>,
    /// Number of the next file.
    next_file: usize,
    /// Writer of the last of the files, and the bytes of its messages.
    current: Option<(FileWriter, u64)>,
}

#[derive(Debug)]
struct WrittenTopic {
    topic: Topic,
    /// Its number in the current file, once it is used there.
    channel: Option<u16>,
    /// What a new file repeats; `None`: nothing.
    latched: Option<Latched>,
}

/// Messages of one topic, oldest first: publish times, ns, and data.
type Latched = Vec<(u64, Vec<u8>)>;

impl BagWriter {
    /// Checks whether a bag may be written before the work for it starts; `inputs` as those of
    /// [`files::check_output`].
    ///
    /// # Errors
    /// [`BagError::Unusable`] where a file exists whose name does not end with `.mcap`, since such
    /// a bag is a folder; the errors of [`files::check_output`].
    pub fn check(path: &Path, replace: bool, inputs: &[&Path]) -> Result<(), BagError> {
        // A file, or a device, which are no place for a folder.
        if !is_mcap_file(path) && fs::symlink_metadata(path).is_ok() && !path.is_dir() {
            let reason = "exists already and is a file, but a bag whose name does not end with \
                          .mcap is a new folder; give another name, or one that ends with .mcap";
            return Err(BagError::unusable(path, reason));
        }
        Ok(files::check_output(path, replace, inputs)?)
    }

    /// Creates a bag: a lone file where the name ends with `.mcap`, else a folder.
    ///
    /// # Errors
    /// The path exists already, or is not writable.
    pub fn create(path: &Path, options: WriteOptions) -> Result<Self, BagError> {
        let lone = is_mcap_file(path);
        Self::check(path, options.replace, &[])?;
        let mut bag = Self {
            path: path.to_owned(),
            folder: None,
            pending: None,
            options,
            topics: vec![],
            files: vec![],
            next_file: 0,
            current: None,
        };
        if !lone {
            if !options.in_place {
                bag.pending = Some(Pending::new(path, false)?);
            }
            let folder = bag.pending.as_ref().map_or(path, |pending| &pending.temporary);
            fs::create_dir_all(folder)
                .map_err(|error| BagError::Io { path: path.to_owned(), error })?;
            bag.folder = Some(folder.to_owned());
        }
        bag.begin_file()?;
        Ok(bag)
    }

    /// Adds a topic; an equal topic returns the same identifier.
    pub fn add_topic(&mut self, topic: Topic) -> TopicId {
        let known = self.topics.iter().position(|t| t.topic == topic);
        TopicId(known.unwrap_or_else(|| {
            let repeated = self.options.keep.is_some()
                && self.folder.is_some()
                && qos_from_yaml(&topic.offered_qos_profiles).transient_local;
            let latched = repeated.then(Vec::new);
            self.topics.push(WrittenTopic { topic, channel: None, latched });
            self.topics.len() - 1
        }))
    }

    /// Appends a message; times in ns.
    ///
    /// # Errors
    /// The file is no longer writable.
    pub fn write(
        &mut self,
        topic: TopicId,
        log_time: u64,
        publish_time: u64,
        data: &[u8],
    ) -> Result<(), BagError> {
        self.split_if_due(log_time)?;
        self.append(topic, log_time, publish_time, data)?;
        self.remember(topic, publish_time, data);
        Ok(())
    }

    fn append(
        &mut self,
        topic: TopicId,
        log_time: u64,
        publish_time: u64,
        data: &[u8],
    ) -> Result<(), BagError> {
        let (Some((writer, bytes)), Some(file)) = (&mut self.current, self.files.last_mut()) else {
            return Ok(());
        };
        file.counts.resize(self.topics.len(), 0);
        let written = &mut self.topics[topic.0];
        let channel = match written.channel {
            Some(channel) => channel,
            None => *written.channel.insert(writer.add_topic(&written.topic)?),
        };
        writer.write(channel, log_time, publish_time, data)?;
        *bytes += data.len() as u64;
        file.counts[topic.0] += 1;
        file.span = join(file.span, Some((log_time, log_time)));
        Ok(())
    }

    /// Keeps a message of a latched topic for the next files.
    fn remember(&mut self, topic: TopicId, publish_time: u64, data: &[u8]) {
        let WrittenTopic { topic, latched: Some(messages), .. } = &mut self.topics[topic.0] else {
            return;
        };
        let has_transforms = topic.type_name == TFMessage::TYPE_NAME;
        let most = if has_transforms { MOST_TRANSFORMS } else { 1 };
        messages.retain(|(_, known)| known.as_slice() != data);
        messages.push((publish_time, data.to_vec()));
        if messages.len() > most {
            messages.remove(0);
        }
    }

    /// Writes the latched messages to a new file: removing the files before it must not lose them.
    fn repeat_latched(&mut self, log_time: u64) -> Result<(), BagError> {
        for topic in 0..self.topics.len() {
            let latched = self.topics[topic].latched.take();
            for (publish_time, data) in latched.iter().flatten() {
                self.append(TopicId(topic), log_time, *publish_time, data)?;
            }
            self.topics[topic].latched = latched;
        }
        // They alone never fill a file.
        if let Some((_, bytes)) = &mut self.current {
            *bytes = 0;
        }
        Ok(())
    }

    /// Serializes and appends a message that was published when it was logged; `time` in ns.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn write_message<M: Message>(
        &mut self,
        topic: TopicId,
        time: u64,
        message: &M,
    ) -> Result<(), BagError> {
        self.write(topic, time, time, &volant_msgs::cdr::to_bytes(message))
    }

    /// Makes all written messages readable, also where the process is killed later.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn flush(&mut self) -> Result<(), BagError> {
        if let Some((writer, _)) = &mut self.current {
            writer.flush()?;
        }
        self.write_metadata()
    }

    /// Closes the bag and summarizes it.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn finish(mut self) -> Result<BagSummary, BagError> {
        self.end_file()?;
        self.write_metadata()?;
        if let Some(pending) = self.pending.take() {
            pending.commit()?;
        }
        let files = self.files.iter().map(|f| match &self.folder {
            Some(_) => self.path.join(&f.path),
            None => self.path.clone(),
        });
        let files: Vec<PathBuf> = files.collect();
        let bytes = files.iter().map(|file| file_size(file)).sum::<Result<u64, _>>()?;
        let span = self.files.iter().map(|f| f.span).fold(None, join);
        let counted = self.counted(&self.files);
        let topics = counted.map(|(topic, count)| (topic.clone(), count)).collect();
        Ok(BagSummary { topics, span, bytes, files, complete: true, losses: vec![] })
    }

    /// The topics with their number of messages in some files.
    fn counted<'a>(&'a self, files: &'a [FileContents]) -> impl Iterator<Item = (&'a Topic, u64)> {
        let count = move |i: usize| files.iter().filter_map(|f| f.counts.get(i)).sum::<u64>();
        self.topics.iter().enumerate().map(move |(i, written)| (&written.topic, count(i)))
    }

    fn split_if_due(&mut self, log_time: u64) -> Result<(), BagError> {
        let (Some(_), Some((_, bytes))) = (&self.folder, &self.current) else { return Ok(()) };
        let Some((start, _)) = self.files.last().and_then(|file| file.span) else { return Ok(()) };
        let WriteOptions { split_bytes, split_nanos, .. } = self.options;
        let large = split_bytes.is_some_and(|limit| *bytes >= limit);
        let long = split_nanos.is_some_and(|limit| log_time.saturating_sub(start) >= limit);
        if large || long {
            self.end_file()?;
            self.begin_file()?;
            self.repeat_latched(log_time)?;
            let removed = self.forget_oldest();
            // First the list without them, so that a reader never misses a file.
            self.write_metadata()?;
            for path in removed {
                fs::remove_file(&path).map_err(|error| BagError::Io { path, error })?;
            }
        }
        Ok(())
    }

    /// Takes the files beyond [`WriteOptions::keep`] out of the bag.
    fn forget_oldest(&mut self) -> Vec<PathBuf> {
        let (Some(folder), Some(keep)) = (&self.folder, self.options.keep) else {
            return vec![];
        };
        let beyond = self.files.len().saturating_sub(keep.max(1));
        self.files.drain(..beyond).map(|file| folder.join(file.path)).collect()
    }

    fn begin_file(&mut self) -> Result<(), BagError> {
        let stem = self.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let name =
            if self.folder.is_some() { format!("{stem}_{}.mcap", self.next_file) } else { stem };
        let path = match &self.folder {
            Some(folder) => folder.join(&name),
            None => self.path.clone(),
        };
        let options = self.options;
        let in_place = self.folder.is_some() || (options.in_place && !path.exists());
        let file = match in_place {
            true => OutputFile::in_place(&path)?,
            false => OutputFile::create(&path, options.replace)?,
        };
        let writer = FileWriter::new(file, &path, options.compression, options.chunk_bytes)?;
        self.next_file += 1;
        self.files.push(FileContents { path: name, span: None, counts: vec![] });
        self.current = Some((writer, 0));
        Ok(())
    }

    fn end_file(&mut self) -> Result<(), BagError> {
        let (Some((mut writer, _)), Some(file)) = (self.current.take(), self.files.last()) else {
            return Ok(());
        };
        for written in &mut self.topics {
            // Topics without messages are announced too.
            if written.channel.take().is_none() {
                writer.add_topic(&written.topic)?;
            }
        }
        // A lone file can be renamed, and two replays must have the same bytes: rosbag2's record,
        // which names the file, belongs to a folder. Without it rosbag2 finds the same in the
        // file's own closing records.
        let file = std::slice::from_ref(file);
        let metadata = self.folder.as_ref().map(|_| metadata::to_yaml(file, self.counted(file)));
        writer.finish(metadata.as_deref())
    }

    /// Replaces `metadata.yaml`, at each flush: a folder whose recorder was killed is a bag.
    fn write_metadata(&self) -> Result<(), BagError> {
        let Some(folder) = &self.folder else {
            return Ok(());
        };
        let yaml = metadata::to_yaml(&self.files, self.counted(&self.files));
        let (new, path) = (folder.join(".metadata.yaml.new"), folder.join("metadata.yaml"));
        let done = |result: io::Result<()>| {
            result.map_err(|error| BagError::Io { path: path.clone(), error })
        };
        done(fs::write(&new, yaml))?;
        done(fs::rename(&new, &path))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BagReader, Qos};
    use volant_msgs::std_msgs::msg::String as Text;

    /// The file with the only messages of latched topics is removed.
    #[test]
    fn each_kept_file_repeats_the_latched_messages() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("kept");
        let options = WriteOptions {
            split_nanos: Some(1_000_000_000),
            keep: Some(1),
            ..WriteOptions::default()
        };
        let mut bag = BagWriter::create(&path, options).unwrap();
        let text = bag.add_topic(Topic::of::<Text>("/text", &Qos::RELIABLE));
        let transforms = bag.add_topic(Topic::of::<TFMessage>("/tf_static", &Qos::LATCHED));
        let latched = bag.add_topic(Topic::of::<Text>("/latched", &Qos::LATCHED));
        // Two publishers of transforms, one of which repeats its message.
        for (time, publisher) in [(0, 1), (1, 2), (2, 1)] {
            bag.write(transforms, time, time, &[publisher; 8]).unwrap();
            bag.write(latched, time, time, &[publisher + 10; 8]).unwrap();
        }
        for i in 0..300 {
            bag.write(text, i * 10_000_000, 0, &[0; 8]).unwrap();
        }
        bag.finish().unwrap();
        let mut reader = BagReader::open(&path).unwrap();
        let messages: Vec<_> = std::iter::from_fn(|| reader.next_message().unwrap()).collect();
        let on = |name: &str| {
            let messages = messages.iter().filter(|m| m.topic.name == name);
            messages.map(|m| (m.data[0], m.log_time, m.publish_time)).collect::<Vec<_>>()
        };
        assert_eq!(on("/text").len(), 100);
        let split = 2_000_000_000;
        assert_eq!(on("/tf_static"), [(2, split, 1), (1, split, 2)]);
        assert_eq!(on("/latched"), [(11, split, 2)]);
    }
}
