//! What a node gives out.

use super::{hub::Channel, wire::Shared};
use crate::{inbox::now, qos::Qos};
use ros2_client::{Gid, WriteError};
use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Instant,
};
use volant_msgs::Message;

/// Publishes messages of one type on one topic. Clones share it; any thread may publish.
///
/// A publication never waits: subscribers of the same process get the `Arc` at once, DDS takes a copy of the bytes or,
/// when a reliable reader has not acknowledged `max_samples` of them, refuses it, which is counted.
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
    writer: ros2_client::Publisher<Shared<M>>,
    active: Arc<AtomicBool>,
    counts: Arc<PublisherCounts>,
    /// Of a latched topic: what was published while the node was inactive, or what DDS has not taken yet.
    pending: Mutex<Option<Pending<M>>>,
}

enum Pending<M> {
    Unpublished(Arc<M>),
    Unwritten(Arc<M>),
}

/// How a publisher fares.
#[derive(Debug, Default)]
pub(crate) struct PublisherCounts {
    pub published: AtomicU64,
    pub refused: AtomicU64,
}

/// A publisher without its type, for the 1 Hz round of the kit.
pub(crate) trait Publishing: Send + Sync {
    fn topic(&self) -> &str;
    fn counts(&self) -> &PublisherCounts;
    /// Gives DDS again what it refused of a latched topic.
    fn retry(&self);
}

impl<M: Message> Publisher<M> {
    pub(crate) fn new(
        topic: String,
        qos: Qos,
        channel: Arc<Channel<M>>,
        writer: ros2_client::Publisher<Shared<M>>,
        active: Arc<AtomicBool>,
    ) -> Self {
        let gid = writer.gid();
        channel.state.own_writers.write().unwrap_or_else(PoisonError::into_inner).insert(gid);
        Self(Arc::new(Inner {
            topic,
            id: channel.new_id(),
            qos,
            channel,
            writer,
            active,
            counts: Arc::default(),
            pending: Mutex::new(None),
        }))
    }

    /// Publishes.
    pub fn publish(&self, message: M) {
        self.publish_shared(Arc::new(message));
    }

    /// Publishes what others hold too, without a copy.
    pub fn publish_shared(&self, message: Arc<M>) {
        let inner = &*self.0;
        if !inner.active.load(Ordering::Acquire) {
            if inner.qos.transient_local {
                *inner.pending() = Some(Pending::Unpublished(message));
            }
            return;
        }
        inner.publish(message);
    }

    /// Subscribers, in this process and outside.
    pub fn subscribers(&self) -> usize {
        self.0.channel.local_subscribers() + self.0.channel.state.remote_readers.load(Ordering::Relaxed)
    }

    /// Absolute name of the topic.
    pub fn topic(&self) -> &str {
        &self.0.topic
    }

    /// Publications that DDS refused since the start, because a reliable reader did not answer.
    pub fn refused(&self) -> u64 {
        self.0.counts.refused.load(Ordering::Relaxed)
    }

    pub(crate) fn weak(&self) -> std::sync::Weak<dyn Publishing> {
        let inner: std::sync::Weak<Inner<M>> = Arc::downgrade(&self.0);
        inner
    }
}

impl<M: Message> Inner<M> {
    fn pending(&self) -> MutexGuard<'_, Option<Pending<M>>> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn publish(&self, message: Arc<M>) {
        self.counts.published.fetch_add(1, Ordering::Relaxed);
        if self.qos.transient_local {
            self.channel.deliver_latched(self.id, &message, self.qos.depth);
        } else {
            self.channel.deliver(&message);
            if self.channel.state.remote_readers.load(Ordering::Relaxed) == 0 {
                // Nobody outside would get it, and nobody will ask for it later.
                return;
            }
        }
        if let Err(message) = self.write(message) {
            self.counts.refused.fetch_add(1, Ordering::Relaxed);
            if self.qos.transient_local {
                *self.pending() = Some(Pending::Unwritten(message));
            }
        }
    }

    /// Gives it to DDS; what it refuses for want of room comes back.
    fn write(&self, message: Arc<M>) -> Result<(), Arc<M>> {
        match self.writer.publish(Shared(message)) {
            Ok(()) => Ok(()),
            Err(WriteError::WouldBlock { data }) => Err(data.0),
            // Anything else (a message that cannot be serialised, a participant that is gone) stays as it is if tried again.
            Err(_) => {
                self.counts.refused.fetch_add(1, Ordering::Relaxed);
                Ok(())
            }
        }
    }

    fn gid(&self) -> Gid {
        self.writer.gid()
    }
}

impl<M: Message> Publishing for Inner<M> {
    fn topic(&self) -> &str {
        &self.topic
    }

    fn counts(&self) -> &PublisherCounts {
        &self.counts
    }

    fn retry(&self) {
        let pending = self.pending().take();
        match pending {
            None => {}
            Some(Pending::Unpublished(message)) if self.active.load(Ordering::Acquire) => {
                self.publish(message)
            }
            Some(unpublished @ Pending::Unpublished(_)) => *self.pending() = Some(unpublished),
            Some(Pending::Unwritten(message)) => {
                if let Err(message) = self.write(message) {
                    // Unless a younger one waits by now.
                    self.pending().get_or_insert(Pending::Unwritten(message));
                }
            }
        }
    }
}

impl<M: Message> Drop for Inner<M> {
    fn drop(&mut self) {
        self.channel.unlatch(self.id);
        let gid = self.gid();
        self.channel.state.own_writers.write().unwrap_or_else(PoisonError::into_inner).remove(&gid);
    }
}

/// Counts per second between two rounds.
#[derive(Debug)]
pub(crate) struct Rate {
    count: u64,
    at: Instant,
}

impl Rate {
    pub fn new() -> Self {
        Self { count: 0, at: now() }
    }

    /// Events per second since the last call.
    pub fn update(&mut self, count: u64) -> f64 {
        let now = now();
        let seconds = now.duration_since(self.at).as_secs_f64();
        let rate = if seconds > 0.0 { count.saturating_sub(self.count) as f64 / seconds } else { 0.0 };
        (self.count, self.at) = (count, now);
        rate
    }
}
