//! Reads a bag from its first message to its last, in the order in which they were logged.

use super::{BagError, BagMessage, Topic, mcap_file, mcap_file::FileReader, metadata::Folder};
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap, VecDeque},
    fs,
    path::{Path, PathBuf},
};

/// What is in a bag.
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
    /// Whether each file has its closing records; rosbag2 takes no other.
    pub complete: bool,
}

impl BagSummary {
    /// Messages on a topic.
    pub fn count(&self, topic: &str) -> u64 {
        self.topics.iter().filter(|(t, _)| t.name == topic).map(|(_, n)| n).sum()
    }

    /// All messages.
    pub fn messages(&self) -> u64 {
        self.topics.iter().map(|(_, n)| n).sum()
    }
}

/// A bag that is being read.
#[derive(Debug)]
pub struct BagReader {
    waiting: VecDeque<PathBuf>,
    current: Option<FileReader>,
    bytes_before: u64,
    /// Messages that are read and not yet handed on, by log time and then by their order in the bag.
    pending: BinaryHeap<Reverse<Pending>>,
    /// Earliest log time of the group that was read last: what is logged before it can be handed on.
    horizon: Option<u64>,
    read: u64,
    losses: Vec<String>,
}

#[derive(Debug)]
struct Pending {
    key: (u64, u64),
    message: BagMessage,
}

impl PartialEq for Pending {
    fn eq(&self, other: &Self) -> bool {
        self.key == other.key
    }
}
impl Eq for Pending {}
impl PartialOrd for Pending {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Pending {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.key.cmp(&other.key)
    }
}

impl BagReader {
    /// Opens a lone `.mcap` file or a rosbag2 folder.
    ///
    /// # Errors
    /// Nothing there, an empty or foreign file, a folder without `metadata.yaml` or with files that are missing.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        let mut files: VecDeque<PathBuf> = files_of(path)?.into();
        // Each file's first bytes are looked at now: better a refusal than half a run.
        let mut first = None;
        for file in &files {
            let reader = FileReader::open(file)?;
            first.get_or_insert(reader);
        }
        files.pop_front();
        Ok(Self {
            waiting: files,
            current: first,
            bytes_before: 0,
            pending: BinaryHeap::new(),
            horizon: None,
            read: 0,
            losses: vec![],
        })
    }

    /// What the bag holds: from the files' closing records, or by reading it all where they are missing.
    ///
    /// # Errors
    /// As [`BagReader::open`], and where a file cannot be read.
    pub fn summary(path: &Path) -> Result<BagSummary, BagError> {
        let files = files_of(path)?;
        let mut topics: BTreeMap<Topic, u64> = BTreeMap::new();
        let mut summary = BagSummary { complete: true, ..BagSummary::default() };
        let join = |a: Option<(u64, u64)>, b: (u64, u64)| a.map_or(b, |a| (a.0.min(b.0), a.1.max(b.1)));
        for file in &files {
            let bytes =
                fs::metadata(file).map_err(|source| BagError::Io { path: file.clone(), source })?.len();
            summary.bytes += bytes;
            if let Some(found) = mcap_file::read_summary(file) {
                for (topic, count) in found.topics {
                    *topics.entry(topic).or_default() += count;
                }
                summary.span = found.span.map(|s| join(summary.span, s)).or(summary.span);
            } else {
                let mut reader = FileReader::open(file)?;
                while let Some(group) = reader.next_group()? {
                    for message in group {
                        summary.span = Some(join(summary.span, (message.log_time, message.log_time)));
                        if let Some(count) = topics.get_mut(&*message.topic) {
                            *count += 1;
                        } else {
                            topics.insert((*message.topic).clone(), 1);
                        }
                    }
                }
                // Compressed as a whole, a file's end cannot be looked at alone.
                let compressed = file.extension().is_some_and(|e| e != "mcap");
                summary.complete &= compressed && reader.losses().is_empty();
            }
        }
        summary.files = files;
        summary.topics = topics.into_iter().collect();
        Ok(summary)
    }

    /// The next message, `None` at the end. A file that is cut off or damaged ends or skips, and
    /// [`BagReader::losses`] says so.
    ///
    /// # Errors
    /// Where the operating system does not give the bytes.
    pub fn next_message(&mut self) -> Result<Option<BagMessage>, BagError> {
        loop {
            let ready = match (self.pending.peek(), self.horizon) {
                (Some(Reverse(first)), Some(horizon)) => first.key.0 < horizon,
                (Some(_), None) => self.at_end(),
                (None, _) if self.at_end() => return Ok(None),
                (None, _) => false,
            };
            if ready {
                return Ok(self.pending.pop().map(|Reverse(p)| p.message));
            }
            self.read_group()?;
        }
    }

    /// Bytes that are behind, of [`BagSummary::bytes`] (of the decompressed ones where a file is compressed as a whole).
    pub fn bytes_read(&self) -> u64 {
        self.bytes_before + self.current.as_ref().map_or(0, FileReader::offset)
    }

    /// What was lost, one sentence each, with the file's name.
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
        if let Some(group) = file.next_group()? {
            // An empty chunk says nothing about what is to come.
            if let Some(earliest) = group.iter().map(|m| m.log_time).min() {
                self.horizon = Some(earliest);
            }
            for message in group {
                self.pending.push(Reverse(Pending { key: (message.log_time, self.read), message }));
                self.read += 1;
            }
        } else {
            self.losses.extend_from_slice(file.losses());
            self.bytes_before += file.offset();
            self.current = match self.waiting.pop_front() {
                Some(path) => Some(FileReader::open(&path)?),
                None => None,
            };
            if self.current.is_none() {
                self.horizon = None;
            }
        }
        Ok(())
    }
}

/// The `.mcap` files of a bag in their order.
fn files_of(path: &Path) -> Result<Vec<PathBuf>, BagError> {
    let io = |source: std::io::Error| {
        if source.kind() == std::io::ErrorKind::NotFound {
            BagError::NotFound { path: path.to_owned() }
        } else {
            BagError::Io { path: path.to_owned(), source }
        }
    };
    if !fs::metadata(path).map_err(io)?.is_dir() {
        return Ok(vec![path.to_owned()]);
    }
    let yaml = path.join("metadata.yaml");
    let broken = |reason: String| BagError::Metadata { path: yaml.clone(), reason };
    let text = match fs::read_to_string(&yaml) {
        Ok(text) => text,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            return Err(broken("is missing, so this folder is not a rosbag2 bag".into()));
        }
        Err(source) => return Err(BagError::Io { path: yaml.clone(), source }),
    };
    let folder = Folder::parse(&text).map_err(&broken)?;
    if folder.storage != "mcap" {
        return Err(BagError::Foreign {
            path: path.to_owned(),
            what: format!("its storage is `{}`", folder.storage),
            remedy: "convert it with `ros2 bag convert`, or record with `-s mcap`",
        });
    }
    if folder.compression_mode == "message" || !matches!(&*folder.compression_format, "" | "zstd") {
        return Err(BagError::Foreign {
            path: path.to_owned(),
            what: format!(
                "its messages are compressed one by one, mode `{}`, format `{}`",
                folder.compression_mode, folder.compression_format
            ),
            remedy: "convert it with `ros2 bag convert` without compression",
        });
    }
    if folder.files.is_empty() {
        return Err(broken("names no file".into()));
    }
    let files: Vec<PathBuf> = folder.files.iter().map(|name| path.join(name)).collect();
    if let Some(missing) = files.iter().find(|f| !f.exists()) {
        return Err(broken(format!("names {}, which is not there", missing.display())));
    }
    Ok(files)
}
