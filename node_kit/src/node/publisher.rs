//! Publishers of messages.

use super::intra_process::Channel;
use crate::qos::Qos;
use parking_lot::Mutex;
use ros2_client::WriteError;
use std::sync::{
    Arc, Weak,
    atomic::{AtomicBool, AtomicU64, Ordering},
};
use volant_msgs::Message;

/// Publishes messages of one type on one topic. Clones share it; any thread may publish.
///
/// Publishing never waits. Subscribers of the same process get the `Arc` at once. DDS takes a copy
/// of the bytes, or refuses it when a reliable reader has not acknowledged `max_samples` of them;
/// refusals are counted.
pub struct Publisher<M: Message>(Arc<Inner<M>>);

impl<M: Message> Clone for Publisher<M> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

struct Inner<M: Message> {
    topic: String,
    id: u64,
    qos: Qos,
    channel: Arc<Channel<M>>,
    writer: ros2_client::Publisher<Arc<M>>,
    active: Arc<AtomicBool>,
    published: AtomicU64,
    refused: AtomicU64,
    /// Of a latched topic: message published while the node was inactive, or refused by DDS.
    pending: Mutex<Option<Pending<M>>>,
}

struct Pending<M> {
    message: Arc<M>,
    /// Delivered in this process: only DDS is missing.
    delivered: bool,
}

/// A publisher without its type, for the diagnostics.
pub(crate) trait Publishing: Send + Sync {
    fn topic(&self) -> &str;
    fn published(&self) -> u64;
    fn refused(&self) -> u64;
    /// Publishes the pending message of a latched topic again.
    fn retry(&self);
}

impl<M: Message> Publisher<M> {
    pub(crate) fn new(
        topic: String,
        qos: Qos,
        channel: Arc<Channel<M>>,
        writer: ros2_client::Publisher<Arc<M>>,
        active: Arc<AtomicBool>,
    ) -> Self {
        let gid = writer.gid();
        channel.state.own_writers.write().insert(gid);
        Self(Arc::new(Inner {
            topic,
            id: channel.new_id(),
            qos,
            channel,
            writer,
            active,
            published: AtomicU64::new(0),
            refused: AtomicU64::new(0),
            pending: Mutex::new(None),
        }))
    }

    /// Publishes a message.
    pub fn publish(&self, message: M) {
        self.publish_shared(Arc::new(message));
    }

    /// Publishes a shared message without copying it.
    pub fn publish_shared(&self, message: Arc<M>) {
        let inner = &*self.0;
        if !inner.active.load(Ordering::Acquire) {
            if inner.qos.transient_local {
                *inner.pending.lock() = Some(Pending { message, delivered: false });
            }
            return;
        }
        inner.publish(message);
    }

    /// Number of subscribers, inside and outside of this process.
    pub fn subscribers(&self) -> usize {
        self.0.channel.local_subscribers()
            + self.0.channel.state.remote_readers.load(Ordering::Relaxed)
    }

    /// Number of publications refused by DDS because a reliable reader did not acknowledge.
    pub fn refused(&self) -> u64 {
        self.0.refused.load(Ordering::Relaxed)
    }

    pub(crate) fn weak(&self) -> Weak<dyn Publishing> {
        let inner: Weak<Inner<M>> = Arc::downgrade(&self.0);
        inner
    }
}

impl<M: Message> Inner<M> {
    fn publish(&self, message: Arc<M>) {
        self.published.fetch_add(1, Ordering::Relaxed);
        if self.qos.transient_local {
            if self.qos.depth == 1 {
                // This message replaces one that DDS refused before.
                *self.pending.lock() = None;
            }
            self.channel.deliver_latched(self.id, &message, self.qos.depth);
        } else {
            self.channel.deliver(&message);
            if self.channel.state.remote_readers.load(Ordering::Relaxed) == 0 {
                // No subscriber outside, and a volatile topic keeps nothing for later ones.
                return;
            }
        }
        if let Err(message) = self.write(message) {
            self.refused.fetch_add(1, Ordering::Relaxed);
            if self.qos.transient_local {
                *self.pending.lock() = Some(Pending { message, delivered: true });
            }
        }
    }

    /// Writes to DDS; returns the message if its queue is full.
    fn write(&self, message: Arc<M>) -> Result<(), Arc<M>> {
        match self.writer.publish(message) {
            Ok(()) => Ok(()),
            Err(WriteError::WouldBlock { data }) => Err(data),
            // Other errors (serialization, a participant that has ended) do not go away by
            // retrying.
            Err(_) => {
                self.refused.fetch_add(1, Ordering::Relaxed);
                Ok(())
            }
        }
    }
}

impl<M: Message> Publishing for Inner<M> {
    fn topic(&self) -> &str {
        &self.topic
    }

    fn published(&self) -> u64 {
        self.published.load(Ordering::Relaxed)
    }

    fn refused(&self) -> u64 {
        self.refused.load(Ordering::Relaxed)
    }

    fn retry(&self) {
        let pending = self.pending.lock().take();
        let Some(Pending { message, delivered }) = pending else { return };
        let left = if delivered {
            self.write(message).err()
        } else if self.active.load(Ordering::Acquire) {
            self.publish(message);
            None
        } else {
            Some(message)
        };
        if let Some(message) = left {
            // Unless a newer one is pending by now.
            self.pending.lock().get_or_insert(Pending { message, delivered });
        }
    }
}

impl<M: Message> Drop for Inner<M> {
    fn drop(&mut self) {
        self.channel.unlatch(self.id);
        self.channel.state.own_writers.write().remove(&self.writer.gid());
    }
}
