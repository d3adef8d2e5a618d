//! Conflicts in the ROS graph, with real processes: two publishers of one topic, two nodes of one
//! name, two rigs in one namespace. `/diagnostics` names both ends and the remedy.
#![allow(clippy::disallowed_methods, reason = "a test that waits")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test")]

use node_kit::{
    NodeContext, NodeError, Process, Publisher, QosPreset, convert::time, environment::Network,
};
use std::{
    path::Path,
    process::{Command, Stdio},
    sync::{Arc, mpsc},
    time::{Duration, Instant},
};
use test_support::process::{Running, wait_until};
use volant_msgs::{
    diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus},
    sensor_msgs::msg::JointState,
};
use volant_test::live::processes::{Node, Signal};

const LONG: Duration = Duration::from_secs(20);
const RIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../launch_config/config/rig.yaml");

enum Input {
    Beat,
    Statuses(Arc<DiagnosticArray>),
}

/// Starts a node that publishes joint states in two namespaces and passes statuses on.
fn start_observer(
    process: &mut Process,
    statuses: mpsc::SyncSender<DiagnosticStatus>,
) -> Result<(), NodeError> {
    process.start_closure("observer", move |context: &mut NodeContext<Input>| {
        context.timer(Duration::from_millis(20), || Input::Beat);
        context.subscribe("/diagnostics", QosPreset::State, |m| Some(Input::Statuses(m)))?;
        let joints = ["/climber/joint_states", "/rig2/climber/joint_states"]
            .map(|topic| context.advertise(topic, QosPreset::State));
        let joints: Vec<Publisher<JointState>> = joints.into_iter().collect::<Result<_, _>>()?;
        let statuses = statuses.clone();
        Ok(move |context: &mut NodeContext<Input>, input: Input| match input {
            Input::Beat => {
                let mut message = JointState::default();
                message.header.stamp = time(context.now());
                message.name = ["rail_x", "rail_y", "turn"].map(str::to_owned).to_vec();
                message.position = vec![0.0; 3];
                joints.iter().for_each(|topic| topic.publish(message.clone()));
            }
            Input::Statuses(array) => {
                for status in &array.status {
                    let _ = statuses.try_send(status.clone());
                }
            }
        })
    })
}

/// A domain: its nodes' logs and diagnostics.
struct Observed {
    domain: u16,
    logs: tempfile::TempDir,
    _process: Process,
    statuses: mpsc::Receiver<DiagnosticStatus>,
}

impl Observed {
    fn start(domain: u16) -> Self {
        let (sender, statuses) = mpsc::sync_channel(10_000);
        let mut process =
            Process::new(Network { domain_id: domain, ..Network::default() }).unwrap();
        start_observer(&mut process, sender).unwrap();
        Self { domain, logs: tempfile::tempdir().unwrap(), _process: process, statuses }
    }

    /// Starts a node's process; `label` separates the logs.
    fn node(&self, label: &str, name: &str, arguments: &[&str]) -> Node {
        let folder = self.logs.path().join(label);
        std::fs::create_dir_all(&folder).unwrap();
        let words = [&["--rig", RIG], arguments].concat();
        let environment = [("ROS_DOMAIN_ID".to_owned(), self.domain.to_string())];
        Node::start(None, name, &words, &environment, &folder).unwrap()
    }

    /// Waits for a status of `node` named `graph` whose message has each of `texts`, and returns
    /// the message.
    fn graph(&self, node: &str, level: u8, texts: &[&str]) -> String {
        while self.statuses.try_recv().is_ok() {}
        let deadline = Instant::now() + LONG;
        let mut last = String::new();
        while Instant::now() < deadline {
            let Ok(status) = self.statuses.recv_timeout(LONG) else { break };
            if status.hardware_id != node || !status.name.ends_with(": graph") {
                continue;
            }
            if status.level == level && texts.iter().all(|text| status.message.contains(text)) {
                return status.message;
            }
            last = status.message;
        }
        panic!("{node}: no {texts:?} at level {level}; the last: {last}");
    }
}

fn end(mut node: Node) {
    node.signal(Signal::TERM).unwrap();
    assert!(wait_until(LONG, || node.ended().is_some()), "{} does not end", node.name);
}

const OK: u8 = DiagnosticStatus::OK;
const WARN: u8 = DiagnosticStatus::WARN;

#[test]
fn two_drivers_and_then_two_rigs_in_one_namespace_are_named() {
    let observed = Observed::start(62);
    let driver = observed.node("first", "climber_driver", &[]);
    let _fusion = observed.node("first", "pose_fusion", &[]);
    // A rig of its own namespace disturbs nobody.
    let space = ["--ros-args", "-r", "__ns:=/rig2", "-r", "/tf:=tf", "-r", "/tf_static:=tf_static"];
    let _second_rig = observed.node("rig2", "climber_driver", &space);
    for name in ["/climber_driver", "/pose_fusion", "/rig2/climber_driver"] {
        observed.graph(name, OK, &[]);
    }

    let double = observed.node("second", "climber_driver", &[]);
    let texts =
        ["2 nodes are named /climber_driver", "-r __node:=NAME", "at this computer, process "];
    let named = observed.graph("/climber_driver", WARN, &texts);
    let ids = [&driver, &double].map(|node| format!("this computer, process {} ", node.id()));
    assert!(ids.iter().any(|id| named.contains(id)), "{named}");
    assert_eq!(named.matches("participant 01.12.").count(), 2, "{named}");
    // A publisher is known a moment before its node's name.
    let deadline = Instant::now() + LONG;
    let published = loop {
        let text = observed.graph("/pose_fusion", WARN, &["2 publishers on /climber/transform"]);
        if text.matches("/climber_driver at ").count() == 2 {
            break text;
        }
        assert!(Instant::now() < deadline, "{text}");
    };
    assert_eq!(published.matches("GID 01.12.").count(), 2, "{published}");
    assert!(published.contains("-r FROM:=TO"), "{published}");
    observed.graph("/rig2/climber_driver", OK, &[]);

    let second_fusion = observed.node("second", "pose_fusion", &[]);
    for name in ["/climber_driver", "/pose_fusion"] {
        let texts = ["two rigs in the namespace /", "/climber_driver, /pose_fusion", "__ns:=/rig1"];
        observed.graph(name, WARN, &texts);
    }

    end(second_fusion);
    end(double);
    observed.graph("/climber_driver", OK, &[]);
    observed.graph("/pose_fusion", OK, &[]);
}

/// A node that was killed is listed until its lease ends; its successor is no second publisher.
#[test]
fn a_publisher_that_was_killed_is_no_second_one() {
    let observed = Observed::start(63);
    let mut driver = observed.node("killed", "climber_driver", &[]);
    let _fusion = observed.node("killed", "pose_fusion", &[]);
    observed.graph("/pose_fusion", OK, &[]);
    driver.kill().unwrap();
    driver.restart().unwrap();
    // Over the time for which the killed one counts as sending, and far below its lease (50 s).
    std::thread::sleep(Duration::from_secs(5));
    observed.graph("/pose_fusion", OK, &[]);
    observed.graph("/climber_driver", OK, &[]);
}

#[test]
fn foreign_publishers_beside_ours_are_named() {
    let names = [("cyclonedds", "a publisher without a node name"), ("rclpy", "/foreign at ")];
    for (domain, (module, name)) in (64..).zip(names) {
        let Some(python) = test_support::python(module) else { return };
        let observed = Observed::start(domain);
        let _driver = observed.node(module, "climber_driver", &[]);
        let _fusion = observed.node(module, "pose_fusion", &[]);
        observed.graph("/pose_fusion", OK, &[]);
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peer/publish.py");
        let mut foreign = Command::new(python);
        foreign.arg(script).args([module, "/climber/transform"]);
        foreign.env("ROS_DOMAIN_ID", domain.to_string()).stdin(Stdio::null());
        let foreign = Running::start(foreign.env_remove("ROS_AUTOMATIC_DISCOVERY_RANGE"));
        let texts = ["2 publishers on /climber/transform", "/climber_driver at ", name, "GID "];
        observed.graph("/pose_fusion", WARN, &texts);
        observed.graph("/climber_driver", OK, &[]);
        drop(foreign);
        std::thread::sleep(Duration::from_secs(4));
        observed.graph("/pose_fusion", OK, &[]);
    }
}
