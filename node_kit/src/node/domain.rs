//! The process in its DDS domain: one participant for all of its nodes, and discovery of the other
//! ends of their topics.
//!
//! ros2-client 0.12.1's own spinner is not used: it subscribes to `/clock` with a wrong type, and
//! two of them on one participant take each other's events.

use super::{
    endpoints::dds_type_name,
    error::NodeError,
    graph::{Announcements, Graph},
    intra_process::IntraProcess,
    logger::Logger,
    middleware::{Loss, MiddlewareWatch},
    participant::join_with,
    supervisor::Supervisor,
};
use crate::{environment::Network, inbox::now, level::Level, qos::Endpoint};
use futures_lite::{Stream, StreamExt};
use ros2_client::{Context, Gid};
use rustdds::{DomainParticipantStatusEvent, GUID, RTPSEntity, StatusEvented};
use std::{
    collections::HashSet,
    pin::pin,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context as TaskContext, Poll, Wake, Waker},
    thread::{JoinHandle, Thread},
    time::{Duration, Instant},
};

/// The participant, the intra-process transport of its nodes, and the thread that watches
/// discovery.
pub(crate) struct Domain {
    pub context: Context,
    pub transport: Arc<IntraProcess>,
    pub network: Network,
    pub graph: Arc<Graph>,
    pub supervisor: Arc<Supervisor>,
    buffers_checked: AtomicBool,
    /// The middleware has become unusable.
    pub ended: Arc<AtomicBool>,
    /// When this participant replaced one that had become unusable, and why that one had.
    pub took_over: Option<(Instant, Loss)>,
    stop: Arc<AtomicBool>,
    watcher: Option<JoinHandle<()>>,
}

/// Period of reading the endpoints without an event: events can be lost in a burst (RustDDS 0.15.1
/// keeps 2048).
const BACKSTOP: Duration = Duration::from_secs(2);
/// Period of checking the middleware's threads and the clock.
const HEARTBEAT: Duration = Duration::from_millis(250);
/// Events come in bursts; the endpoints are read once for each burst.
const SETTLE: Duration = Duration::from_millis(5);

impl Domain {
    /// Joins the domain. `lost` is called once, from the watching thread, when the middleware
    /// becomes unusable.
    ///
    /// # Errors
    /// As [`join`](super::join), or the system refuses the thread.
    pub fn join(
        network: Network,
        log: Logger,
        lost: impl FnOnce(Loss) + Send + 'static,
    ) -> Result<Self, NodeError> {
        let (participant, middleware) = join_with(&network, &log)?;
        let supervisor = Supervisor::from_environment(&log);
        let context = Context::from_domain_participant(participant).map_err(|e| {
            NodeError::middleware(format!("the participant in domain {}", network.domain_id), e)
        })?;
        let transport = Arc::<IntraProcess>::default();
        let graph = Arc::<Graph>::default();
        let stop = Arc::<AtomicBool>::default();
        let ended = Arc::<AtomicBool>::default();
        let watcher = std::thread::Builder::new()
            .name("dds_graph".into())
            .spawn({
                let view = View {
                    participant: context.domain_participant(),
                    transport: Arc::clone(&transport),
                    graph: Arc::clone(&graph),
                    log,
                    stop: Arc::clone(&stop),
                    ended: Arc::clone(&ended),
                };
                move || watch(&view, middleware, lost)
            })
            .map_err(|error| NodeError::System { what: "a thread".into(), error })?;
        Ok(Self {
            context,
            transport,
            network,
            graph,
            supervisor,
            buffers_checked: AtomicBool::new(false),
            ended,
            took_over: None,
            stop,
            watcher: Some(watcher),
        })
    }

    /// Logs once, when the first image topic is subscribed, that the kernel's socket buffers are
    /// too small for images.
    pub fn check_socket_buffers(&self, log: &Logger) {
        const ENOUGH: u64 = 4 * 1024 * 1024;
        if self.buffers_checked.swap(true, Ordering::Relaxed) {
            return;
        }
        let read = |name: &str| {
            std::fs::read_to_string(format!("/proc/sys/net/core/{name}"))
                .ok()
                .and_then(|text| text.trim().parse::<u64>().ok())
        };
        // RustDDS requests 8 MiB and gets at most rmem_max; Fast DDS uses rmem_default.
        if let (Some(default), Some(max)) = (read("rmem_default"), read("rmem_max"))
            && default.min(max) < ENOUGH
        {
            log.log(
                Level::Info,
                format!(
                    "net.core.rmem_default is {default} and rmem_max {max}: raw images can be lost \
                     on the way; `sudo sysctl -w net.core.rmem_default={ENOUGH} \
                     net.core.rmem_max={ENOUGH}` helps"
                ),
            );
        }
    }

    /// Requests that the other ends of the topics are read soon, because a topic is new.
    pub fn refresh(&self) {
        if let Some(watcher) = &self.watcher {
            watcher.thread().unpark();
        }
    }
}

impl Drop for Domain {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(watcher) = self.watcher.take() {
            watcher.thread().unpark();
            let _ = watcher.join();
        }
        // The context drops after this, with the last handle of the participant.
    }
}

struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.0.unpark();
    }
}

/// What the watching thread reads, and where it writes that.
struct View {
    participant: rustdds::DomainParticipant,
    transport: Arc<IntraProcess>,
    graph: Arc<Graph>,
    log: Logger,
    stop: Arc<AtomicBool>,
    ended: Arc<AtomicBool>,
}

impl View {
    /// Name of the topic of another process's endpoint.
    fn topic_of(&self, endpoint: GUID) -> String {
        let readers = self.participant.discovered_readers().into_iter().map(|r| {
            let data = r.subscription_topic_data;
            (data.key(), data.topic_name)
        });
        let writers = self.participant.discovered_writers().into_iter().map(|w| {
            let data = w.publication_topic_data;
            (data.key, data.topic_name)
        });
        let found = readers.chain(writers).find(|(key, _)| *key == endpoint);
        let name = found.map_or_else(|| "a topic".to_owned(), |(_, name)| name);
        name.strip_prefix("rt").unwrap_or(&name).to_owned()
    }
}

fn watch(view: &View, mut middleware: MiddlewareWatch, lost: impl FnOnce(Loss)) {
    let mut lost = Some(lost);
    let listener = view.participant.status_listener();
    let mut announcements = Announcements::subscribe(&view.participant);
    let log = &view.log;
    let mut events = pin!(listener.as_async_status_stream());
    let waker = Waker::from(Arc::new(Unpark(std::thread::current())));
    let mut logged = HashSet::new();
    let mut read_again = now();
    while !view.stop.load(Ordering::Acquire) {
        if now() >= read_again {
            if let Some(announcements) = &mut announcements {
                view.graph.read(announcements);
            }
            read_endpoints(view, &mut logged);
            read_again = now() + BACKSTOP;
        }
        if let Some(loss) = middleware.loss()
            && let Some(lost) = lost.take()
        {
            log.log(Level::Error, loss.to_string());
            view.ended.store(true, Ordering::Release);
            lost(loss);
        }
        let woken = wait(HEARTBEAT);
        let mut any = drain(&mut events, &waker, view, &mut logged);
        if any || woken {
            read_again = now();
        }
        while any && !view.stop.load(Ordering::Acquire) {
            std::thread::sleep(SETTLE);
            any = drain(&mut events, &waker, view, &mut logged);
        }
    }
}

/// Waits for an event; returns whether it was woken before the time was over.
fn wait(time: Duration) -> bool {
    let began = now();
    std::thread::park_timeout(time);
    now() < began + time
}

/// Reads all queued events and registers the waker for the next one.
fn drain<S: Stream<Item = DomainParticipantStatusEvent> + Unpin>(
    events: &mut S,
    waker: &Waker,
    view: &View,
    logged: &mut HashSet<(GUID, GUID)>,
) -> bool {
    let mut any = false;
    let mut task = TaskContext::from_waker(waker);
    while let Poll::Ready(Some(event)) = events.poll_next(&mut task) {
        any = true;
        let (here, there, endpoint) = match &event {
            DomainParticipantStatusEvent::RemoteReaderQosIncompatible {
                local_writer,
                remote_reader,
                ..
            } => (*local_writer, *remote_reader, Endpoint::Publisher),
            DomainParticipantStatusEvent::RemoteWriterQosIncompatible {
                local_reader,
                remote_writer,
                ..
            } => (*local_reader, *remote_writer, Endpoint::Subscription),
            _ => continue,
        };
        // An endpoint is announced repeatedly; the mismatch is logged once.
        if logged.len() < 10_000 && logged.insert((here, there)) {
            let topic = view.topic_of(there);
            let end = endpoint.name();
            view.log.log(
                Level::Warn,
                format!(
                    "the {end} of {topic} here and its other end do not match in their quality of \
                     service, and pass no messages (`ros2 topic info -v {topic}` shows both); \
                     set qos_overrides.{topic}.{end}.reliability or .durability"
                ),
            );
        }
    }
    any
}

fn read_endpoints(view: &View, logged: &mut HashSet<(GUID, GUID)>) {
    let View { participant, transport, graph, log, .. } = view;
    let topics = transport.topics();
    if topics.is_empty() {
        return;
    }
    let (readers, writers) = (participant.discovered_readers(), participant.discovered_writers());
    graph.keep(participant.guid(), &writers);
    for (name, type_name, state) in topics {
        let dds_name = format!("rt{name}");
        let dds_type = dds_type_name(type_name);
        let count = readers
            .iter()
            .filter(|r| {
                r.subscription_topic_data.topic_name() == &dds_name
                    && r.subscription_topic_data.type_name() == &dds_type
            })
            .count();
        state.remote_readers.store(count, Ordering::Relaxed);
        let mut foreign = HashSet::new();
        let mut matching = Vec::new();
        for writer in
            writers.iter().map(|w| &w.publication_topic_data).filter(|w| w.topic_name == dds_name)
        {
            if writer.type_name == dds_type {
                matching.push(Gid::from(writer.key));
                continue;
            }
            foreign.insert(Gid::from(writer.key));
            if logged.len() < 10_000 && logged.insert((writer.key, writer.key)) {
                log.log(
                    Level::Warn,
                    format!(
                        "somebody publishes {} on {name}, which is {type_name} here; those \
                         messages are refused",
                        writer.type_name
                    ),
                );
            }
        }
        *state.remote_writers.write() = matching;
        *state.foreign_writers.write() = foreign;
    }
}
