//! Writes one MCAP file with the `mcap` crate's writer.

use crate::{BagError, Topic, file_reader::io_error};
use mcap::records::MessageHeader;
use node_kit::files::OutputFile;
use std::{
    collections::BTreeMap,
    io::BufWriter,
    path::{Path, PathBuf},
};

/// Compression of the chunks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "clap", derive(clap::ValueEnum))]
pub enum Compression {
    /// None: least work, for JPEG images and live recording
    None,
    /// LZ4: fast
    Lz4,
    /// Zstandard: smallest
    #[default]
    Zstd,
}

/// Writer of one file.
pub(crate) struct FileWriter {
    path: PathBuf,
    writer: mcap::Writer<BufWriter<OutputFile>>,
}

impl std::fmt::Debug for FileWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FileWriter").field("path", &self.path).finish_non_exhaustive()
    }
}

impl FileWriter {
    /// Starts a file; `path` is its name in errors.
    ///
    /// # Errors
    /// The file is not writable.
    pub fn new(
        file: OutputFile,
        path: &Path,
        compression: Compression,
        chunk_size: u64,
    ) -> Result<Self, BagError> {
        let options = mcap::WriteOptions::new()
            .profile("ros2")
            .library(concat!("volant ", env!("CARGO_PKG_VERSION")))
            .compression(match compression {
                Compression::None => None,
                Compression::Lz4 => Some(mcap::Compression::Lz4),
                Compression::Zstd => Some(mcap::Compression::Zstd),
            })
            // The bytes must not depend on the number of cores.
            .compression_threads(0)
            .chunk_size(Some(chunk_size))
            // Chunks are written at once: a recorder that is killed leaves complete chunks.
            .disable_seeking(true);
        let buffered = BufWriter::with_capacity(1 << 16, file);
        let writer = options.create(buffered).map_err(|e| mcap_error(path, e))?;
        Ok(Self { path: path.to_owned(), writer })
    }

    /// Writes a topic's schema and channel; returns the channel's identifier.
    ///
    /// # Errors
    /// The file is no longer writable.
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

    /// Appends a message; times in ns.
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

    /// Closes the chunk and passes all bytes to the operating system.
    pub fn flush(&mut self) -> Result<(), BagError> {
        self.writer.flush().map_err(|e| mcap_error(&self.path, e))
    }

    /// Closes the file, with rosbag2's metadata record where it is given.
    pub fn finish(mut self, rosbag2_metadata: Option<&str>) -> Result<(), BagError> {
        if let Some(text) = rosbag2_metadata {
            let metadata = mcap::records::Metadata {
                name: "rosbag2".to_owned(),
                metadata: BTreeMap::from([("serialized_metadata".to_owned(), text.to_owned())]),
            };
            self.writer.write_metadata(&metadata).map_err(|e| mcap_error(&self.path, e))?;
        }
        self.writer.finish().map_err(|e| mcap_error(&self.path, e))?;
        let buffered = self.writer.into_inner();
        let file = buffered.into_inner().map_err(|e| io_error(&self.path, e.into_error()))?;
        Ok(file.commit()?)
    }
}

fn mcap_error(path: &Path, error: mcap::McapError) -> BagError {
    match error {
        mcap::McapError::Io(source) => io_error(path, source),
        other => BagError::unusable(path, other),
    }
}
