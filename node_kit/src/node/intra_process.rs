//! Intra-process transport: subscribers of a process get the `Arc` that a publisher of the same
//! process publishes.
//!
//! The copy of such a message that comes over the network is recognized by its writer and dropped,
//! so that nobody gets it twice. A volatile topic without subscribers outside of the process is not
//! serialized at all.

use super::error::NodeError;
use parking_lot::{Mutex, RwLock};
use ros2_client::Gid;
use std::{
    any::Any,
    collections::{HashMap, HashSet, VecDeque},
    sync::{
        Arc,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
    time::Instant,
};
use volant_msgs::Message;

/// Other ends of a topic, whatever its type.
#[derive(Debug, Default)]
pub(crate) struct TopicState {
    /// Writers of this process, whose messages are delivered without the network.
    pub own_writers: RwLock<HashSet<Gid>>,
    /// Writers of another type outside of this process; RustDDS 0.15.1 matches them all the same.
    pub foreign_writers: RwLock<HashSet<Gid>>,
    /// Readers outside of this process.
    pub remote_readers: AtomicUsize,
    /// Writers of the right type outside of this process.
    pub remote_writers: RwLock<Vec<Gid>>,
    /// When the latest message of each writer outside of this process was received.
    pub heard: Mutex<HashMap<Gid, Instant>>,
}

/// Delivers a message to one subscriber; it must be quick and never wait.
pub(crate) type Deliver<M> = Arc<dyn Fn(&Arc<M>) + Send + Sync>;

/// One topic with its type.
pub(crate) struct Channel<M> {
    pub state: Arc<TopicState>,
    subscribers: RwLock<Vec<(u64, Deliver<M>)>>,
    latched: Mutex<HashMap<u64, VecDeque<Arc<M>>>>,
    next_id: AtomicU64,
}

impl<M: Message> Channel<M> {
    /// Delivers to every subscriber of the process.
    pub fn deliver(&self, message: &Arc<M>) {
        for (_, deliver) in self.subscribers.read().iter() {
            deliver(message);
        }
    }

    /// Number of subscribers in this process.
    pub fn local_subscribers(&self) -> usize {
        self.subscribers.read().len()
    }

    /// [`Channel::deliver`], and keeps the last `depth` messages of a publisher for later
    /// subscribers of the process.
    pub fn deliver_latched(&self, publisher: u64, message: &Arc<M>, depth: usize) {
        // Locked over both, so that a concurrent new subscriber gets the message once.
        let mut latched = self.latched.lock();
        let kept = latched.entry(publisher).or_default();
        kept.push_back(Arc::clone(message));
        while kept.len() > depth {
            kept.pop_front();
        }
        self.deliver(message);
    }

    /// Drops the latched messages of a publisher.
    pub fn unlatch(&self, publisher: u64) {
        self.latched.lock().remove(&publisher);
    }

    /// Returns a new id for a publisher or subscriber.
    pub fn new_id(&self) -> u64 {
        self.next_id.fetch_add(1, Ordering::Relaxed)
    }

    /// Adds a subscriber until the guard drops; with `with_latched`, the latched messages are
    /// delivered first.
    pub fn subscribe(self: &Arc<Self>, deliver: Deliver<M>, with_latched: bool) -> SubscriberGuard {
        let id = self.new_id();
        // Locked while the subscriber is added, so that no message is lost or delivered twice.
        let latched = self.latched.lock();
        if with_latched {
            latched.values().flatten().for_each(|message| deliver(message));
        }
        self.subscribers.write().push((id, deliver));
        drop(latched);
        let channel = Arc::clone(self);
        SubscriberGuard(Box::new(move || channel.subscribers.write().retain(|(i, _)| *i != id)))
    }
}

/// Removes a subscriber of the process when it drops.
pub(crate) struct SubscriberGuard(Box<dyn Fn() + Send>);

impl Drop for SubscriberGuard {
    fn drop(&mut self) {
        (self.0)();
    }
}

struct Topic {
    type_name: &'static str,
    state: Arc<TopicState>,
    channel: Arc<dyn Any + Send + Sync>,
}

/// Topics of a process.
#[derive(Default)]
pub(crate) struct IntraProcess {
    topics: Mutex<HashMap<String, Topic>>,
}

impl IntraProcess {
    /// Returns the channel of the topic with this absolute name.
    ///
    /// # Errors
    /// The topic has another type in this process.
    pub fn channel<M: Message>(&self, topic: &str) -> Result<Arc<Channel<M>>, NodeError> {
        let mut topics = self.topics.lock();
        let entry = topics.entry(topic.to_owned()).or_insert_with(|| {
            let state = Arc::<TopicState>::default();
            Topic {
                type_name: M::TYPE_NAME,
                state: Arc::clone(&state),
                channel: Arc::new(Channel::<M> {
                    state,
                    subscribers: RwLock::default(),
                    latched: Mutex::default(),
                    next_id: AtomicU64::new(0),
                }),
            }
        });
        Arc::clone(&entry.channel).downcast().map_err(|_| {
            NodeError::shell(format!(
                "the topic {topic} is {} in this process already, not {}; remap one of the two",
                entry.type_name,
                M::TYPE_NAME
            ))
        })
    }

    /// Name, type and state of every topic.
    pub fn topics(&self) -> Vec<(String, &'static str, Arc<TopicState>)> {
        let topics = self.topics.lock();
        topics.iter().map(|(name, t)| (name.clone(), t.type_name, Arc::clone(&t.state))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use volant_msgs::std_msgs::msg::Header;

    #[test]
    fn subscribers_get_the_same_arc_and_late_ones_the_latched_message() {
        let transport = IntraProcess::default();
        let channel = transport.channel::<Header>("/a").unwrap();
        let got: Arc<Mutex<Vec<Arc<Header>>>> = Arc::default();
        let deliver = |got: &Arc<Mutex<Vec<Arc<Header>>>>| -> Deliver<Header> {
            let got = Arc::clone(got);
            Arc::new(move |m| got.lock().push(Arc::clone(m)))
        };
        let first = channel.subscribe(deliver(&got), false);
        let message = Arc::new(Header { frame_id: "x".into(), ..Header::default() });
        transport.channel::<Header>("/a").unwrap().deliver(&message);
        assert!(Arc::ptr_eq(&got.lock()[0], &message));
        drop(first);
        channel.deliver(&message);
        assert_eq!(got.lock().len(), 1);

        let id = channel.new_id();
        channel.deliver_latched(id, &message, 1);
        channel.deliver_latched(id, &message, 1);
        let _late = channel.subscribe(deliver(&got), true);
        assert_eq!(got.lock().len(), 2);
    }

    #[test]
    fn one_topic_has_one_type() {
        let transport = IntraProcess::default();
        transport.channel::<Header>("/a").unwrap();
        let clash = transport
            .channel::<volant_msgs::sensor_msgs::msg::Imu>("/a")
            .err()
            .unwrap()
            .to_string();
        assert!(clash.contains("/a") && clash.contains("std_msgs/msg/Header"), "{clash}");
    }
}
