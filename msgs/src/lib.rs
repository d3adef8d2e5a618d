//! ROS messages and services as Rust types: [`msg`] is `volant_msgs`, other packages have modules.
//!
//! `build.rs` generates the types from the `.msg` and `.srv` files. Each has the defaults and
//! constants of its definition, serde traits for the middleware, a CDR encoding for bags ([`cdr`]),
//! and its ROS 2 type description: names, definition text and RIHS01 hash ([`Message`]).
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
pub mod description;

mod generated {
    // The documentation is copied from comments in .msg files, which are not rustdoc markup.
    #![allow(rustdoc::invalid_html_tags, rustdoc::broken_intra_doc_links, rustdoc::bare_urls)]
    #![allow(clippy::doc_markdown, clippy::identity_op)]
    include!(concat!(env!("OUT_DIR"), "/messages.rs"));
}
pub use generated::*;

use serde::{Serialize, de::DeserializeOwned};
use std::fmt::Debug;

/// A ROS message, or the request or response of a service.
pub trait Message:
    Clone + Debug + Default + PartialEq + Serialize + DeserializeOwned + Send + Sync + 'static
{
    /// ROS name, `package/msg/Type`.
    const TYPE_NAME: &'static str;
    /// `.msg` text with those of all nested messages: the `ros2msg` schema of a bag.
    const DEFINITION: &'static str;
    /// RIHS01 hash of the type (REP-2016).
    const RIHS01_HASH: &'static str;
}

/// A ROS service.
pub trait Service: 'static {
    /// Message from the client.
    type Request: Message;
    /// Message to the client.
    type Response: Message;
    /// ROS name, `package/srv/Type`.
    const TYPE_NAME: &'static str;
    /// RIHS01 hash of the type (REP-2016).
    const RIHS01_HASH: &'static str;
}

/// The constants of [`Message`] as a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MessageInfo {
    /// [`Message::TYPE_NAME`].
    pub type_name: &'static str,
    /// [`Message::DEFINITION`].
    pub definition: &'static str,
    /// [`Message::RIHS01_HASH`].
    pub rihs01_hash: &'static str,
}

impl MessageInfo {
    /// Description of `M`.
    pub const fn of<M: Message>() -> Self {
        Self { type_name: M::TYPE_NAME, definition: M::DEFINITION, rihs01_hash: M::RIHS01_HASH }
    }

    /// Description of the built-in message with this name (`package/msg/Type`).
    pub fn by_name(type_name: &str) -> Option<&'static Self> {
        MESSAGES.iter().find(|m| m.type_name == type_name)
    }
}
