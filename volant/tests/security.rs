//! DDS security of the tools: `record`, `play`, `monitor` and `foxglove` join in their enclave, or
//! not at all.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

use bag::{BagWriter, Qos, Topic, WriteOptions};
use std::{path::Path, process::Command, time::Duration};
use tempfile::TempDir;
use test_support::process::{Running, in_domain};
use volant_msgs::std_msgs::msg::Header;

const TOPIC: &str = "/secret";

/// 8 s of messages at 20 Hz.
fn write_bag(path: &Path) {
    let mut bag = BagWriter::create(path, WriteOptions::default()).unwrap();
    let topic = bag.add_topic(Topic::of::<Header>(TOPIC, &Qos::RELIABLE));
    for i in 0..160u64 {
        let header = Header { frame_id: i.to_string(), ..Header::default() };
        bag.write_message(topic, 1_760_000_000_000_000_000 + i * 50_000_000, &header).unwrap();
    }
    bag.finish().unwrap();
}

/// A `volant` in a DDS domain, in an enclave of a keystore that is enforced.
fn volant(domain: u16, keystore: &Path, enclave: &str, arguments: &[&str]) -> Command {
    let mut command = in_domain(domain, env!("CARGO_BIN_EXE_volant"));
    command
        .args(arguments)
        .env("ROS_SECURITY_ENABLE", "true")
        .env("ROS_SECURITY_STRATEGY", "Enforce")
        .env("ROS_SECURITY_KEYSTORE", keystore)
        .env("ROS_SECURITY_ENCLAVE_OVERRIDE", enclave);
    command
}

#[test]
fn without_its_enclave_no_tool_joins() {
    let dir = TempDir::new().unwrap();
    let (keystore, input) = (dir.path().join("keys"), dir.path().join("in.mcap"));
    let out = dir.path().join("out.mcap");
    write_bag(&input);
    let (input, out_text) = (input.to_str().unwrap(), out.to_str().unwrap());
    for arguments in [
        &["record", "--out", out_text, "--duration", "1"][..],
        &["play", input],
        &["monitor", "--once", "--interval", "0.1"],
        &["foxglove", "127.0.0.1:0"],
        &["up", "climber_driver", "--foxglove=127.0.0.1:0"],
    ] {
        let tool = Running::start(&mut volant(66, &keystore, "/rig/laptop", arguments));
        // A server that starts all the same would never end.
        let (status, lines) = tool.finish(Duration::from_secs(30));
        let error = lines.join("\n");
        assert_eq!(status.code(), Some(1), "{arguments:?}: {error}");
        let keystore = keystore.display();
        for needle in [
            format!("the enclave /rig/laptop of the keystore {keystore}"),
            format!("{keystore}/enclaves/rig/laptop/cert.pem is missing"),
            format!("make-keystore {keystore} /rig/laptop"),
            "ROS_SECURITY_ENCLAVE_OVERRIDE".to_owned(),
        ] {
            assert!(error.contains(&needle), "{arguments:?}: {needle} in {error}");
        }
        assert_eq!(error.trim().lines().count(), 1, "{arguments:?}: {error}");
    }
    assert!(!out.exists(), "a recording that did not start leaves no file");
}

#[cfg(feature = "security")]
mod with_keys {
    use super::*;
    use bag::BagReader;
    use node_kit::{
        Level, NodeContext, Process, QosPreset,
        environment::{DiscoveryRange, Network, Security},
    };
    use std::{
        path::PathBuf,
        sync::{
            Arc,
            atomic::{AtomicU64, Ordering},
        },
    };

    fn make_keystore(folder: &Path) -> PathBuf {
        let script = Path::new(env!("CARGO_MANIFEST_DIR"));
        let script = script.join("../launch_config/setup/make-keystore");
        let status = Command::new(script).arg(folder).args(["/rig/robot", "/rig/laptop"]).status();
        assert!(status.unwrap().success());
        folder.to_owned()
    }

    enum Input {
        Beat,
        Received,
    }

    /// Publishes on [`TOPIC`] at 20 Hz and counts what it receives on `/back`.
    fn robot(network: Network, received: &Arc<AtomicU64>) -> Process {
        let mut process = Process::new(network).unwrap();
        let received = Arc::clone(received);
        let started = process.start_closure("robot", move |context: &mut NodeContext<Input>| {
            context.timer(Duration::from_millis(50), || Input::Beat);
            context.subscribe("/back", QosPreset::State, |_: Arc<Header>| Some(Input::Received))?;
            let publisher = context.advertise::<Header>(TOPIC, QosPreset::State)?;
            let received = Arc::clone(&received);
            Ok(move |context: &mut NodeContext<Input>, input: Input| match input {
                Input::Beat => publisher.publish(Header::default()),
                Input::Received => {
                    context.log(Level::Debug, "received");
                    received.fetch_add(1, Ordering::Relaxed);
                }
            })
        });
        started.unwrap();
        process
    }

    #[test]
    fn with_their_enclave_the_tools_exchange_data_with_the_robot() {
        let dir = TempDir::new().unwrap();
        let keystore = make_keystore(&dir.path().join("keys"));
        let received = Arc::new(AtomicU64::new(0));
        let network = Network {
            domain_id: 67,
            range: DiscoveryRange::Localhost,
            security: Some(Security::enforced(&keystore, "/rig/robot")),
            ..Network::default()
        };
        let robot = robot(network, &received);

        let out = dir.path().join("out.mcap");
        let record = ["record", "--out", out.to_str().unwrap(), "--duration", "12", TOPIC];
        let output = volant(67, &keystore, "/rig/laptop", &record).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        let recorded = BagReader::summary(&out).unwrap().count(TOPIC);
        assert!(recorded > 40, "{recorded} of some 200 messages recorded");

        let monitor = ["monitor", "--once", "--interval", "8"];
        let output = volant(67, &keystore, "/rig/laptop", &monitor).output().unwrap();
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success() && text.contains(TOPIC), "{output:?}");

        let input = dir.path().join("in.mcap");
        write_bag(&input);
        let remap = format!("{TOPIC}:=/back");
        let play = ["play", input.to_str().unwrap(), "--delay", "6", "--remap", &remap];
        let output = volant(67, &keystore, "/rig/laptop", &play).output().unwrap();
        assert!(output.status.success(), "{output:?}");
        let played = received.load(Ordering::Relaxed);
        assert!(played > 40, "{played} of 160 messages received");

        // A tool without security sees nothing of a secure robot.
        let mut open = volant(67, &keystore, "/rig/laptop", &monitor);
        let output = open.env_remove("ROS_SECURITY_ENABLE").output().unwrap();
        assert!(!String::from_utf8_lossy(&output.stdout).contains(TOPIC), "{output:?}");
        drop(robot);
    }
}
