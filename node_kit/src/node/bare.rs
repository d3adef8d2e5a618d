//! A node for a program that subscribes to topics as bytes: `volant record` and its like.

use super::{error::NodeError, middleware::MiddlewareWatch, participant::join};
use crate::environment::Network;
use parking_lot::Mutex;
use ros2_client::{Context, Gid, Node, NodeName, NodeOptions};
use rustdds::{DomainParticipant, GUID};
use std::sync::Arc;

/// A ROS node without parameters, lifecycle and log. Its program creates subscriptions with the
/// participant and announces them, so that `ros2 node info` and bridges know whose they are.
pub struct BareNode {
    node: Arc<Mutex<Node>>,
    participant: DomainParticipant,
}

/// An announced subscription; the announcement ends when this drops.
#[must_use]
pub struct AnnouncedReader {
    node: Arc<Mutex<Node>>,
    reader: Gid,
}

impl BareNode {
    /// Joins a domain as [`join`] with a node of this name in the namespace `/`.
    ///
    /// # Errors
    /// As [`join`], and an invalid name.
    pub fn join(network: &Network, name: &str) -> Result<(Self, MiddlewareWatch), NodeError> {
        let what = || format!("the node /{name}");
        let (participant, watch) = join(network)?;
        let context = Context::from_domain_participant(participant.clone())
            .map_err(|e| NodeError::middleware(what(), e))?;
        let options = NodeOptions::new().enable_rosout(false).start_parameter_services(false);
        let name = NodeName::new("/", name).map_err(|e| NodeError::middleware(what(), e))?;
        let node = context.new_node(name, options).map_err(|e| NodeError::middleware(what(), e))?;
        Ok((Self { node: Arc::new(Mutex::new(node)), participant }, watch))
    }

    /// The node's participant.
    pub fn participant(&self) -> &DomainParticipant {
        &self.participant
    }

    /// Announces a subscription of the participant as this node's.
    pub fn announce_reader(&self, reader: GUID) -> AnnouncedReader {
        let reader = Gid::from(reader);
        self.node.lock().add_reader(reader);
        AnnouncedReader::of(&self.node, reader)
    }
}

impl AnnouncedReader {
    /// A subscription that `node` has announced already.
    pub(super) fn of(node: &Arc<Mutex<Node>>, reader: Gid) -> Self {
        Self { node: Arc::clone(node), reader }
    }
}

impl Drop for AnnouncedReader {
    fn drop(&mut self) {
        self.node.lock().remove_reader(self.reader);
    }
}
