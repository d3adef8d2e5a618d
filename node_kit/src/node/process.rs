//! Several nodes in one process: each on its own thread, one DDS participant for all, messages handed over as `Arc`s.

use super::{
    NodeError, NodeShell, clock::Clock, domain::Domain, handle::KitParts, kit::Event, life::live,
    logger::Logger, middleware::Loss,
};
use crate::{
    args::{Override, RosArguments},
    environment::Network,
    inbox::{Inbox, now},
    level::Level,
    names::NodeName,
    parameters::{ParameterSet, ParameterStore, common_descriptors},
};
use std::{
    collections::BTreeMap,
    sync::{
        Arc,
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread::JoinHandle,
    time::Duration,
};

/// A process with nodes in it.
///
/// ```no_run
/// # use node_kit::node::{Kit, NodeError, NodeShell, Process};
/// # struct Camera; struct Tracker;
/// # impl NodeShell for Camera { const NAME: &'static str = "camera"; type Parameters = (); type Input = ();
/// #     fn start(_: &mut Kit<()>, _: ()) -> Result<Self, NodeError> { Ok(Self) } fn handle(&mut self, _: &mut Kit<()>, _: ()) {} }
/// # impl NodeShell for Tracker { const NAME: &'static str = "tracker"; type Parameters = (); type Input = ();
/// #     fn start(_: &mut Kit<()>, _: ()) -> Result<Self, NodeError> { Ok(Self) } fn handle(&mut self, _: &mut Kit<()>, _: ()) {} }
/// # fn main() -> Result<(), NodeError> {
/// let (ros, _) = node_kit::RosArguments::parse(std::env::args().skip(1))?;
/// let process = Process::from_environment()?;
/// process.stop_on_signals()?;
/// process.run(|process| {
///     process.start::<Camera>(&ros)?;
///     process.start::<Tracker>(&ros)
/// })
/// # }
/// ```
pub struct Process {
    nodes: Vec<Running>,
    ended: Receiver<Ended>,
    ended_sender: SyncSender<Ended>,
    log: Logger,
    domain: Arc<Domain>,
}

struct Running {
    name: String,
    close: Box<dyn Fn() + Send>,
    thread: JoinHandle<Result<(), NodeError>>,
}

/// How long the end in order may take before a further signal ends the process at once.
const PATIENCE: Duration = Duration::from_secs(3);

/// What wakes [`Process::wait`].
#[derive(Clone, Copy, PartialEq)]
enum Ended {
    Node,
    Stop,
    Middleware(Loss),
}

/// Tells of the end of a node's thread, also when it panicked.
struct TellEnd(SyncSender<Ended>);

impl Drop for TellEnd {
    fn drop(&mut self) {
        let _ = self.0.try_send(Ended::Node);
    }
}

/// Asks a [`Process`] to stop, from any thread.
#[derive(Clone)]
pub struct Stopper(SyncSender<Ended>);

impl Stopper {
    /// Asks; returns at once. Asking again changes nothing.
    pub fn stop(&self) {
        let _ = self.0.try_send(Ended::Stop);
    }
}

impl Process {
    /// Joins the DDS domain that the environment names.
    ///
    /// # Errors
    /// A variable that cannot be, or DDS's refusal.
    pub fn from_environment() -> Result<Self, NodeError> {
        Self::from_arguments(&RosArguments::default())
    }

    /// Joins the DDS domain that the environment names, in the security enclave that the command line names.
    ///
    /// # Errors
    /// A variable that cannot be, keys that are not there, or DDS's refusal.
    pub fn from_arguments(arguments: &RosArguments) -> Result<Self, NodeError> {
        let network = Network::from_environment().map_err(|e| NodeError::Environment {
            name: e.name,
            value: e.value,
            expected: e.expected,
        })?;
        Self::new(network.with_enclave(arguments.enclave()))
    }

    /// Joins a DDS domain.
    ///
    /// # Errors
    /// DDS's refusal.
    pub fn new(network: Network) -> Result<Self, NodeError> {
        let log = Logger::new("volant".to_owned(), Level::Info, Clock::default());
        let (ended_sender, ended) = sync_channel(64);
        let domain = Arc::new(join_domain(network, &log, &ended_sender)?);
        Ok(Self { nodes: Vec::new(), ended, ended_sender, log, domain })
    }

    /// Starts a node; returns when its [`NodeShell::start`] has.
    ///
    /// # Errors
    /// Names or parameters that cannot be, or what the node's start says.
    pub fn start<S: NodeShell>(&mut self, arguments: &RosArguments) -> Result<(), NodeError> {
        let name = arguments.node_name(S::NAME)?;
        let overrides = arguments.overrides(&name);
        self.start_node::<S>(name, arguments, overrides)
    }

    fn start_node<S: NodeShell>(
        &mut self,
        name: NodeName,
        arguments: &RosArguments,
        mut overrides: BTreeMap<String, Override>,
    ) -> Result<(), NodeError> {
        let mut descriptors = S::Parameters::descriptors();
        descriptors.extend(common_descriptors());
        overrides
            .retain(|name, _| !arguments.is_of_others(name) || descriptors.iter().any(|d| d.name == *name));
        let store = ParameterStore::new(descriptors, overrides)?;
        let clock = Clock::default();
        let logger = Logger::new(
            name.fully_qualified().trim_start_matches('/').replace('/', "."),
            arguments.level(&name),
            clock.clone(),
        );
        let parts = KitParts {
            remaps: arguments.remaps(),
            rosout: arguments.rosout(),
            name: name.clone(),
            store,
            clock,
            logger,
        };
        let inbox = Inbox::<Event<S::Input>>::new();
        let close = Box::new({
            let inbox = inbox.clone();
            move || inbox.close()
        });
        let (started_sender, started) = sync_channel(1);
        let (domain, ended) = (Arc::clone(&self.domain), self.ended_sender.clone());
        let thread = std::thread::Builder::new()
            .name(name.base().chars().take(15).collect())
            .spawn(move || {
                let _tells = TellEnd(ended);
                live::<S>(domain, inbox, parts, &started_sender)
            })
            .map_err(|source| NodeError::System { what: format!("a thread for {}", name.base()), source })?;
        // The sender drops without a word when the node could not start; its thread says why.
        if started.recv().is_ok() {
            self.nodes.push(Running { name: name.fully_qualified(), close, thread });
            return Ok(());
        }
        let reason = join(thread, &name.fully_qualified());
        // That end has been reported here.
        let _ = self.ended.try_recv();
        reason
    }

    /// Has the middleware ended without being asked to, or was the system's clock set back? Then nothing is heard or said any more; [`Process::run`] mends that.
    pub fn middleware_ended(&self) -> bool {
        self.domain.ended.load(std::sync::atomic::Ordering::Acquire)
    }

    /// Something that stops the process from another thread.
    pub fn stopper(&self) -> Stopper {
        Stopper(self.ended_sender.clone())
    }

    /// Has SIGINT and SIGTERM stop the process in order. One that comes 3 s after the first or later ends it at once: Ctrl-C in
    /// a terminal gives a launched node two in a row, one of the terminal's and one of `ros2 launch`'s.
    ///
    /// # Errors
    /// The system refuses the handler.
    pub fn stop_on_signals(&self) -> Result<(), NodeError> {
        use signal_hook::{
            consts::{SIGINT, SIGTERM},
            iterator::Signals,
            low_level::emulate_default_handler,
        };
        let refused = |source| NodeError::System { what: "a signal handler".into(), source };
        let mut signals = Signals::new([SIGINT, SIGTERM]).map_err(refused)?;
        let stopper = self.stopper();
        std::thread::Builder::new()
            .name("signals".into())
            .spawn(move || {
                let mut first = None;
                for signal in signals.forever() {
                    stopper.stop();
                    if now().duration_since(*first.get_or_insert_with(now)) >= PATIENCE {
                        let _ = emulate_default_handler(signal);
                    }
                }
            })
            .map_err(refused)?;
        Ok(())
    }

    /// Waits until it is asked to stop, or a node ends; then stops all nodes and leaves the domain.
    ///
    /// # Errors
    /// Why the first node that failed did, or that the middleware ended.
    pub fn wait(mut self) -> Result<(), NodeError> {
        let lost = !self.nodes.is_empty() && matches!(self.ended.recv(), Ok(Ended::Middleware(_)));
        let outcome = self.shut_down();
        if lost { Err(NodeError::MiddlewareEnded) } else { outcome }
    }

    /// Starts nodes by `start`, and waits as [`Process::wait`] does; when the middleware ends, or is deaf because the clock was set back, joins the domain anew and starts them
    /// again. What they knew is gone then, as after a start of the process.
    ///
    /// # Errors
    /// As [`Process::start`] and [`Process::wait`].
    pub fn run(mut self, start: impl Fn(&mut Self) -> Result<(), NodeError>) -> Result<(), NodeError> {
        start(&mut self)?;
        while let Some(Ok(Ended::Middleware(loss))) = (!self.nodes.is_empty()).then(|| self.ended.recv()) {
            let _ = self.shut_down();
            // The ends of the nodes are no news; that the process is to stop is.
            if self.ended.try_iter().any(|ended| ended == Ended::Stop) {
                return Ok(());
            }
            self.log.log(Level::Warn, "joining the DDS domain anew and starting the nodes again");
            let mut domain = join_domain(self.domain.network.clone(), &self.log, &self.ended_sender)?;
            domain.took_over = Some((now(), loss));
            self.domain = Arc::new(domain);
            start(&mut self)?;
        }
        self.shut_down()
    }

    fn shut_down(&mut self) -> Result<(), NodeError> {
        for node in &self.nodes {
            (node.close)();
        }
        let mut first = Ok(());
        for node in std::mem::take(&mut self.nodes) {
            let result = join(node.thread, &node.name);
            if let Err(error) = &result {
                self.log.log(Level::Error, format!("{}: {error}", node.name));
            }
            if first.is_ok() {
                first = result;
            }
        }
        first
    }
}

fn join_domain(network: Network, log: &Logger, ended: &SyncSender<Ended>) -> Result<Domain, NodeError> {
    let ended = ended.clone();
    let lost = move |loss| {
        let _ = ended.try_send(Ended::Middleware(loss));
    };
    Domain::join(network, log.clone(), lost)
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.shut_down();
    }
}

fn join(thread: JoinHandle<Result<(), NodeError>>, node: &str) -> Result<(), NodeError> {
    thread.join().unwrap_or_else(|panic| {
        let message = panic
            .downcast_ref::<&str>()
            .map(|s| (*s).to_owned())
            .or_else(|| panic.downcast_ref::<String>().cloned())
            .unwrap_or_default();
        Err(NodeError::Panicked { node: node.to_owned(), message })
    })
}
