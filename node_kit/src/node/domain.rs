//! The process's place in the DDS domain: one participant for all of its nodes, and who is at the other end of their
//! topics.
//!
//! ros2-client's own spinner is not used: it would subscribe to `/clock` with a wrong type, and two of them on one
//! participant take each other's events. What it would tell is read from discovery here.

use super::{NodeError, hub::Hub};
use crate::{
    environment::{Network, Security},
    inbox::now,
    level::Level,
    node::{
        logger::Logger,
        middleware::{Loss, MiddlewareWatch},
    },
};
use futures_lite::{Stream, StreamExt};
use ros2_client::{Context, Gid};
use rustdds::{DomainParticipantBuilder, DomainParticipantStatusEvent, GUID, StatusEvented};
use std::{
    collections::HashSet,
    path::PathBuf,
    pin::pin,
    sync::{
        Arc, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    task::{Context as TaskContext, Poll, Wake, Waker},
    thread::{JoinHandle, Thread},
    time::{Duration, Instant},
};

/// The participant, the hub of its nodes, and the thread that watches discovery.
pub(crate) struct Domain {
    pub context: Context,
    pub hub: Arc<Hub>,
    pub network: Network,
    buffers_checked: AtomicBool,
    /// The middleware is of no use any more, though nobody asked it to end.
    pub ended: Arc<AtomicBool>,
    /// When this one took the place of one that was of no use any more, and why it was not.
    pub took_over: Option<(Instant, Loss)>,
    stop: Arc<AtomicBool>,
    watcher: Option<JoinHandle<()>>,
}

/// Events can be lost when many come at once (RustDDS keeps 2048), so the state is read again this often without one.
const BACKSTOP: Duration = Duration::from_secs(2);
/// The middleware's threads, and the clock, are looked at this often.
const HEARTBEAT: Duration = Duration::from_millis(250);
/// Events come in bursts; the state is read once for each burst.
const SETTLE: Duration = Duration::from_millis(5);

impl Domain {
    /// Joins. `lost` is called once, from the watching thread, when the middleware is of no use any more though nobody asked it to end.
    pub fn join(
        network: Network,
        log: Logger,
        lost: impl FnOnce(Loss) + Send + 'static,
    ) -> Result<Self, NodeError> {
        let failed = |reason: String| NodeError::Middleware {
            what: format!("the participant in domain {}", network.domain_id),
            reason,
        };
        let mut builder = DomainParticipantBuilder::new(network.domain_id);
        if let Some(addresses) = network.only_addresses() {
            builder = builder.with_only_networks(addresses);
        }
        if let Some(security) = &network.security {
            builder = secure(builder, security, &log)?;
        }
        let (participant, middleware) = MiddlewareWatch::of(|| builder.build());
        let participant = participant.map_err(|e| failed(e.to_string()))?;
        let context = Context::from_domain_participant(participant).map_err(|e| failed(e.to_string()))?;
        let hub = Arc::<Hub>::default();
        let stop = Arc::<AtomicBool>::default();
        let ended = Arc::<AtomicBool>::default();
        let lost = {
            let ended = Arc::clone(&ended);
            move |loss| {
                ended.store(true, Ordering::Release);
                lost(loss);
            }
        };
        let watcher = std::thread::Builder::new()
            .name("dds_graph".into())
            .spawn({
                let (context, hub, stop) = (context.clone(), Arc::clone(&hub), Arc::clone(&stop));
                move || watch(&context, &hub, &stop, &log, middleware, lost)
            })
            .map_err(|source| NodeError::System { what: "a thread".into(), source })?;
        Ok(Self {
            context,
            hub,
            network,
            buffers_checked: AtomicBool::new(false),
            ended,
            took_over: None,
            stop,
            watcher: Some(watcher),
        })
    }

    /// Says once, when the first image topic is made, that the kernel's socket buffers are too small for images.
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
        // RustDDS asks for 8 MiB and gets at most rmem_max; Fast DDS takes rmem_default as it is.
        if let (Some(default), Some(max)) = (read("rmem_default"), read("rmem_max"))
            && default.min(max) < ENOUGH
        {
            log.log(
                Level::Info,
                format!(
                    "net.core.rmem_default is {default} and rmem_max {max}: raw images can be lost on the way; \
                     `sudo sysctl -w net.core.rmem_default={ENOUGH} net.core.rmem_max={ENOUGH}` helps"
                ),
            );
        }
    }

    /// Has the other ends of the topics read again soon: a topic is new.
    pub fn refresh(&self) {
        if let Some(watcher) = &self.watcher {
            watcher.thread().unpark();
        }
    }
}

/// The builder of a participant that is in a security enclave.
fn secure(
    builder: DomainParticipantBuilder,
    security: &Security,
    log: &Logger,
) -> Result<DomainParticipantBuilder, NodeError> {
    let folder = security.folder();
    let missing = ENCLAVE.into_iter().map(|name| folder.join(name)).find(|file| !file.is_file());
    let reason = if cfg!(not(feature = "security")) {
        "this program was built without it; build it with `--features node_kit/security`".to_owned()
    } else if let Some(file) = missing {
        format!("{} is missing; make a keystore or name another enclave", file.display())
    } else {
        log.log(Level::Info, format!("DDS security: {}", folder.display()));
        return Ok(with_keys(builder, folder));
    };
    if security.enforce {
        let what = format!("a secure participant in the enclave {}", security.enclave);
        return Err(NodeError::Middleware { what, reason });
    }
    let line = format!(
        "ROS_SECURITY_ENABLE is set, but this process runs UNPROTECTED: {reason} (ROS_SECURITY_STRATEGY=Enforce forbids that)"
    );
    log.log(Level::Warn, line);
    Ok(builder)
}

#[cfg(feature = "security")]
fn with_keys(builder: DomainParticipantBuilder, folder: PathBuf) -> DomainParticipantBuilder {
    builder.builtin_security(rustdds::DomainParticipantSecurityConfigFiles::with_ros_default_names(
        folder,
        String::new(),
    ))
}

#[cfg(not(feature = "security"))]
fn with_keys(builder: DomainParticipantBuilder, _: PathBuf) -> DomainParticipantBuilder {
    builder
}

/// What an enclave holds.
const ENCLAVE: [&str; 6] = [
    "cert.pem",
    "key.pem",
    "identity_ca.cert.pem",
    "permissions_ca.cert.pem",
    "governance.p7s",
    "permissions.p7s",
];

impl Drop for Domain {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(watcher) = self.watcher.take() {
            watcher.thread().unpark();
            let _ = watcher.join();
        }
        // The context drops after this, with the last handle to the participant.
    }
}

struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.0.unpark();
    }
}

fn watch(
    context: &Context,
    hub: &Hub,
    stop: &AtomicBool,
    log: &Logger,
    mut middleware: MiddlewareWatch,
    lost: impl FnOnce(Loss),
) {
    let mut lost = Some(lost);
    let participant = context.domain_participant();
    let listener = participant.status_listener();
    let mut events = pin!(listener.as_async_status_stream());
    let waker = Waker::from(Arc::new(Unpark(std::thread::current())));
    let mut said = HashSet::new();
    let mut read_again = now();
    while !stop.load(Ordering::Acquire) {
        if now() >= read_again {
            read_endpoints(&participant, hub, log, &mut said);
            read_again = now() + BACKSTOP;
        }
        if let Some(loss) = middleware.loss()
            && let Some(lost) = lost.take()
        {
            log.log(Level::Error, loss.to_string());
            lost(loss);
        }
        let woken = wait(HEARTBEAT);
        let mut any = drain(&mut events, &waker, log, &mut said);
        if any || woken {
            read_again = now();
        }
        while any && !stop.load(Ordering::Acquire) {
            std::thread::sleep(SETTLE);
            any = drain(&mut events, &waker, log, &mut said);
        }
    }
}

/// Waits for an event; true if something may have happened before the time was over.
fn wait(time: Duration) -> bool {
    let began = now();
    std::thread::park_timeout(time);
    now() < began + time
}

/// Reads all events that are there; with none left, the waker is registered for the next.
fn drain<S: Stream<Item = DomainParticipantStatusEvent> + Unpin>(
    events: &mut S,
    waker: &Waker,
    log: &Logger,
    said: &mut HashSet<(GUID, GUID)>,
) -> bool {
    let mut any = false;
    let mut task = TaskContext::from_waker(waker);
    while let Poll::Ready(Some(event)) = events.poll_next(&mut task) {
        any = true;
        let (here, there) = match &event {
            DomainParticipantStatusEvent::RemoteReaderQosIncompatible {
                local_writer, remote_reader, ..
            } => (*local_writer, *remote_reader),
            DomainParticipantStatusEvent::RemoteWriterQosIncompatible {
                local_reader, remote_writer, ..
            } => (*local_reader, *remote_writer),
            _ => continue,
        };
        // An endpoint is announced again and again; the mismatch is said once.
        if said.len() < 10_000 && said.insert((here, there)) {
            log.log(
                Level::Warn,
                "a publisher and a subscription of the same topic do not match for their quality of service \
                 (`ros2 topic info -v` shows both); set qos_overrides.<topic>.…",
            );
        }
    }
    any
}

fn read_endpoints(
    participant: &rustdds::DomainParticipant,
    hub: &Hub,
    log: &Logger,
    said: &mut HashSet<(GUID, GUID)>,
) {
    let topics = hub.topics();
    if topics.is_empty() {
        return;
    }
    let (readers, writers) = (participant.discovered_readers(), participant.discovered_writers());
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
        let mut matching = 0;
        for writer in writers.iter().map(|w| &w.publication_topic_data).filter(|w| w.topic_name == dds_name) {
            if writer.type_name == dds_type {
                matching += 1;
                continue;
            }
            foreign.insert(Gid::from(writer.key));
            if said.len() < 10_000 && said.insert((writer.key, writer.key)) {
                log.log(
                    Level::Warn,
                    format!(
                        "somebody publishes {} on {name}, which is {type_name} here; those messages are refused",
                        writer.type_name
                    ),
                );
            }
        }
        state.remote_writers.store(matching, Ordering::Relaxed);
        *state.foreign_writers.write().unwrap_or_else(PoisonError::into_inner) = foreign;
    }
}

/// `sensor_msgs/msg/Imu` as `sensor_msgs::msg::dds_::Imu_`.
pub(crate) fn dds_type_name(type_name: &str) -> String {
    match type_name.rsplit_once('/') {
        Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
        None => type_name.to_owned(),
    }
}
