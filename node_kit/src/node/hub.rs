//! Hand-over inside a process: what a publisher gives, the subscribers of the same topic get as the same `Arc`.
//!
//! The network's copy of such a message is recognised by its writer and dropped, so nobody gets it twice; where nobody
//! outside listens to a volatile topic it is not even serialised.

use super::NodeError;
use ros2_client::Gid;
use std::{
    any::Any,
    collections::{HashMap, HashSet, VecDeque},
    sync::{
        Arc, Mutex, PoisonError, RwLock,
        atomic::{AtomicU64, AtomicUsize, Ordering},
    },
};
use volant_msgs::Message;

/// What is known of a topic's other end, whatever its type.
#[derive(Debug, Default)]
pub(crate) struct TopicState {
    /// Writers of this process: their messages came by hand already.
    pub own_writers: RwLock<HashSet<Gid>>,
    /// Writers of others that give another type to the topic, which DDS matches all the same.
    pub foreign_writers: RwLock<HashSet<Gid>>,
    /// Readers outside of this process.
    pub remote_readers: AtomicUsize,
    /// Writers of the right type outside of this process.
    pub remote_writers: AtomicUsize,
}

/// What takes a message for one subscriber; it must be quick and never wait.
pub(crate) type Deliver<M> = Arc<dyn Fn(&Arc<M>) + Send + Sync>;

/// One topic with its type.
pub(crate) struct Channel<M> {
    pub state: Arc<TopicState>,
    subscribers: RwLock<Vec<(u64, Deliver<M>)>>,
    latched: Mutex<HashMap<u64, VecDeque<Arc<M>>>>,
    next_id: AtomicU64,
}

impl<M: Message> Channel<M> {
    /// Hands over to every subscriber of the process.
    pub fn deliver(&self, message: &Arc<M>) {
        for (_, deliver) in self.subscribers.read().unwrap_or_else(PoisonError::into_inner).iter() {
            deliver(message);
        }
    }

    /// Subscribers in this process.
    pub fn local_subscribers(&self) -> usize {
        self.subscribers.read().unwrap_or_else(PoisonError::into_inner).len()
    }

    /// [`Channel::deliver`], and keeps the last `depth` messages of a publisher for subscribers of the process that come
    /// later.
    pub fn deliver_latched(&self, publisher: u64, message: &Arc<M>, depth: usize) {
        // Held over both, so that a subscriber who comes meanwhile gets the message once.
        let mut latched = self.latched.lock().unwrap_or_else(PoisonError::into_inner);
        let kept = latched.entry(publisher).or_default();
        kept.push_back(Arc::clone(message));
        while kept.len() > depth {
            kept.pop_front();
        }
        self.deliver(message);
    }

    /// Forgets what a publisher latched.
    pub fn unlatch(&self, publisher: u64) {
        self.latched.lock().unwrap_or_else(PoisonError::into_inner).remove(&publisher);
    }

    /// An id for a publisher.
    pub fn new_id(&self) -> u64 {
        self.next_id.fetch_add(1, Ordering::Relaxed)
    }

    /// Adds a subscriber, who first gets what is latched if it asks for that. It is removed when the guard drops.
    pub fn subscribe(self: &Arc<Self>, deliver: Deliver<M>, with_latched: bool) -> SubscriberGuard {
        let id = self.new_id();
        // Held while the subscriber is added, so that no message falls between the two.
        let latched = self.latched.lock().unwrap_or_else(PoisonError::into_inner);
        if with_latched {
            latched.values().flatten().for_each(|message| deliver(message));
        }
        self.subscribers.write().unwrap_or_else(PoisonError::into_inner).push((id, deliver));
        drop(latched);
        let channel = Arc::clone(self);
        SubscriberGuard(Some(Box::new(move || {
            channel.subscribers.write().unwrap_or_else(PoisonError::into_inner).retain(|(i, _)| *i != id);
        })))
    }
}

/// Ends a subscription inside the process when it drops.
pub(crate) struct SubscriberGuard(Option<Box<dyn FnOnce() + Send>>);

impl Drop for SubscriberGuard {
    fn drop(&mut self) {
        if let Some(remove) = self.0.take() {
            remove();
        }
    }
}

struct Topic {
    type_name: &'static str,
    state: Arc<TopicState>,
    channel: Arc<dyn Any + Send + Sync>,
}

/// All topics of a process.
#[derive(Default)]
pub(crate) struct Hub {
    topics: Mutex<HashMap<String, Topic>>,
}

impl Hub {
    /// The topic of this absolute name.
    pub fn channel<M: Message>(&self, topic: &str) -> Result<Arc<Channel<M>>, NodeError> {
        let mut topics = self.topics.lock().unwrap_or_else(PoisonError::into_inner);
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
        Arc::clone(&entry.channel).downcast().map_err(|_| NodeError::TypeClash {
            topic: topic.to_owned(),
            here: M::TYPE_NAME,
            there: entry.type_name,
        })
    }

    /// Every topic's name, type and state.
    pub fn topics(&self) -> Vec<(String, &'static str, Arc<TopicState>)> {
        let topics = self.topics.lock().unwrap_or_else(PoisonError::into_inner);
        topics.iter().map(|(name, t)| (name.clone(), t.type_name, Arc::clone(&t.state))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use volant_msgs::std_msgs::msg::Header;

    #[test]
    fn subscribers_get_the_very_same_message_and_late_ones_what_is_latched() {
        let hub = Hub::default();
        let channel = hub.channel::<Header>("/a").unwrap();
        let got: Arc<Mutex<Vec<Arc<Header>>>> = Arc::default();
        let deliver = |got: &Arc<Mutex<Vec<Arc<Header>>>>| -> Deliver<Header> {
            let got = Arc::clone(got);
            Arc::new(move |m| got.lock().unwrap().push(Arc::clone(m)))
        };
        let first = channel.subscribe(deliver(&got), false);
        let message = Arc::new(Header { frame_id: "x".into(), ..Header::default() });
        hub.channel::<Header>("/a").unwrap().deliver(&message);
        assert!(Arc::ptr_eq(&got.lock().unwrap()[0], &message));
        drop(first);
        channel.deliver(&message);
        assert_eq!(got.lock().unwrap().len(), 1);

        let id = channel.new_id();
        channel.deliver_latched(id, &message, 1);
        channel.deliver_latched(id, &message, 1);
        let _late = channel.subscribe(deliver(&got), true);
        assert_eq!(got.lock().unwrap().len(), 2);
    }

    #[test]
    fn one_topic_has_one_type() {
        let hub = Hub::default();
        hub.channel::<Header>("/a").unwrap();
        let clash = hub.channel::<volant_msgs::sensor_msgs::msg::Imu>("/a").err().unwrap().to_string();
        assert!(clash.contains("/a") && clash.contains("std_msgs/msg/Header"), "{clash}");
    }
}
