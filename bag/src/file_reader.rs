//! Reads one MCAP file record by record, as far as it is whole.
//!
//! The readers of mcap 0.26.0 do not serve here. Its `LinearReader` ends at the first damaged chunk
//! instead of continuing after it, keeps the bytes of a chunk that is cut off to itself, and
//! decrements its count of bytes below zero where a record is longer than its chunk;
//! `IndexedReader` and `MessageStream` need the closing records, which a cut file lacks. A
//! recording whose recorder lost power must give all messages before, and after, the damage.

use crate::{BagError, BagMessage, channels::Channels, records::Chunk, summary};
use mcap::records::op;
use std::{
    fs::{self, File},
    io::{self, BufReader, Read, Seek},
    path::{Path, PathBuf},
};

/// Longest record and decompressed chunk, bytes; longer ones are damage. An uncompressed 8K image
/// has 100 MB, and a chunk of a few hundred kilobytes can decompress into any amount.
pub(crate) const LARGEST_RECORD: usize = 256 << 20;
/// Decompressed length that is accepted of a chunk of any compressed length, bytes.
const LARGEST_EXPANDED: usize = 32 << 20;
/// Messages outside of chunks are returned in groups of about this many bytes.
const GROUP: usize = 1 << 20;

/// Reader of one file, from its first record to its last.
pub(crate) struct FileReader {
    path: PathBuf,
    input: Box<dyn Read + Send>,
    /// Bytes of the (decompressed) file that have been read.
    pub offset: u64,
    channels: Channels,
    /// Descriptions of what was lost so far, one sentence each.
    pub losses: Vec<String>,
    finished: bool,
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
    /// Opens a file and checks its magic. A file whose name ends with `.zstd` or `.zst` is
    /// decompressed while it is read; of others the closing records are read first, because a
    /// damaged chunk may be the only other place that announces a channel.
    ///
    /// # Errors
    /// A missing, empty, unreadable or foreign file.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        let error = |source| io_error(path, source);
        let mut file = File::open(path).map_err(error)?;
        let length = file.metadata().map_err(error)?.len();
        if length == 0 {
            let reason = "the file is empty; record it again, or give another one";
            return Err(BagError::unusable(path, reason));
        }
        if path.extension().is_some_and(|e| e == "zstd" || e == "zst") {
            return Self::of(path, Box::new(zstd::Decoder::new(file).map_err(error)?));
        }
        let channels = summary::channels_of(&mut file, length);
        file.rewind().map_err(error)?;
        let input = Box::new(BufReader::with_capacity(1 << 16, file));
        Ok(Self { channels, ..Self::of(path, input)? })
    }

    /// Checks the magic of an input; errors name it `path`.
    ///
    /// # Errors
    /// The input is unreadable, or does not start with MCAP's magic.
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

    /// Reads the messages of the next chunk, in the order of the file; `None` at the end.
    ///
    /// # Errors
    /// The operating system fails to read the file.
    pub fn next_group(&mut self) -> Result<Option<Vec<BagMessage>>, BagError> {
        let mut group = Vec::new();
        let mut bytes = 0;
        while !self.finished {
            let Some((opcode, length)) = self.record_head()? else {
                break;
            };
            let start = self.offset;
            if length > LARGEST_RECORD as u64 {
                self.lose(format!(
                    "the record at byte {start} claims an invalid length of {length} bytes; the \
                     rest is lost"
                ));
                break;
            }
            let body = self.body(length as usize)?;
            let cut = (body.len() as u64) < length;
            match opcode {
                op::CHUNK => {
                    self.chunk(&body, cut, start, &mut group);
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
                        self.lose(format!(
                            "a record at byte {start} is damaged ({reason}); it is skipped"
                        ));
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
        let Some((opcode, length)) =
            head.split_first().and_then(|(o, l)| Some((*o, l.try_into().ok()?)))
        else {
            self.finished = true;
            // An intact file ends with a footer, which ends the loop before this.
            self.lose(
                "the file ends without MCAP's closing records (it is cut off, or its recorder was \
                 killed); \
                 everything before is used"
                    .into(),
            );
            return Ok(None);
        };
        Ok(Some((opcode, u64::from_le_bytes(length))))
    }

    /// The next bytes, fewer where the file ends. Memory grows with what is there, not with what a
    /// length claims.
    fn body(&mut self, length: usize) -> Result<Vec<u8>, BagError> {
        let mut body = Vec::with_capacity(length.min(GROUP));
        let result = self.input.by_ref().take(length as u64).read_to_end(&mut body);
        self.offset += body.len() as u64;
        match result {
            Ok(_) => Ok(body),
            // A compressed file that is cut off.
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => Ok(body),
            // The operating system's errors have a number, those of the decompression have none.
            Err(e) if e.raw_os_error().is_none() => {
                self.lose(format!("its compression is damaged ({e})"));
                Ok(body)
            }
            Err(e) => Err(io_error(&self.path, e)),
        }
    }

    /// Reads the records of a chunk, or of the first part of one that is cut off.
    fn chunk(&mut self, body: &[u8], cut: bool, at: u64, group: &mut Vec<BagMessage>) {
        let before = group.len();
        let result = match Chunk::parse(body) {
            Some(chunk) => self.records_of(&chunk, cut, group),
            None => Err("its head is cut off".to_owned()),
        };
        if let (Err(reason), false) = (result, cut) {
            let kept = group.len() - before;
            self.lose(format!(
                "the chunk at byte {at} is damaged ({reason}); {kept} of its messages are used, \
                 the others are lost"
            ));
        }
    }

    fn records_of(
        &mut self,
        chunk: &Chunk<'_>,
        cut: bool,
        group: &mut Vec<BagMessage>,
    ) -> Result<(), String> {
        let (expanded, mut outcome): (_, Result<(), String>);
        let records = if chunk.compression.is_empty() {
            outcome = Ok(());
            chunk.records
        } else {
            (expanded, outcome) = expand(chunk);
            &expanded
        };
        // The checksum covers the complete chunk.
        if !cut && chunk.checksum != 0 {
            if outcome.is_ok() && crc32fast::hash(records) != chunk.checksum {
                outcome = Err("its checksum is wrong".to_owned());
            }
            if outcome.is_err() {
                // Its messages are not trusted, but later chunks may need its channels.
                let mut found = Channels::default();
                let _ = found.records(records, &mut vec![]);
                self.channels.supplement(found);
                return outcome;
            }
        }
        self.channels.records(records, group).and(outcome)
    }
}

/// Decompresses a chunk as far as possible; also returns why it is damaged.
fn expand(chunk: &Chunk<'_>) -> (Vec<u8>, Result<(), String>) {
    let mut records = Vec::new();
    let claimed = usize::try_from(chunk.expanded_length).unwrap_or(usize::MAX);
    // A limit against decompression bombs; zstd compresses no real image by a factor of 1024.
    if claimed > chunk.records.len().saturating_mul(1024).clamp(LARGEST_EXPANDED, LARGEST_RECORD) {
        return (records, Err(format!("it claims an invalid length of {claimed} bytes")));
    }
    // One byte more than claimed detects a chunk that holds more.
    let most = claimed as u64 + 1;
    let read = match chunk.compression {
        "zstd" => zstd::Decoder::with_buffer(chunk.records)
            .and_then(|d| d.take(most).read_to_end(&mut records)),
        "lz4" => {
            lz4::Decoder::new(chunk.records).and_then(|d| d.take(most).read_to_end(&mut records))
        }
        other => return (records, Err(format!("its compression `{other}` is unknown"))),
    };
    let outcome = match read {
        Err(error) => Err(error.to_string()),
        Ok(_) if records.len() != claimed => {
            Err(format!("its length is not the {claimed} bytes that it claims"))
        }
        Ok(_) => Ok(()),
    };
    (records, outcome)
}

/// The error of an operation on the file at `path`.
pub(crate) fn io_error(path: &Path, error: io::Error) -> BagError {
    if error.kind() == io::ErrorKind::NotFound {
        let reason = "no such file or folder; give an .mcap file or a rosbag2 folder";
        BagError::unusable(path, reason)
    } else {
        BagError::Io { path: path.to_owned(), error }
    }
}

/// Size of the file at `path`, bytes.
pub(crate) fn file_size(path: &Path) -> Result<u64, BagError> {
    Ok(fs::metadata(path).map_err(|source| io_error(path, source))?.len())
}

fn foreign(path: &Path, magic: &[u8]) -> BagError {
    let what = if magic.starts_with(b"SQLite") {
        ("it is an SQLite database", "convert it with `ros2 bag convert`, or record with `-s mcap`")
    } else if magic.starts_with(b"#ROSBAG") {
        ("it is a ROS 1 bag", "convert it, for instance with `rosbags-convert`")
    } else if magic.starts_with(&[0x28, 0xb5, 0x2f, 0xfd]) {
        ("the whole file is compressed", "name it .mcap.zstd, or decompress it with `zstd -d`")
    } else if magic.len() < mcap::MAGIC.len() {
        ("it has only a few bytes", "record it again, or give another one")
    } else {
        ("its first bytes are not MCAP's", "give an .mcap file or a rosbag2 folder")
    };
    BagError::foreign(path, what)
}
