//! Bags: rosbag2's MCAP, read and written, as a lone `.mcap` file or as a folder with
//! `metadata.yaml`.
//!
//! [`BagReader`] reads [`BagMessage`]s in the order in which they were logged; [`BagWriter`] writes
//! bags that `ros2 bag`, Foxglove and other readers accept. Only [`recording`] decodes messages.

mod channels;
mod file_reader;
mod file_writer;
mod folder;
mod metadata;
mod qos;
mod read;
pub mod recording;
mod records;
mod summary;
mod write;

pub use file_writer::Compression;
pub use folder::{files_named_by, files_to_recover, is_mcap_file};
pub use node_kit::qos::Qos;
pub use qos::{qos_from_yaml, qos_to_yaml};
pub use read::{BagReader, BagSummary};
pub use write::{BagWriter, TopicId, WriteOptions};

use std::{
    fmt::Display,
    path::{Path, PathBuf},
    sync::Arc,
};
use thiserror::Error;

/// A topic as a bag describes it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Topic {
    /// Absolute name.
    pub name: String,
    /// `package/msg/Type`.
    pub type_name: String,
    /// `ros2msg` text of the type and of all types in it; empty where the writer did not know it.
    pub definition: String,
    /// `cdr` in every ROS 2 bag.
    pub message_encoding: String,
    /// `RIHS01_…`, or empty.
    pub type_hash: String,
    /// The publishers' QoS as rosbag2's YAML list, or empty.
    pub offered_qos_profiles: String,
}

impl Topic {
    /// Describes a topic of a built-in type.
    pub fn of<M: volant_msgs::Message>(name: &str, qos: &Qos) -> Self {
        Self {
            name: name.to_owned(),
            type_name: M::TYPE_NAME.to_owned(),
            definition: M::DEFINITION.to_owned(),
            message_encoding: "cdr".to_owned(),
            type_hash: M::RIHS01_HASH.to_owned(),
            offered_qos_profiles: qos_to_yaml(qos),
        }
    }
}

/// One message of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagMessage {
    /// Its topic.
    pub topic: Arc<Topic>,
    /// Time of reception, ns since the epoch.
    pub log_time: u64,
    /// Time of publication, ns since the epoch.
    pub publish_time: u64,
    /// CDR bytes with their encapsulation header.
    pub data: Vec<u8>,
}

/// Why reading or writing a bag fails.
#[derive(Debug, Error)]
pub enum BagError {
    /// An operation of the operating system failed.
    #[error("{}: {error}; check the path, its permissions and the space on the \
             disk", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// Its reason. The message has it, so it is no `source`: `{:#}` would repeat it.
        error: std::io::Error,
    },
    /// A missing, empty or foreign file, a folder without a valid `metadata.yaml`, or a file that
    /// violates MCAP where nothing can be skipped.
    #[error("{}: {reason}", path.display())]
    Unusable {
        /// Which file.
        path: PathBuf,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// A bag that is not written, since it exists already or its folder is not writable.
    #[error(transparent)]
    Output(#[from] node_kit::files::FileError),
}

impl BagError {
    fn unusable(path: &Path, reason: impl ToString) -> Self {
        Self::Unusable { path: path.to_owned(), reason: reason.to_string() }
    }

    /// A file of another format: what it is, and the remedy.
    fn foreign(path: &Path, (what, remedy): (impl Display, &str)) -> Self {
        Self::unusable(path, format!("this is not an MCAP file ({what}); {remedy}"))
    }
}
