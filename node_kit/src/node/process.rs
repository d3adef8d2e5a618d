//! Several nodes in one process: each on its own thread, one DDS participant for all, messages
//! shared as `Arc`s.

use super::{
    clock::Clock,
    context::NodeContext,
    domain::Domain,
    error::NodeError,
    handle::NodeParts,
    log_file,
    logger::{Logger, Sinks},
    middleware::Loss,
    runner,
    shell::NodeShell,
};
use crate::{
    args::RosArguments,
    console,
    environment::Network,
    inbox::{Inbox, Sources, now},
    level::Level,
};
use parking_lot::Mutex;
use std::{
    sync::{
        Arc,
        mpsc::{Receiver, SyncSender, sync_channel},
    },
    thread::JoinHandle,
    time::Duration,
};

/// Nodes of one process; `volant/examples/embedded_nodes.rs` is a program around one.
pub struct Process {
    nodes: Vec<Running>,
    ended: Receiver<Ended>,
    ended_sender: SyncSender<Ended>,
    log: Logger,
    sinks: Sinks,
    domain: Arc<Domain>,
}

struct Running {
    name: String,
    inbox: Arc<dyn Sources>,
    thread: JoinHandle<Result<(), NodeError>>,
}

/// Time for an orderly end, after which a further signal ends the process at once.
const GRACE_PERIOD: Duration = Duration::from_secs(3);

/// Events that can wait.
const ENDS: usize = 64;
const MIDDLEWARE_ENDED: &str = "the DDS middleware ended: it was interrupted (the process was \
                                stopped and continued), the computer was suspended, or its clock \
                                was set back; start again";

type Ends = (SyncSender<Ended>, Receiver<Ended>);

/// Event that wakes [`Process::wait`].
#[derive(Clone, Copy, PartialEq)]
enum Ended {
    Node,
    Stop,
    Middleware(Loss),
}

/// Reports the end of a node's thread when it drops, also by a panic.
struct ReportEnd(SyncSender<Ended>);

impl Drop for ReportEnd {
    fn drop(&mut self) {
        let _ = self.0.try_send(Ended::Node);
    }
}

impl Process {
    /// Joins the DDS domain that the environment names.
    ///
    /// # Errors
    /// A variable with an invalid value; else as [`Process::new`].
    pub fn from_environment() -> Result<Self, NodeError> {
        Self::with_arguments(&RosArguments::default(), sync_channel(ENDS))
    }

    /// Joins the DDS domain that the environment names, in the security enclave that the command
    /// line names. Signals stop the process from the beginning ([`Process::stop_on_signals`]): one
    /// that came while it joins would leave a participant behind.
    ///
    /// # Errors
    /// As [`Process::from_environment`] and [`Process::stop_on_signals`].
    pub fn from_arguments(arguments: &RosArguments) -> Result<Self, NodeError> {
        let ends = sync_channel(ENDS);
        handle_signals(ends.0.clone())?;
        Self::with_arguments(arguments, ends)
    }

    fn with_arguments(arguments: &RosArguments, ends: Ends) -> Result<Self, NodeError> {
        let outputs = arguments.log_outputs();
        let mut sinks = Sinks { no_console: outputs.no_console, file: None };
        let mut trouble = Network::ignored_variables();
        if !outputs.no_file {
            match log_file::create(outputs.file_name.as_deref()) {
                Ok(file) => sinks.file = file.map(|file| Arc::new(Mutex::new(file))),
                Err((path, error)) => trouble.push(format!(
                    "no log file: {}: {error}; set ROS_LOG_DIR to a folder that can be written, or \
                     pass --disable-external-lib-logs",
                    path.display()
                )),
            }
        }
        let network = Network::from_environment_in(arguments.enclave())?;
        let process = Self::with_sinks(network, sinks, ends)?;
        trouble.iter().for_each(|line| process.log.log(Level::Warn, line));
        Ok(process)
    }

    /// Joins a DDS domain.
    ///
    /// # Errors
    /// As [`join`](super::join).
    pub fn new(network: Network) -> Result<Self, NodeError> {
        Self::with_sinks(network, Sinks::default(), sync_channel(ENDS))
    }

    fn with_sinks(
        network: Network,
        sinks: Sinks,
        (ended_sender, ended): Ends,
    ) -> Result<Self, NodeError> {
        let log = Logger::new("volant".to_owned(), Level::Info, Clock::default(), sinks.clone());
        let domain = Arc::new(join_domain(network, &log, &ended_sender)?);
        Ok(Self { nodes: Vec::new(), ended, ended_sender, log, sinks, domain })
    }

    /// Starts a node; returns when its [`NodeShell::start`] has.
    ///
    /// # Errors
    /// Invalid names or parameters, or the error of the node's start.
    pub fn start<S: NodeShell>(&mut self, arguments: &RosArguments) -> Result<(), NodeError> {
        self.start_with(arguments, S::start)
    }

    /// Starts a node whose shell is created by `start` instead of [`NodeShell::start`].
    pub(super) fn start_with<S: NodeShell>(
        &mut self,
        arguments: &RosArguments,
        start: impl FnMut(&mut NodeContext<S::Input>, S::Parameters) -> Result<S, NodeError>
        + Send
        + 'static,
    ) -> Result<(), NodeError> {
        let name = arguments.node_name(S::NAME)?;
        let doubtful = arguments.check_node_names(&name, S::NAME)?;
        let store = arguments.declare::<S::Parameters>(&name)?;
        let clock = Clock::default();
        let logger = Logger::new(
            name.fully_qualified().trim_start_matches('/').replace('/', "."),
            arguments.level(&name),
            clock.clone(),
            self.sinks.clone(),
        );
        for block in doubtful {
            logger.log(Level::Warn, format!("{block}, if it is not another node's"));
        }
        for ignored in store.ignored() {
            logger.log(Level::Warn, ignored);
        }
        let parts = NodeParts {
            remaps: arguments.remaps(),
            rosout: !arguments.log_outputs().no_rosout,
            name: name.clone(),
            store,
            clock,
            logger,
        };
        let inbox = Inbox::<S::Input>::new();
        let own_inbox = inbox.clone();
        let (started_sender, started) = sync_channel(1);
        let (domain, ended) = (Arc::clone(&self.domain), self.ended_sender.clone());
        let thread = std::thread::Builder::new()
            .name(name.base().chars().take(15).collect())
            .spawn(move || {
                let _report = ReportEnd(ended);
                runner::run::<S>(domain, own_inbox, parts, Box::new(start), &started_sender)
            })
            .map_err(|error| NodeError::System {
                what: format!("a thread for {}", name.base()),
                error,
            })?;
        // The sender drops unused when the node could not start; the thread's result says why.
        if started.recv().is_ok() {
            self.nodes.push(Running { name: name.fully_qualified(), inbox, thread });
            return Ok(());
        }
        let reason = join(thread, &name.fully_qualified());
        // The end of this thread is reported here.
        let _ = self.ended.try_recv();
        reason
    }

    /// Returns whether the middleware has become unusable ([`Loss`]): nothing is received or
    /// published then, until [`Process::run`] joins the domain again.
    pub fn middleware_ended(&self) -> bool {
        self.domain.ended.load(std::sync::atomic::Ordering::Acquire)
    }

    /// Stops the process in order on each of [`console::stop_signals`]. A signal that arrives 3 s
    /// after the first or later ends it at once; earlier ones are ignored, because Ctrl-C in a
    /// terminal sends a launched node two in a row, one of the terminal and one of `ros2 launch`.
    ///
    /// # Errors
    /// The system refuses the handler.
    pub fn stop_on_signals(&self) -> Result<(), NodeError> {
        handle_signals(self.ended_sender.clone())
    }

    /// Waits until the process is stopped or a node ends; then stops all nodes and leaves the
    /// domain.
    ///
    /// # Errors
    /// The first error of a node, or that the middleware ended.
    pub fn wait(mut self) -> Result<(), NodeError> {
        self.domain.supervisor.send("READY=1");
        let lost = !self.nodes.is_empty() && matches!(self.ended.recv(), Ok(Ended::Middleware(_)));
        self.domain.supervisor.send("STOPPING=1");
        let outcome = self.shut_down();
        if lost { Err(NodeError::shell(MIDDLEWARE_ENDED)) } else { outcome }
    }

    /// Starts nodes with `start` and waits as [`Process::wait`] does. When the middleware becomes
    /// unusable, joins the domain again and restarts the nodes, which lose their state.
    ///
    /// # Errors
    /// As [`Process::start`] and [`Process::wait`].
    pub fn run(
        mut self,
        start: impl Fn(&mut Self) -> Result<(), NodeError>,
    ) -> Result<(), NodeError> {
        start(&mut self)?;
        self.domain.supervisor.send("READY=1");
        while let Some(Ok(Ended::Middleware(loss))) =
            (!self.nodes.is_empty()).then(|| self.ended.recv())
        {
            let _ = self.shut_down();
            // The ends of the nodes are expected; a request to stop is not.
            if self.ended.try_iter().any(|ended| ended == Ended::Stop) {
                return Ok(());
            }
            self.log.log(Level::Warn, "rejoining the DDS domain and restarting the nodes");
            let mut domain =
                join_domain(self.domain.network.clone(), &self.log, &self.ended_sender)?;
            domain.took_over = Some((now(), loss));
            self.domain = Arc::new(domain);
            start(&mut self)?;
        }
        self.domain.supervisor.send("STOPPING=1");
        self.shut_down()
    }

    fn shut_down(&mut self) -> Result<(), NodeError> {
        for node in &self.nodes {
            node.inbox.close();
        }
        let mut first = Ok(());
        for node in std::mem::take(&mut self.nodes) {
            let result = join(node.thread, &node.name);
            if let Err(error) = &result {
                self.log.log(Level::Error, format!("{}: {error}", node.name));
            }
            first = first.and(result);
        }
        first
    }
}

fn handle_signals(ended: SyncSender<Ended>) -> Result<(), NodeError> {
    use signal_hook::{iterator::Signals, low_level::emulate_default_handler};
    let refused = |error| NodeError::System { what: "a signal handler".into(), error };
    let mut signals = Signals::new(console::stop_signals()).map_err(refused)?;
    std::thread::Builder::new()
        .name("signals".into())
        .spawn(move || {
            let mut first = None;
            for signal in signals.forever() {
                let _ = ended.try_send(Ended::Stop);
                if now().duration_since(*first.get_or_insert_with(now)) >= GRACE_PERIOD {
                    let _ = emulate_default_handler(signal);
                }
            }
        })
        .map_err(refused)?;
    Ok(())
}

fn join_domain(
    network: Network,
    log: &Logger,
    ended: &SyncSender<Ended>,
) -> Result<Domain, NodeError> {
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
        Err(NodeError::shell(format!(
            "the node {node} stopped on an internal error: {message}; please report it"
        )))
    })
}
