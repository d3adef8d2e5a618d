//! Starts nodes and peers as processes and ends them when the test ends.
#![allow(dead_code, reason = "each test uses a part")]
#![allow(clippy::unwrap_used, clippy::panic, clippy::disallowed_methods, reason = "tests")]

use node_kit::{environment::Network, node::join};
use ros2_client::{
    Context, Message, Name, Node, NodeName, NodeOptions, QosProfile, ServiceMapping,
    ServiceTypeName, qos::WhenFull, service::Client,
};
use rustdds::{
    CDRDeserializerAdapter, DomainParticipant, QosPolicyBuilder, ReadCondition, TopicKind,
    no_key::DataReader,
    policy::{Durability, History, Reliability},
};
use serde::Deserialize;
use std::{
    cell::RefCell,
    collections::{BTreeMap, BTreeSet},
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::mpsc::{Receiver, channel},
    time::{Duration, Instant},
};

/// The Python that has `cyclonedds`, else a skip.
pub fn python() -> Option<PathBuf> {
    test_support::python("cyclonedds")
}

/// An example of this crate; cargo builds them with the tests.
pub fn example(name: &str) -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let folder = test.parent().and_then(Path::parent).unwrap();
    folder.join("examples").join(name)
}

/// A ROS 2 node of another participant in this process, for clients of services.
pub fn client_node(domain: u16) -> Node {
    let network = Network { domain_id: domain, ..Network::default() };
    let (participant, _) = join(&network).unwrap();
    let context = Context::from_domain_participant(participant).unwrap();
    let options = NodeOptions::new().enable_rosout(false);
    context.new_node(NodeName::new("/", "client").unwrap(), options).unwrap()
}

/// Client of a service of `rcl_interfaces`, with the identity of a request beside the payload as
/// Fast DDS has it.
pub fn client<Request: Message + Clone + 'static, Response: Message + 'static>(
    node: &mut Node,
    service: &str,
    type_name: &str,
) -> Client<Request, Response> {
    let qos = QosProfile::publisher_default().reliability_reliable(WhenFull::Fail);
    node.create_client(
        ServiceMapping::Enhanced,
        &Name::parse(service).unwrap(),
        &ServiceTypeName::new("rcl_interfaces", type_name),
        qos.clone(),
        qos,
    )
    .unwrap()
}

pub struct Running {
    child: Child,
    lines: Receiver<String>,
}

impl Running {
    /// Runs a command in a DDS domain; both of its outputs can be read line by line.
    pub fn start(
        domain: u16,
        program: &Path,
        arguments: &[&str],
        environment: &[(&str, &str)],
    ) -> Self {
        let mut child = Command::new(program)
            .args(arguments)
            .env("ROS_DOMAIN_ID", domain.to_string())
            .env_remove("ROS_LOCALHOST_ONLY")
            .env_remove("ROS_AUTOMATIC_DISCOVERY_RANGE")
            .env_remove("RMW_IMPLEMENTATION")
            .envs(environment.iter().copied())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap_or_else(|e| panic!("{}: {e}", program.display()));
        let (sender, lines) = channel();
        let outputs: [Box<dyn Read + Send>; 2] =
            [Box::new(child.stdout.take().unwrap()), Box::new(child.stderr.take().unwrap())];
        for output in outputs {
            let sender = sender.clone();
            std::thread::spawn(move || {
                for line in BufReader::new(output).lines().map_while(Result::ok) {
                    if sender.send(line).is_err() {
                        return;
                    }
                }
            });
        }
        Self { child, lines }
    }

    pub fn peer(domain: u16, python: &Path, arguments: &[&str]) -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peer.py");
        let mut all = vec![script.to_str().unwrap()];
        all.extend(arguments);
        Self::start(domain, python, &all, &[])
    }

    /// The next line that contains `text`.
    pub fn line_with(&self, text: &str, within: Duration) -> String {
        self.line_with_all(&[text], within)
    }

    /// The next line that contains each of `texts`.
    pub fn line_with_all(&self, texts: &[&str], within: Duration) -> String {
        let deadline = Instant::now() + within;
        let mut before = Vec::new();
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.lines.recv_timeout(left) {
                Ok(line) if texts.iter().all(|text| line.contains(text)) => return line,
                Ok(line) => before.push(line),
                Err(_) => panic!("no line with {texts:?} within {within:?}; there was {before:?}"),
            }
        }
    }

    /// Lines received so far.
    pub fn lines_so_far(&self) -> Vec<String> {
        self.lines.try_iter().collect()
    }

    /// All lines until its end.
    pub fn finish(mut self, within: Duration) -> (ExitStatus, Vec<String>) {
        let status = self.wait(within);
        // The channel closes when the readers have read everything.
        (status, self.lines.iter().collect())
    }

    pub fn wait(&mut self, within: Duration) -> ExitStatus {
        let deadline = Instant::now() + within;
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(Instant::now() < deadline, "it still runs after {within:?}");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Waits until a signal ends it in order: the handler's thread runs.
    pub fn wait_for_signal_handler(&self) {
        let deadline = Instant::now() + Duration::from_secs(20);
        let threads = format!("/proc/{}/task", self.id());
        let name = |task: std::fs::DirEntry| std::fs::read_to_string(task.path().join("comm")).ok();
        while !std::fs::read_dir(&threads)
            .unwrap()
            .any(|task| task.ok().and_then(name).is_some_and(|name| name.trim() == "signals"))
        {
            assert!(Instant::now() < deadline, "it handles no signals");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Its process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    pub fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-s", name, &pid]).status().unwrap().success());
    }

    /// Resident memory, kB.
    pub fn memory(&self) -> u64 {
        self.status("VmRSS:")
    }

    /// Threads of the process.
    pub fn threads(&self) -> u64 {
        self.status("Threads:")
    }

    /// The number in a line of `/proc/PID/status`.
    fn status(&self, key: &str) -> u64 {
        let status = std::fs::read_to_string(format!("/proc/{}/status", self.child.id())).unwrap();
        let line = status.lines().find(|l| l.starts_with(key)).unwrap();
        line.split_whitespace().nth(1).unwrap().parse().unwrap()
    }

    /// Processor time of all threads.
    pub fn processor_time(&self) -> Duration {
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.child.id())).unwrap();
        let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
        let ticks: u64 = fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap();
        Duration::from_millis(ticks * 10)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Subscription of `ros_discovery_info`: which node has which endpoint.
pub struct Announced(RefCell<Reader>, RefCell<BTreeMap<[u8; 16], Vec<Announcement>>>);

type Reader = DataReader<Entities, CDRDeserializerAdapter<Entities>>;
type Announcement = (String, BTreeSet<[u8; 16]>);

#[derive(Deserialize)]
struct Entities {
    gid: [u8; 16],
    nodes: Vec<EntitiesOfNode>,
}

#[derive(Deserialize)]
struct EntitiesOfNode {
    _namespace: String,
    name: String,
    readers: Vec<[u8; 16]>,
    writers: Vec<[u8; 16]>,
}

impl Announced {
    pub fn subscribe(participant: &DomainParticipant) -> Self {
        let qos = QosPolicyBuilder::new()
            .reliability(Reliability::Reliable { max_blocking_time: rustdds::Duration::ZERO })
            .durability(Durability::TransientLocal)
            .history(History::KeepAll)
            .build();
        let type_name = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_".to_owned();
        let topic = participant
            .create_topic("ros_discovery_info".to_owned(), type_name, &qos, TopicKind::NoKey)
            .unwrap();
        let subscriber = participant.create_subscriber(&qos).unwrap();
        Self(
            subscriber.create_datareader_no_key(&topic, Some(qos)).unwrap().into(),
            RefCell::default(),
        )
    }

    /// Endpoints of the nodes with this base name, by what was announced last.
    pub fn endpoints(&self, node: &str) -> BTreeSet<[u8; 16]> {
        let mut all = self.1.borrow_mut();
        for sample in self.0.borrow_mut().take(1000, ReadCondition::any()).unwrap() {
            let Entities { gid, nodes } = sample.into_value();
            let nodes = nodes
                .into_iter()
                .map(|n| (n.name, n.readers.into_iter().chain(n.writers).collect()));
            all.insert(gid, nodes.collect());
        }
        let of_node = all.values().flatten().filter(|(name, _)| name == node);
        of_node.flat_map(|(_, endpoints)| endpoints.iter().copied()).collect()
    }
}
