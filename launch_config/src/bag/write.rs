//! Writes a bag as rosbag2 does: a lone `.mcap` file, or a folder whose files are split by size or time.

use super::{
    BagError, BagSummary, Topic,
    mcap_file::{Compression, FileWriter},
    metadata::{self, FileContents},
};
use std::{
    fs, io,
    path::{Path, PathBuf},
};

/// How a bag is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriteOptions {
    /// Of the chunks.
    pub compression: Compression,
    /// A chunk is closed beyond this many bytes.
    pub chunk_bytes: u64,
    /// A new file is begun beyond this many bytes of messages (folders only).
    pub split_bytes: Option<u64>,
    /// A new file is begun after this time, ns (folders only).
    pub split_nanos: Option<u64>,
    /// Whether a bag or file that is there already is replaced.
    pub replace: bool,
}

impl Default for WriteOptions {
    fn default() -> Self {
        Self {
            compression: Compression::Zstd,
            chunk_bytes: 1 << 20,
            split_bytes: None,
            split_nanos: None,
            replace: false,
        }
    }
}

/// A topic of a [`BagWriter`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TopicId(usize);

/// A bag that is being written. Without [`BagWriter::finish`] it stays without its closing records: its messages can be
/// read, up to the last [`BagWriter::flush`].
#[derive(Debug)]
pub struct BagWriter {
    path: PathBuf,
    /// `None`: a lone file.
    folder: Option<PathBuf>,
    options: WriteOptions,
    topics: Vec<(Topic, u64)>,
    files: Vec<FileContents>,
    current: Option<Current>,
    bytes: u64,
}

#[derive(Debug)]
struct Current {
    writer: FileWriter,
    /// The file's number of each topic, once it is used there.
    channels: Vec<Option<u16>>,
    topics: Vec<u64>,
    bytes: u64,
}

impl BagWriter {
    /// Begins a bag: a lone file where the name ends with `.mcap`, else a folder.
    ///
    /// # Errors
    /// Something is there already, or the place cannot be written to.
    pub fn create(path: &Path, options: WriteOptions) -> Result<Self, BagError> {
        let lone = path.extension().is_some_and(|e| e == "mcap");
        if path.exists() {
            // Only a file is ever replaced: a folder could be anything.
            if !(lone && options.replace && path.is_file()) {
                return Err(BagError::Exists { path: path.to_owned() });
            }
        } else if !lone {
            fs::create_dir_all(path).map_err(|source| BagError::Io { path: path.to_owned(), source })?;
        }
        let mut bag = Self {
            path: path.to_owned(),
            folder: (!lone).then(|| path.to_owned()),
            options,
            topics: vec![],
            files: vec![],
            current: None,
            bytes: 0,
        };
        bag.begin_file()?;
        Ok(bag)
    }

    /// Announces a topic; the same topic twice is one.
    pub fn add_topic(&mut self, topic: Topic) -> TopicId {
        let known = self.topics.iter().position(|(t, _)| *t == topic);
        TopicId(known.unwrap_or_else(|| {
            self.topics.push((topic, 0));
            self.topics.len() - 1
        }))
    }

    /// Appends a message; times in ns.
    ///
    /// # Errors
    /// The place cannot be written to any more.
    pub fn write(
        &mut self,
        topic: TopicId,
        log_time: u64,
        publish_time: u64,
        data: &[u8],
    ) -> Result<(), BagError> {
        self.split_if_due(log_time)?;
        let Some(current) = &mut self.current else {
            return Ok(());
        };
        if current.channels.len() < self.topics.len() {
            current.channels.resize(self.topics.len(), None);
            current.topics.resize(self.topics.len(), 0);
        }
        let channel = match current.channels[topic.0] {
            Some(channel) => channel,
            None => {
                let channel = current.writer.add_topic(&self.topics[topic.0].0)?;
                current.channels[topic.0] = Some(channel);
                channel
            }
        };
        current.writer.write(channel, log_time, publish_time, data)?;
        current.bytes += data.len() as u64;
        current.topics[topic.0] += 1;
        self.bytes += data.len() as u64;
        self.topics[topic.0].1 += 1;
        if let Some(file) = self.files.last_mut() {
            file.count += 1;
            file.span =
                Some(file.span.map_or((log_time, log_time), |(a, b)| (a.min(log_time), b.max(log_time))));
        }
        Ok(())
    }

    /// Appends a message that was sent when it was logged.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn write_message<M: volant_msgs::Message>(
        &mut self,
        topic: TopicId,
        time: u64,
        message: &M,
    ) -> Result<(), BagError> {
        self.write(topic, time, time, &volant_msgs::cdr::to_bytes(message))
    }

    /// Makes what was written so far readable, whatever happens next.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn flush(&mut self) -> Result<(), BagError> {
        if let Some(current) = &mut self.current {
            current.writer.flush()?;
        }
        self.write_metadata()
    }

    /// Bytes of messages so far.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Ends the bag.
    ///
    /// # Errors
    /// As [`BagWriter::write`].
    pub fn finish(mut self) -> Result<BagSummary, BagError> {
        self.end_file()?;
        self.write_metadata()?;
        let folder = self.folder.clone();
        let files = self.files.iter().map(|f| match &folder {
            Some(folder) => folder.join(&f.path),
            None => self.path.clone(),
        });
        let files: Vec<PathBuf> = files.collect();
        let mut bytes = 0;
        for file in &files {
            bytes += fs::metadata(file).map_err(|source| BagError::Io { path: file.clone(), source })?.len();
        }
        let span = self.files.iter().filter_map(|f| f.span).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
        Ok(BagSummary { topics: self.topics, span, bytes, files, complete: true })
    }

    fn split_if_due(&mut self, log_time: u64) -> Result<(), BagError> {
        if self.folder.is_none() {
            return Ok(());
        }
        let (Some(current), Some(file)) = (&self.current, self.files.last()) else {
            return Ok(());
        };
        let large = self.options.split_bytes.is_some_and(|limit| current.bytes >= limit);
        let long = match (self.options.split_nanos, file.span) {
            (Some(limit), Some((start, _))) => log_time.saturating_sub(start) >= limit,
            _ => false,
        };
        if file.count > 0 && (large || long) {
            self.end_file()?;
            self.begin_file()?;
            self.write_metadata()?;
        }
        Ok(())
    }

    fn begin_file(&mut self) -> Result<(), BagError> {
        let stem = self.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let name = if self.folder.is_some() { format!("{stem}_{}.mcap", self.files.len()) } else { stem };
        let path = match &self.folder {
            Some(folder) => folder.join(&name),
            None => self.path.clone(),
        };
        let writer = FileWriter::create(&path, self.options.compression, self.options.chunk_bytes)?;
        self.files.push(FileContents { path: name, span: None, count: 0 });
        self.current = Some(Current { writer, channels: vec![], topics: vec![], bytes: 0 });
        Ok(())
    }

    fn end_file(&mut self) -> Result<(), BagError> {
        let (Some(mut current), Some(file)) = (self.current.take(), self.files.last()) else {
            return Ok(());
        };
        current.channels.resize(self.topics.len(), None);
        current.topics.resize(self.topics.len(), 0);
        // A topic without a message is announced all the same.
        for ((topic, _), channel) in self.topics.iter().zip(&current.channels) {
            if channel.is_none() {
                current.writer.add_topic(topic)?;
            }
        }
        let topics = self.topics.iter().map(|(t, _)| t).zip(current.topics.iter().copied());
        // A lone file can be renamed, and two replays must have the same bytes: rosbag2's record, which names the file,
        // belongs to a folder. Without it rosbag2 finds the same in the file's own closing records.
        let metadata = self.folder.as_ref().map(|_| metadata::to_yaml(std::slice::from_ref(file), topics));
        current.writer.finish(metadata.as_deref())
    }

    /// Written anew at each flush, so that a folder whose recorder was killed is a bag.
    fn write_metadata(&self) -> Result<(), BagError> {
        let Some(folder) = &self.folder else {
            return Ok(());
        };
        let yaml = metadata::to_yaml(&self.files, self.topics.iter().map(|(t, n)| (t, *n)));
        let (new, path) = (folder.join(".metadata.yaml.new"), folder.join("metadata.yaml"));
        let done =
            |result: io::Result<()>| result.map_err(|source| BagError::Io { path: path.clone(), source });
        done(fs::write(&new, yaml))?;
        done(fs::rename(&new, &path))
    }
}
