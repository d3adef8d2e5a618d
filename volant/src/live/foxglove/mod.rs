//! Server of Foxglove's WebSocket protocol for live topics, without ROS. Samples of live topics
//! ([`Tap`]) are sent unchanged, with their `.msg` text as schema, so that Foxglove shows them as
//! it does from a bag. A topic is subscribed to only while a client subscribes to it. Clients
//! cannot publish, call services or set parameters.
//!
//! Written by hand instead of with the crate `foxglove` (0.30.3, feature `websocket` only): its
//! server accepts `foxglove.sdk.v1` and `foxglove.sdk.v1.1`, and answers a client that offers only
//! `foxglove.websocket.v1` with status 400; this one accepts both names. It would also add fifteen
//! crates to `Cargo.lock`, among them tokio, a second executor, and prost, for protobuf.

mod client;
mod protocol;

use super::{
    tap::{Offer, Sample, Subscription, Tap},
    thread_ended,
};
use anyhow::{Result, anyhow};
use client::Client;
use parking_lot::Mutex;
use protocol::{Channel, FromClient, advertise, message_data, server_info, unadvertise, warning};
use std::{
    collections::{BTreeMap, HashMap},
    io::ErrorKind,
    net::{IpAddr, SocketAddr, TcpListener},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::Duration,
};
use tungstenite::Message;

/// Name of the node.
const NODE: &str = "_volant_foxglove";

/// Foxglove's default port.
pub const PORT: u16 = 8765;
/// Period of polling for new topics and clients.
const LOOK: Duration = Duration::from_millis(50);
/// Time for which a topic without a publisher is kept, because publishers restart.
const LEAVE_AFTER: u32 = 100;
/// Limit of simultaneous clients.
const MOST_CLIENTS: usize = 32;

/// Parses ADDRESS, PORT or ADDRESS:PORT; the defaults are `host` and [`PORT`].
#[must_use]
pub fn serve_at(text: &str, host: IpAddr) -> Option<SocketAddr> {
    if text.is_empty() {
        return Some(SocketAddr::new(host, PORT));
    }
    if let Ok(port) = text.parse::<u16>() {
        return Some(SocketAddr::new(host, port));
    }
    if let Ok(address) = text.parse::<IpAddr>() {
        return Some(SocketAddr::new(address, PORT));
    }
    text.parse().ok()
}

/// A running server; dropping it ends it.
pub struct Foxglove {
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Foxglove {
    /// Starts a server at an address (port 0: any free port).
    ///
    /// # Errors
    /// The address is not available, or the domain cannot be joined.
    pub fn start(address: SocketAddr) -> Result<Self> {
        let failed = |source: std::io::Error| {
            anyhow!("{address}: {source}; is another server there? Give another address or port")
        };
        let listener = TcpListener::bind(address).map_err(failed)?;
        listener.set_nonblocking(true).map_err(failed)?;
        let address = listener.local_addr().map_err(failed)?;
        let tap = Tap::join(NODE)?;
        let stop = Arc::<AtomicBool>::default();
        let thread = std::thread::Builder::new()
            .name("foxglove".into())
            .spawn({
                let stop = Arc::clone(&stop);
                move || run(&listener, tap, &stop)
            })
            .map_err(|_| thread_ended("the thread of the Foxglove server"))?;
        Ok(Self { address, stop, thread: Some(thread) })
    }

    /// Address of the server.
    pub fn address(&self) -> SocketAddr {
        self.address
    }
}

impl Drop for Foxglove {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// State shared by the threads of the clients, the tap and the server.
/// A client has no more subscriptions.
const SUBSCRIPTIONS: usize = 4096;

#[derive(Default)]
struct Shared {
    clients: Mutex<Vec<Arc<Client>>>,
    latched: Mutex<Latched>,
}

/// Last message of each latched topic by channel and publisher, for late clients.
type Latched = HashMap<(u32, [u8; 16]), Arc<Sample>>;

struct Topic {
    offer: Offer,
    channel: Channel,
    subscription: Option<Subscription>,
    /// Polls without a publisher.
    missing: u32,
}

fn run(listener: &TcpListener, mut tap: Tap, stop: &AtomicBool) {
    let shared = Arc::<Shared>::default();
    let mut topics: BTreeMap<String, Topic> = BTreeMap::new();
    let mut next_id = 1;
    let mut threads: Vec<JoinHandle<()>> = vec![];
    let session = super::system_nanos().to_string();
    let mut lost = false;
    while !stop.load(Ordering::Acquire) {
        lost |= tap.loss().is_some();
        if lost {
            topics.values_mut().for_each(|topic| topic.subscription = None);
            // Retried in the next poll.
            if let Ok(another) = Tap::join(NODE) {
                tap = another;
                lost = false;
            }
        }
        look_for_topics(&tap, &shared, &mut topics, &mut next_id);
        shared.clients.lock().retain(|c| !c.is_closed());
        threads.retain(|t| !t.is_finished());
        loop {
            match listener.accept() {
                Ok((stream, _)) if threads.len() < MOST_CLIENTS => {
                    let hello = vec![
                        server_info("volant", &session),
                        advertise(&topics.values().map(|t| t.channel.clone()).collect::<Vec<_>>()),
                    ];
                    threads.extend(welcome(stream, hello, &shared));
                }
                // Dropping it closes it.
                Ok(_) => {}
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                // The client disconnected before it was accepted.
                Err(_) => break,
            }
        }
        follow(&mut tap, &shared, &mut topics);
        std::thread::sleep(LOOK);
    }
    shared.clients.lock().iter().for_each(|c| c.close());
    drop(topics);
    for thread in threads {
        let _ = thread.join();
    }
}

/// Advertises new topics, and unadvertises removed ones.
fn look_for_topics(
    tap: &Tap,
    shared: &Shared,
    topics: &mut BTreeMap<String, Topic>,
    next_id: &mut u32,
) {
    let mut new = vec![];
    for topic in topics.values_mut() {
        topic.missing += 1;
    }
    for offer in tap.offers() {
        let known = topics.get_mut(&offer.topic.name);
        if let Some(topic) = known.filter(|t| t.offer.topic.type_name == offer.topic.type_name) {
            topic.missing = 0;
            topic.offer = offer;
            continue;
        }
        // Foxglove requires a schema.
        if offer.topic.definition.is_empty() {
            continue;
        }
        let channel = Channel {
            id: *next_id,
            topic: offer.topic.name.clone(),
            encoding: "cdr",
            schema_name: offer.topic.type_name.clone(),
            schema: offer.topic.definition.clone(),
            schema_encoding: "ros2msg",
        };
        *next_id += 1;
        new.push(channel.clone());
        let topic = Topic { offer, channel, subscription: None, missing: 0 };
        if let Some(before) = topics.insert(topic.channel.topic.clone(), topic) {
            leave(shared, before.channel.id);
        }
    }
    topics.retain(|_, topic| {
        let stays = topic.missing < LEAVE_AFTER;
        if !stays {
            leave(shared, topic.channel.id);
        }
        stays
    });
    if !new.is_empty() {
        let text = advertise(&new);
        shared.clients.lock().iter().for_each(|c| c.send(Message::text(text.clone())));
    }
}

fn leave(shared: &Shared, channel: u32) {
    shared.latched.lock().retain(|(id, _), _| *id != channel);
    for client in shared.clients.lock().iter() {
        client.subscriptions.lock().remove(&channel);
        client.send(Message::text(unadvertise(&[channel])));
    }
}

fn welcome(
    stream: std::net::TcpStream,
    hello: Vec<String>,
    shared: &Arc<Shared>,
) -> Option<JoinHandle<()>> {
    // An accepted socket may inherit the listener's mode.
    stream.set_nonblocking(false).ok()?;
    let (client, outgoing) = Client::new();
    shared.clients.lock().push(Arc::clone(&client));
    let shared = Arc::clone(shared);
    std::thread::Builder::new()
        .name("foxglove_client".into())
        .spawn(move || {
            // A lost connection affects no other client.
            let _ = client::serve(stream, &client, &outgoing, hello, |request| {
                handle_request(&shared, &client, request)
            });
            client.close();
        })
        .ok()
}

fn handle_request(shared: &Shared, client: &Client, request: FromClient) {
    match request {
        FromClient::Subscribe { subscriptions } => {
            for subscribe in subscriptions {
                let latest: Vec<Arc<Sample>> = {
                    // Locked over both, so that a latched message is sent once.
                    let latched = shared.latched.lock();
                    let mut subscriptions = client.subscriptions.lock();
                    if subscriptions.len() >= SUBSCRIPTIONS {
                        return client.send(Message::text(warning("too many subscriptions")));
                    }
                    subscriptions.insert(subscribe.channel_id, subscribe.id);
                    drop(subscriptions);
                    let of_channel =
                        latched.iter().filter(|((id, _), _)| *id == subscribe.channel_id);
                    of_channel.map(|(_, sample)| Arc::clone(sample)).collect()
                };
                for sample in latest {
                    client.send(binary(subscribe.id, &sample));
                }
            }
        }
        FromClient::Unsubscribe { subscription_ids } => {
            client.subscriptions.lock().retain(|_, id| !subscription_ids.contains(id));
        }
        FromClient::Other => {
            client.send(Message::text(warning("this server only publishes topics")));
        }
    }
}

/// Subscribes to the topics that clients subscribe to, and unsubscribes from others.
fn follow(tap: &mut Tap, shared: &Arc<Shared>, topics: &mut BTreeMap<String, Topic>) {
    for topic in topics.values_mut() {
        let id = topic.channel.id;
        let wanted =
            shared.clients.lock().iter().any(|c| !c.is_closed() && c.subscription(id).is_some());
        if !wanted {
            if topic.subscription.take().is_some() {
                shared.latched.lock().retain(|(channel, _), _| *channel != id);
            }
        } else if topic.subscription.is_none() {
            let latched = topic.offer.qos.transient_local;
            let shared = Arc::clone(shared);
            // Retried in the next poll.
            topic.subscription =
                tap.subscribe(&topic.offer, move |sample| give(&shared, id, latched, sample)).ok();
        }
    }
}

fn give(shared: &Shared, channel: u32, latched: bool, sample: Sample) {
    let sample = Arc::new(sample);
    let mut kept = latched.then(|| shared.latched.lock());
    if let Some(kept) = &mut kept
        && (kept.len() < 1024 || kept.contains_key(&(channel, sample.writer)))
    {
        kept.insert((channel, sample.writer), Arc::clone(&sample));
    }
    for client in shared.clients.lock().iter() {
        if let Some(subscription) = client.subscription(channel) {
            client.send(binary(subscription, &sample));
        }
    }
}

fn binary(subscription: u32, sample: &Sample) -> Message {
    Message::binary(message_data(subscription, sample.log_time, &sample.data))
}

#[cfg(test)]
mod tests {
    use super::{protocol::Subscribe, *};
    use std::net::Ipv4Addr;

    #[test]
    fn a_client_that_subscribes_for_ever_is_bounded() {
        let (shared, (client, _outgoing)) = (Shared::default(), Client::new());
        for first in (0..10 * SUBSCRIPTIONS as u32).step_by(1000) {
            let ids = first..first + 1000;
            let subscriptions = ids.map(|id| Subscribe { id, channel_id: id }).collect();
            handle_request(&shared, &client, FromClient::Subscribe { subscriptions });
        }
        assert_eq!(client.subscriptions.lock().len(), SUBSCRIPTIONS);
    }

    #[test]
    fn an_address_a_port_or_both() {
        let host = IpAddr::V4(Ipv4Addr::LOCALHOST);
        for (text, address) in [
            ("", Some("127.0.0.1:8765")),
            ("9000", Some("127.0.0.1:9000")),
            ("10.0.0.1", Some("10.0.0.1:8765")),
            ("10.0.0.1:1", Some("10.0.0.1:1")),
            ("::1", Some("[::1]:8765")),
            ("70000", None),
            ("here", None),
        ] {
            assert_eq!(serve_at(text, host).map(|a| a.to_string()).as_deref(), address, "{text}");
        }
    }
}
