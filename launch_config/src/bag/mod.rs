//! Bags: rosbag2's MCAP, read and written, as a lone `.mcap` file or as a folder with `metadata.yaml`.
//!
//! In flows a path, out flow [`BagMessage`]s in the order in which they were logged ([`BagReader`]); or messages flow in
//! and a bag is written that `ros2 bag`, Foxglove and other readers take ([`BagWriter`]). Nothing in here knows what the
//! bytes of a message mean. Only `mcap_file` knows the `mcap` crate.

mod mcap_file;
mod metadata;
mod qos;
mod read;
mod records;
mod write;

pub use mcap_file::Compression;
pub use qos::{Durability, QosProfile, Reliability};
pub use read::{BagReader, BagSummary, files_named_by};
pub use write::{BagWriter, TopicId, WriteOptions};

use std::{path::PathBuf, sync::Arc};
use thiserror::Error;

/// What a bag says about a topic.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Topic {
    /// Absolute name.
    pub name: String,
    /// `package/msg/Type`.
    pub type_name: String,
    /// The `ros2msg` text with all that it uses; empty where the writer did not know it.
    pub definition: String,
    /// `cdr` in every ROS 2 bag.
    pub message_encoding: String,
    /// `RIHS01_…`, or empty.
    pub type_hash: String,
    /// The publishers' QoS as rosbag2's YAML list, or empty.
    pub offered_qos_profiles: String,
}

impl Topic {
    /// A topic with a type that is built in.
    pub fn of<M: volant_msgs::Message>(name: &str, qos: &QosProfile) -> Self {
        Self {
            name: name.to_owned(),
            type_name: M::TYPE_NAME.to_owned(),
            definition: M::DEFINITION.to_owned(),
            message_encoding: "cdr".to_owned(),
            type_hash: M::RIHS01_HASH.to_owned(),
            offered_qos_profiles: qos.to_yaml(),
        }
    }
}

/// One message of a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BagMessage {
    /// Its topic.
    pub topic: Arc<Topic>,
    /// When it was received, ns.
    pub log_time: u64,
    /// When it was sent, ns.
    pub publish_time: u64,
    /// CDR with its header.
    pub data: Vec<u8>,
}

/// Why a bag cannot be read or written.
#[derive(Debug, Error)]
pub enum BagError {
    /// Nothing there.
    #[error("{}: there is no such file or folder; give an .mcap file or a rosbag2 folder", path.display())]
    NotFound {
        /// Where it should be.
        path: PathBuf,
    },
    /// Zero bytes.
    #[error("{}: the file is empty; record it again, or give another one", path.display())]
    Empty {
        /// Which file.
        path: PathBuf,
    },
    /// Not an MCAP file.
    #[error("{}: this is not an MCAP file ({what}); {remedy}", path.display())]
    Foreign {
        /// Which file.
        path: PathBuf,
        /// What it looks like.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// The operating system says no.
    #[error("{}: {source}; check the path, its permissions and the space on the disk", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// Its reason.
        source: std::io::Error,
    },
    /// A rosbag2 folder that makes no sense.
    #[error("{}: {reason}; `volant bag recover` makes a whole bag of its .mcap files", path.display())]
    Metadata {
        /// Which file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The file breaks MCAP's rules where nothing can be skipped.
    #[error("{}: {reason}", path.display())]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// What is wrong, and what to do.
        reason: String,
    },
    /// The target is there already.
    #[error("{}: exists already; remove it or give another name", path.display())]
    Exists {
        /// Which.
        path: PathBuf,
    },
}
