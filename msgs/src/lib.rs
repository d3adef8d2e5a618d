//! ROS messages as Rust types: `volant_msgs`' own in [`msg`], the standard ones in a module per ROS package.
//!
//! In flow the `.msg` and `.srv` files of this package (build time); out flow structs with the defaults and constants
//! of their definitions, their serde form for the middleware, their CDR form for bags ([`cdr`]), and what ROS 2 says
//! about each type: names, definition text and RIHS01 hash ([`Message`]).
//!
//! ```
//! use volant_msgs::{Message, cdr, geometry_msgs::msg::PointStamped};
//! let mut point = PointStamped::default();
//! point.header.frame_id = "world".into();
//! let bytes = cdr::to_bytes(&point);
//! assert_eq!(cdr::from_bytes::<PointStamped>(&bytes).unwrap(), point);
//! assert_eq!(PointStamped::TYPE_NAME, "geometry_msgs/msg/PointStamped");
//! ```

pub mod cdr;

mod generated {
    // Documentation comes from the .msg files; not every comment there is a sentence of rustdoc.
    #![allow(rustdoc::invalid_html_tags, rustdoc::broken_intra_doc_links, rustdoc::bare_urls)]
    #![allow(clippy::doc_markdown, clippy::identity_op)]
    include!(concat!(env!("OUT_DIR"), "/messages.rs"));
}
pub use generated::*;

use serde::{Serialize, de::DeserializeOwned};
use std::fmt::Debug;

/// A ROS message (or half of a service).
pub trait Message:
    cdr::Cdr + Clone + Debug + Default + PartialEq + Serialize + DeserializeOwned + Send + Sync + 'static
{
    /// `package/msg/Type`.
    const TYPE_NAME: &'static str;
    /// `package::msg::dds_::Type_`, as DDS has it.
    const DDS_TYPE_NAME: &'static str;
    /// The `.msg` text and those of all messages in it: a bag's `ros2msg` schema.
    const DEFINITION: &'static str;
    /// REP-2016's hash of the type.
    const RIHS01_HASH: &'static str;
}

/// A ROS service.
pub trait Service: 'static {
    /// What the client sends.
    type Request: Message;
    /// What it gets.
    type Response: Message;
    /// `package/srv/Type`.
    const TYPE_NAME: &'static str;
    /// REP-2016's hash of the type.
    const RIHS01_HASH: &'static str;
}

/// What [`Message`] says about a type, as a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageInfo {
    /// [`Message::TYPE_NAME`].
    pub type_name: &'static str,
    /// [`Message::DDS_TYPE_NAME`].
    pub dds_type_name: &'static str,
    /// [`Message::DEFINITION`].
    pub definition: &'static str,
    /// [`Message::RIHS01_HASH`].
    pub rihs01_hash: &'static str,
}

impl MessageInfo {
    /// Of a type.
    pub const fn of<M: Message>() -> Self {
        Self {
            type_name: M::TYPE_NAME,
            dds_type_name: M::DDS_TYPE_NAME,
            definition: M::DEFINITION,
            rihs01_hash: M::RIHS01_HASH,
        }
    }

    /// Of the type with that name (`package/msg/Type`), if it is built in.
    pub fn by_name(type_name: &str) -> Option<&'static Self> {
        MESSAGES.iter().find(|m| m.type_name == type_name)
    }
}
