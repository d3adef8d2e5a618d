//! One MCAP file, read record by record and written: the only place that knows the `mcap` crate.
//!
//! Records are walked here, in chunks too, so that a file that is cut or damaged gives all that stands before, and after, the damage;
//! the crate writes.

use super::{
    BagError, BagMessage, Topic,
    records::{self, Channel, Chunk, Message, Schema, Statistics},
};
use mcap::records::{MessageHeader, op};
use std::{
    collections::{BTreeMap, HashMap},
    fs::File,
    io::{self, BufReader, BufWriter, Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
    sync::Arc,
};

/// Larger records and chunks (decompressed) are taken for damage: an uncompressed 8K image has 100 MB, and a chunk of a
/// few hundred kilobytes can claim, and decompress into, any amount.
const LARGEST_RECORD: usize = 256 << 20;
/// A compressed chunk may become this many bytes however few it has.
const LARGEST_EXPANDED: usize = 32 << 20;
/// Messages outside of chunks are handed on in groups of about this many bytes.
const GROUP: usize = 1 << 20;

/// How chunks are compressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Compression {
    /// Not at all: least work, for JPEG images and live recording.
    None,
    /// A little, and fast.
    Lz4,
    /// More.
    #[default]
    Zstd,
}

/// Walks through a file.
pub(super) struct FileReader {
    path: PathBuf,
    input: Box<dyn Read + Send>,
    offset: u64,
    channels: Channels,
    losses: Vec<String>,
    finished: bool,
}

#[derive(Default)]
struct Channels {
    schemas: HashMap<u16, (String, String)>,
    topics: HashMap<u16, Arc<Topic>>,
}

impl std::fmt::Debug for FileReader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FileReader")
            .field("path", &self.path)
            .field("offset", &self.offset)
            .finish_non_exhaustive()
    }
}

impl FileReader {
    /// Opens a file and looks at its first bytes. A name that ends with `.zstd` is decompressed on the way.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        let error = |source| io_error(path, source);
        let file = File::open(path).map_err(error)?;
        let length = file.metadata().map_err(error)?.len();
        if length == 0 {
            return Err(BagError::Empty { path: path.to_owned() });
        }
        let input: Box<dyn Read + Send> = if path.extension().is_some_and(|e| e == "zstd" || e == "zst") {
            Box::new(zstd::Decoder::new(file).map_err(error)?)
        } else {
            Box::new(BufReader::with_capacity(1 << 16, file))
        };
        Self::of(path, input)
    }

    /// Looks at the first bytes of an input; `path` is what errors name.
    pub fn of(path: &Path, mut input: Box<dyn Read + Send>) -> Result<Self, BagError> {
        let error = |source| io_error(path, source);
        let mut magic = Vec::new();
        input.by_ref().take(mcap::MAGIC.len() as u64).read_to_end(&mut magic).map_err(error)?;
        if magic != mcap::MAGIC {
            return Err(foreign(path, &magic));
        }
        Ok(Self {
            path: path.to_owned(),
            input,
            offset: magic.len() as u64,
            channels: Channels::default(),
            losses: vec![],
            finished: false,
        })
    }

    /// Bytes of the file (decompressed) that are behind.
    pub fn offset(&self) -> u64 {
        self.offset
    }

    /// What was lost so far, one sentence each.
    pub fn losses(&self) -> &[String] {
        &self.losses
    }

    /// The messages of the next chunk, in the order of the file; `None` at the end.
    pub fn next_group(&mut self) -> Result<Option<Vec<BagMessage>>, BagError> {
        let mut group = Vec::new();
        let mut bytes = 0;
        while !self.finished {
            let Some((opcode, length)) = self.record_head()? else {
                break;
            };
            let start = self.offset;
            if length > LARGEST_RECORD as u64 {
                self.lose(format!("a record of {length} bytes at byte {start} cannot be; the rest is lost"));
                break;
            }
            let body = self.body(length as usize)?;
            let cut = (body.len() as u64) < length;
            match opcode {
                op::CHUNK => {
                    self.chunk(&body, length, start, &mut group);
                    if cut {
                        self.cut_off(start);
                    }
                    return Ok(Some(group));
                }
                _ if cut => {
                    self.cut_off(start);
                    break;
                }
                op::FOOTER | op::DATA_END => {
                    self.finished = true;
                    break;
                }
                op::SCHEMA | op::CHANNEL | op::MESSAGE => {
                    if let Err(reason) = self.channels.record(opcode, &body, &mut group) {
                        self.lose(format!("a record at byte {start} is damaged ({reason}); it is skipped"));
                    }
                    bytes += body.len();
                    if bytes > GROUP {
                        return Ok(Some(group));
                    }
                }
                _ => {}
            }
        }
        self.finished = true;
        Ok((!group.is_empty()).then_some(group))
    }

    fn lose(&mut self, what: String) {
        self.losses.push(format!("{}: {what}", self.path.display()));
    }

    fn cut_off(&mut self, at: u64) {
        self.finished = true;
        self.lose(format!(
            "the file is cut off inside the record at byte {at}; everything before the cut is used"
        ));
    }

    /// Operation code and length of the next record; `None` at the end.
    fn record_head(&mut self) -> Result<Option<(u8, u64)>, BagError> {
        let head = self.body(9)?;
        let Some((opcode, length)) = head.split_first().and_then(|(o, l)| Some((*o, l.try_into().ok()?)))
        else {
            self.finished = true;
            // A whole file ends with a footer, which was seen before this.
            self.lose(
                "the file ends without MCAP's closing records (it is cut off, or its recorder was killed); \
                 everything before is used"
                    .into(),
            );
            return Ok(None);
        };
        Ok(Some((opcode, u64::from_le_bytes(length))))
    }

    /// The next bytes, fewer where the file ends. Memory grows with what is there, not with what a length claims.
    fn body(&mut self, length: usize) -> Result<Vec<u8>, BagError> {
        let mut body = Vec::with_capacity(length.min(GROUP));
        let result = self.input.by_ref().take(length as u64).read_to_end(&mut body);
        self.offset += body.len() as u64;
        match result {
            Ok(_) => Ok(body),
            // A compressed file that is cut off.
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => Ok(body),
            Err(e) => Err(io_error(&self.path, e)),
        }
    }

    /// Reads what is in a chunk, or in the beginning of one that is cut: `length` is what the record was meant to have.
    fn chunk(&mut self, body: &[u8], length: u64, at: u64, group: &mut Vec<BagMessage>) {
        let cut = (body.len() as u64) < length;
        let before = group.len();
        let result = match Chunk::parse(body) {
            Some(chunk) => self.records_of(&chunk, cut, group),
            None => Err("its head is cut off".to_owned()),
        };
        if let (Err(reason), false) = (result, cut) {
            let kept = group.len() - before;
            self.lose(format!(
                "the chunk at byte {at} is damaged ({reason}); {kept} of its messages are used, the others are lost"
            ));
        }
    }

    fn records_of(
        &mut self,
        chunk: &Chunk<'_>,
        cut: bool,
        group: &mut Vec<BagMessage>,
    ) -> Result<(), String> {
        let (expanded, outcome): (_, Result<(), String>);
        let records = if chunk.compression.is_empty() {
            outcome = Ok(());
            chunk.records
        } else {
            (expanded, outcome) = expand(chunk);
            &expanded
        };
        // The checksum stands for the whole chunk, which a cut one has not.
        if !cut && chunk.checksum != 0 {
            outcome.clone()?;
            if crc32fast::hash(records) != chunk.checksum {
                return Err("its checksum is wrong".to_owned());
            }
        }
        let mut rest = records;
        while !rest.is_empty() {
            let record = rest.split_first_chunk::<9>().and_then(|([opcode, length @ ..], after)| {
                let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
                Some((*opcode, after.split_at_checked(length)?))
            });
            let Some((opcode, (record, next))) = record else {
                return Err("a record in it is longer than the chunk".to_owned());
            };
            self.channels.record(opcode, record, group)?;
            rest = next;
        }
        outcome
    }
}

/// The records of a compressed chunk as far as they can be had, and what is wrong with it. (The `mcap` crate's reader takes memory
/// for the length that a record claims, and counts below zero where a record is longer than its chunk.)
fn expand(chunk: &Chunk<'_>) -> (Vec<u8>, Result<(), String>) {
    let mut records = Vec::new();
    let claimed = usize::try_from(chunk.expanded_length).unwrap_or(usize::MAX);
    // Few bytes may not become any amount; 1024 is more than zstd makes of any real picture.
    if claimed > chunk.records.len().saturating_mul(1024).clamp(LARGEST_EXPANDED, LARGEST_RECORD) {
        return (records, Err(format!("it claims to hold {claimed} bytes, which cannot be")));
    }
    // One byte more than there may be tells what holds more than it says.
    let most = claimed as u64 + 1;
    let read = match chunk.compression {
        "zstd" => {
            zstd::Decoder::with_buffer(chunk.records).and_then(|d| d.take(most).read_to_end(&mut records))
        }
        "lz4" => lz4::Decoder::new(chunk.records).and_then(|d| d.take(most).read_to_end(&mut records)),
        other => return (records, Err(format!("its compression `{other}` is unknown"))),
    };
    let outcome = match read {
        Err(error) => Err(error.to_string()),
        Ok(_) if records.len() != claimed => {
            Err(format!("it does not hold the {claimed} bytes that it claims"))
        }
        Ok(_) => Ok(()),
    };
    (records, outcome)
}

impl Channels {
    fn record(&mut self, opcode: u8, data: &[u8], group: &mut Vec<BagMessage>) -> Result<(), String> {
        let damaged = || "a length in it is wrong, or a text is not UTF-8".to_owned();
        match opcode {
            op::SCHEMA => {
                let schema = Schema::parse(data).ok_or_else(damaged)?;
                self.schemas.insert(schema.id, (schema.name.to_owned(), definition_of(&schema)));
            }
            op::CHANNEL => {
                let channel = Channel::parse(data).ok_or_else(damaged)?;
                let topic = self.topic_of(&channel);
                // The same channel is repeated in each chunk.
                if self.topics.get(&channel.id).is_none_or(|known| **known != topic) {
                    self.topics.insert(channel.id, Arc::new(topic));
                }
            }
            op::MESSAGE => {
                let message = Message::parse(data).ok_or_else(damaged)?;
                let topic = self
                    .topics
                    .get(&message.channel)
                    .ok_or_else(|| format!("a message of the unknown channel {}", message.channel))?;
                group.push(BagMessage {
                    topic: topic.clone(),
                    log_time: message.log_time,
                    publish_time: message.publish_time,
                    data: message.data.to_vec(),
                });
            }
            _ => {}
        }
        Ok(())
    }

    fn topic_of(&self, channel: &Channel<'_>) -> Topic {
        let (type_name, definition) = self.schemas.get(&channel.schema).cloned().unwrap_or_default();
        Topic {
            type_name,
            definition,
            type_hash: channel.entry("topic_type_hash"),
            offered_qos_profiles: channel.entry("offered_qos_profiles"),
            name: channel.topic.to_owned(),
            message_encoding: channel.message_encoding.to_owned(),
        }
    }
}

/// The `.msg` text, where it is one.
fn definition_of(schema: &Schema<'_>) -> String {
    if schema.encoding == "ros2msg" {
        String::from_utf8_lossy(schema.data).into_owned()
    } else {
        String::new()
    }
}

/// What a file says about itself at its end.
pub(super) struct Summary {
    /// Topics and how many messages each has.
    pub topics: Vec<(Topic, u64)>,
    /// First and last log time, ns, if there is a message.
    pub span: Option<(u64, u64)>,
}

/// Reads the summary of a file; `None` where there is none, or where it is damaged (then the file must be read through).
pub(super) fn read_summary(path: &Path) -> Option<Summary> {
    let mut file = File::open(path).ok()?;
    let size = file.metadata().ok()?.len();
    summary_of(&mut file, size)
}

/// [`read_summary`] of anything that has `size` bytes.
pub(super) fn summary_of(file: &mut (impl Read + Seek), size: u64) -> Option<Summary> {
    /// Footer record (head, two positions, checksum) and the magic after it.
    const CLOSING: u64 = 9 + 20 + 8;
    let footer_at = size.checked_sub(CLOSING)?;
    let closing = read_at(file, footer_at, CLOSING)?;
    let footer = closing
        .strip_prefix(&[op::FOOTER])?
        .strip_suffix(mcap::MAGIC)?
        .strip_prefix(&20_u64.to_le_bytes())?;
    let start = records::summary_start(footer).filter(|start| (1..=footer_at).contains(start))?;
    let section = read_at(file, start, (footer_at - start).min(LARGEST_RECORD as u64))?;
    let mut rest = section.as_slice();
    let (mut channels, mut listed, mut statistics) = (Channels::default(), BTreeMap::new(), None);
    while let Some((head, after)) = rest.split_first_chunk::<9>() {
        let [opcode, length @ ..] = *head;
        let (record, next) = after.split_at_checked(usize::try_from(u64::from_le_bytes(length)).ok()?)?;
        match opcode {
            op::SCHEMA => channels.record(opcode, record, &mut vec![]).ok()?,
            op::CHANNEL => {
                let channel = Channel::parse(record)?;
                listed.insert(channel.id, channel);
            }
            op::STATISTICS => statistics = Some(Statistics::parse(record)?),
            _ => {}
        }
        rest = next;
    }
    let Statistics { messages, start, end, counts } = statistics?;
    // A file whose end is before its start does not know what it holds.
    (start <= end).then_some(())?;
    let count = |id: u16| counts.get(&id).copied().unwrap_or(0);
    let topics = listed.values().map(|channel| (channels.topic_of(channel), count(channel.id))).collect();
    Some(Summary { topics, span: (messages > 0).then_some((start, end)) })
}

fn read_at(file: &mut (impl Read + Seek), at: u64, length: u64) -> Option<Vec<u8>> {
    file.seek(SeekFrom::Start(at)).ok()?;
    let mut bytes = vec![];
    file.take(length).read_to_end(&mut bytes).ok()?;
    (bytes.len() as u64 == length).then_some(bytes)
}

/// Writes a file.
pub(super) struct FileWriter {
    path: PathBuf,
    writer: mcap::Writer<Counting>,
}

/// Counts what was written, so that a bag can be split by size.
struct Counting {
    file: BufWriter<File>,
    written: u64,
}

impl Write for Counting {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.file.write(bytes)?;
        self.written += count as u64;
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.file.flush()
    }
}

impl Seek for Counting {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

impl std::fmt::Debug for FileWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FileWriter").field("path", &self.path).finish_non_exhaustive()
    }
}

impl FileWriter {
    /// Starts a file, in the place of one that is there.
    pub fn create(path: &Path, compression: Compression, chunk_size: u64) -> Result<Self, BagError> {
        let file = File::create(path).map_err(|source| io_error(path, source))?;
        let options = mcap::WriteOptions::new()
            .profile("ros2")
            .library(concat!("volant ", env!("CARGO_PKG_VERSION")))
            .compression(match compression {
                Compression::None => None,
                Compression::Lz4 => Some(mcap::Compression::Lz4),
                Compression::Zstd => Some(mcap::Compression::Zstd),
            })
            // The bytes must not depend on how many cores there are.
            .compression_threads(0)
            .chunk_size(Some(chunk_size))
            // A chunk is written whole: a recorder that is killed leaves whole chunks.
            .disable_seeking(true);
        let counting = Counting { file: BufWriter::with_capacity(1 << 16, file), written: 0 };
        let writer = options.create(counting).map_err(|e| mcap_error(path, e))?;
        Ok(Self { path: path.to_owned(), writer })
    }

    /// Announces a topic.
    pub fn add_topic(&mut self, topic: &Topic) -> Result<u16, BagError> {
        let encoding = if topic.type_name.is_empty() { "" } else { "ros2msg" };
        let metadata = BTreeMap::from([
            ("offered_qos_profiles".to_owned(), topic.offered_qos_profiles.clone()),
            ("topic_type_hash".to_owned(), topic.type_hash.clone()),
        ]);
        self.writer
            .add_schema(&topic.type_name, encoding, topic.definition.as_bytes())
            .and_then(|schema| {
                self.writer.add_channel(schema, &topic.name, &topic.message_encoding, &metadata)
            })
            .map_err(|e| mcap_error(&self.path, e))
    }

    /// Appends a message.
    pub fn write(
        &mut self,
        channel: u16,
        log_time: u64,
        publish_time: u64,
        data: &[u8],
    ) -> Result<(), BagError> {
        let header = MessageHeader { channel_id: channel, sequence: 0, log_time, publish_time };
        self.writer.write_to_known_channel(&header, data).map_err(|e| mcap_error(&self.path, e))
    }

    /// Closes the chunk and hands all to the operating system.
    pub fn flush(&mut self) -> Result<(), BagError> {
        self.writer.flush().map_err(|e| mcap_error(&self.path, e))
    }

    /// Ends the file, with rosbag2's metadata in it where there is one.
    pub fn finish(mut self, rosbag2_metadata: Option<&str>) -> Result<(), BagError> {
        if let Some(text) = rosbag2_metadata {
            let metadata = mcap::records::Metadata {
                name: "rosbag2".to_owned(),
                metadata: BTreeMap::from([("serialized_metadata".to_owned(), text.to_owned())]),
            };
            self.writer.write_metadata(&metadata).map_err(|e| mcap_error(&self.path, e))?;
        }
        self.writer.finish().map_err(|e| mcap_error(&self.path, e))?;
        let mut out = self.writer.into_inner();
        out.flush().map_err(|source| io_error(&self.path, source))
    }
}

fn io_error(path: &Path, source: io::Error) -> BagError {
    if source.kind() == io::ErrorKind::NotFound {
        BagError::NotFound { path: path.to_owned() }
    } else {
        BagError::Io { path: path.to_owned(), source }
    }
}

fn mcap_error(path: &Path, error: mcap::McapError) -> BagError {
    match error {
        mcap::McapError::Io(source) => io_error(path, source),
        other => BagError::Damaged { path: path.to_owned(), reason: other.to_string() },
    }
}

fn foreign(path: &Path, magic: &[u8]) -> BagError {
    let (what, remedy) = if magic.starts_with(b"SQLite") {
        ("it is an SQLite database", "convert it with `ros2 bag convert`, or record with `-s mcap`")
    } else if magic.starts_with(b"#ROSBAG") {
        ("it is a ROS 1 bag", "convert it, for instance with `rosbags-convert`")
    } else if magic.starts_with(&[0x28, 0xb5, 0x2f, 0xfd]) {
        ("it is compressed as a whole", "name it .mcap.zstd, or decompress it with `zstd -d`")
    } else if magic.len() < mcap::MAGIC.len() {
        ("it has only a few bytes", "record it again, or give another one")
    } else {
        ("its first bytes are not MCAP's", "give an .mcap file or a rosbag2 folder")
    };
    BagError::Foreign { path: path.to_owned(), what: what.to_owned(), remedy }
}
