//! Nodes of `node_kit` against ROS 2 itself: rclpy on Fast DDS, as the `ros2` command line uses it.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]
#![allow(clippy::disallowed_methods, reason = "tests")]

mod common;

use common::{minimal, number, script};
use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};
use test_support::process::Running;
use volant_msgs::{Message, SERVICES, geometry_msgs::msg::PoseWithCovarianceStamped};

const LONG: Duration = Duration::from_secs(40);

/// The tests' Python, if it has rclpy.
fn rclpy() -> Option<PathBuf> {
    test_support::python("rclpy")
}

fn peer(domain: u16, python: &Path, arguments: &[&str]) -> Running {
    script(domain, python, "ros2_peer.py", arguments)
}

/// The JSON line that the peer prints.
fn output(domain: u16, python: &Path, arguments: &[&str]) -> String {
    let (status, lines) = peer(domain, python, arguments).finish(LONG);
    assert!(status.success(), "{arguments:?}: {lines:?}");
    lines.into_iter().find(|l| l.starts_with('{')).unwrap()
}

#[test]
fn the_graph_is_that_of_any_node() {
    let Some(python) = rclpy() else { return };
    let names = ["--ros-args", "-r", "__ns:=/rig1", "-r", "pose:=/elsewhere/pose"];
    let _node = minimal(41, &names, &[]);
    let line = output(41, &python, &["look", "/rig1/minimal"]);
    for needle in [
        r#""/rig1/echo": ["geometry_msgs/msg/PoseWithCovarianceStamped"]"#,
        r#""/rig1/minimal/beats": ["geometry_msgs/msg/PoseWithCovarianceStamped"]"#,
        r#""/elsewhere/pose": ["geometry_msgs/msg/PoseWithCovarianceStamped"]"#,
        r#""/rig1/imu": ["sensor_msgs/msg/Imu"]"#,
        r#""/tf_static": ["tf2_msgs/msg/TFMessage"]"#,
        r#""/rosout": ["rcl_interfaces/msg/Log"]"#,
        r#""/diagnostics": ["diagnostic_msgs/msg/DiagnosticArray"]"#,
        r#""/rig1/minimal/get_parameters": ["rcl_interfaces/srv/GetParameters"]"#,
        r#""/rig1/minimal/change_state": ["lifecycle_msgs/srv/ChangeState"]"#,
    ] {
        assert!(line.contains(needle), "{needle} in {line}");
    }
    assert!(!line.contains(r#""/clock""#) && !line.contains(r#""//"#), "{line}");
}

/// `ros2 param list`, `describe`, `get`, `dump` and `set`; the replies have up to 500 kB.
#[test]
fn parameters_are_listed_described_dumped_and_set() {
    let Some(python) = rclpy() else { return };
    let _node = minimal(42, &[], &[]);
    for times in ["1", "20", "100"] {
        let line = output(42, &python, &["parameters", "/minimal", times]);
        assert!(line.contains(r#""described": true"#), "{line}");
        let requested = number(&line, "requested");
        assert_eq!(requested, number(&line, "values"));
        assert!(requested >= 20.0 * times.parse::<f64>().unwrap());
        assert!(
            line.contains(r#""beat": 10.0"#) && line.contains("Beats per second. [Hz]"),
            "{line}"
        );
    }

    let line = output(42, &python, &["assign", "/minimal", "talk", "true"]);
    assert!(line.contains(r#""successful": true"#), "{line}");
    let line = output(42, &python, &["assign", "/minimal", "autostart", "false"]);
    assert!(line.contains(r#""successful": false"#) && line.contains("cannot change"), "{line}");
}

#[test]
fn the_lifecycle_changes_state() {
    let Some(python) = rclpy() else { return };
    let _node = minimal(43, &[], &[]);
    assert_eq!(
        output(43, &python, &["lifecycle", "/minimal"]),
        concat!(
            r#"{"state": "active", "transitions": ["deactivate", "shutdown"], "#,
            r#""deactivated": true, "then": "inactive", "activated": true, "at_last": "active"}"#
        )
    );
}

#[test]
fn messages_arrive_at_their_rate() {
    let Some(python) = rclpy() else { return };
    let _node = minimal(44, &["--beat", "50"], &[]);
    let line = output(
        44,
        &python,
        &["receive", "/minimal/beats", "geometry_msgs/PoseWithCovarianceStamped", "100"],
    );
    assert!((45.0..55.0).contains(&number(&line, "rate")), "{line}");
}

/// The `ros2` daemon and every long-lived node keep a graph: it must not show what has ended.
#[test]
fn topics_and_services_are_gone_within_a_second_of_a_signal() {
    let Some(python) = rclpy() else { return };
    for (domain, signal) in [(45, "INT"), (46, "TERM")] {
        let mut node = minimal(domain, &[], &[]);
        let watcher = peer(domain, &python, &["endpoints_gone", "/minimal", "30"]);
        watcher.line_with("there", LONG);
        let interrupted = Instant::now();
        node.signal(signal);
        // `ros2 launch` in a terminal sends a second one at once, which must not interrupt the end.
        node.signal(signal);
        let line = watcher.line_with("gone", LONG);
        let seconds = interrupted.elapsed().as_secs_f64();
        assert!(line.contains(r#""gone": true"#) && seconds < 1.0, "{seconds:.3} s: {line}");
        assert!(node.wait(Duration::from_secs(1)).success());
    }
}

/// `ros2 topic pub --once` lives for 0.1 s after its message; a script may end at once. The first
/// publisher of each series waits for the node.
#[test]
fn a_single_message_of_a_short_lived_publisher_arrives() {
    const TRIES: usize = 30;
    let Some(python) = rclpy() else { return };
    for (domain, alive) in [(47, "0.1"), (48, "0")] {
        let publisher = peer(domain, &python, &["once", "/pose", &TRIES.to_string(), alive]);
        std::thread::sleep(Duration::from_secs(1));
        let talk = ["--talk", "true"];
        let node = minimal(domain, &talk, &[]);
        let (status, lines) = publisher.finish(2 * LONG);
        assert!(status.success(), "{lines:?}");
        std::thread::sleep(Duration::from_millis(500));
        let received = node.lines_so_far();
        let lost: Vec<usize> = (0..TRIES)
            .filter(|i| !received.iter().any(|line| line.contains(&format!("a pose in <{i}>"))))
            .collect();
        assert!(lost.is_empty(), "publishers alive for {alive} s; lost: {lost:?}: {received:?}");
    }
}

#[test]
fn types_are_described_as_rclpy_describes_them() {
    let Some(python) = rclpy() else { return };
    let _node = minimal(50, &[], &[]);
    let service = SERVICES.iter().find(|(name, _)| name.ends_with("/SetParameters")).unwrap();
    type Pose = PoseWithCovarianceStamped;
    for (name, hash) in [(Pose::TYPE_NAME, Pose::RIHS01_HASH), *service] {
        let line = output(50, &python, &["described", "/minimal", name, hash]);
        assert!(line.contains(r#"{"equal": true, "texts_equal": true"#), "{line}");
    }
    let off = ["--ros-args", "-p", "start_type_description_service:=false", "-r", "__node:=off"];
    let _off = minimal(50, &off, &[]);
    let line = output(50, &python, &["look", "/off"]);
    assert!(line.contains("/off/get_parameters"), "{line}");
    assert!(!line.contains("/off/get_type_description"), "{line}");
}

/// What `ros2 topic info -v` prints: hashes as rosidl computes them (without them `ros2` on Cyclone
/// DDS warns of every endpoint), and the QoS of rclcpp. `ros_discovery_info` lists every endpoint,
/// the replies of services included: a bridge ignores others.
#[test]
fn type_hashes_enclave_and_parameter_events_are_those_of_rclpy() {
    let Some(python) = rclpy() else { return };
    let _node = minimal(49, &[], &[]);
    let line = output(49, &python, &["announced", "/minimal"]);
    for needle in [
        r#""one_each": true"#,
        r#""valid": true"#,
        r#""enclaves": ["/"]"#,
        r#""durability": ["VOLATILE"]"#,
        r#""nodeless": ["ros_discovery_info"]"#,
        r#""event": true"#,
        PoseWithCovarianceStamped::RIHS01_HASH,
    ] {
        assert!(line.contains(needle), "{needle} in {line}");
    }
    // Twelve services with two topics each, those of the peer, and the topics.
    assert!(line.matches("RIHS01_").count() > 40, "{line}");
}
