//! Nodes of `node_kit` against ROS 2 itself: rclpy on Fast DDS, as the `ros2` command line uses it.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod common;

use common::{Running, example};
use std::{
    path::{Path, PathBuf},
    time::Duration,
};

const LONG: Duration = Duration::from_secs(40);

/// The tests' Python, if it has rclpy.
fn rclpy() -> Option<PathBuf> {
    test_support::python("rclpy")
}

fn peer(domain: u16, python: &Path, arguments: &[&str]) -> Running {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/ros2_peer.py");
    let mut all = vec![script.to_str().unwrap()];
    all.extend(arguments);
    Running::start(domain, python, &all, &[])
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
    let _node =
        Running::start(41, &example("minimal_node"), &["--ros-args", "-r", "__ns:=/rig1"], &[]);
    let line = output(41, &python, &["look", "/rig1/minimal"]);
    for needle in [
        r#""/rig1/echo": ["geometry_msgs/msg/PoseWithCovarianceStamped"]"#,
        r#""/rig1/pose": ["geometry_msgs/msg/PoseWithCovarianceStamped"]"#,
        r#""/rig1/imu": ["sensor_msgs/msg/Imu"]"#,
        r#""/tf_static": ["tf2_msgs/msg/TFMessage"]"#,
        r#""/rosout": ["rcl_interfaces/msg/Log"]"#,
        r#""/diagnostics": ["diagnostic_msgs/msg/DiagnosticArray"]"#,
        r#""/rig1/minimal/get_parameters": ["rcl_interfaces/srv/GetParameters"]"#,
        r#""/rig1/minimal/change_state": ["lifecycle_msgs/srv/ChangeState"]"#,
    ] {
        assert!(line.contains(needle), "{needle} in {line}");
    }
}

/// `ros2 param list`, `describe`, `get`, `dump` and `set`; the replies have up to 100 kB.
#[test]
fn parameters_are_listed_described_dumped_and_set() {
    let Some(python) = rclpy() else { return };
    let node = Running::start(42, &example("minimal_node"), &[], &[]);
    for times in ["1", "20"] {
        let line = output(42, &python, &["parameters", "/minimal", times]);
        assert!(line.contains(r#""described": true"#), "{line}");
        let number = |key: &str| -> f64 {
            let rest = line.split(&format!("\"{key}\": ")).nth(1).unwrap();
            rest.split([',', '}']).next().unwrap().parse().unwrap()
        };
        eprintln!(
            "{} parameters in one request: {:.1} ms",
            number("requested"),
            number("seconds") * 1e3
        );
        assert_eq!(number("requested"), number("values"));
        assert!(number("requested") >= 20.0 * times.parse::<f64>().unwrap());
        assert!(
            line.contains(r#""beat": 10.0"#) && line.contains("Beats per second. [Hz]"),
            "{line}"
        );
    }
    // A reply larger than a datagram is refused with a log line, and the node continues.
    let (status, _) = peer(42, &python, &["parameters", "/minimal", "100"]).finish(LONG);
    assert!(!status.success());
    node.line_with("more than a datagram holds", LONG);

    let line = output(42, &python, &["set", "/minimal", "talk", "true"]);
    assert!(line.contains(r#""successful": true"#), "{line}");
    let line = output(42, &python, &["set", "/minimal", "autostart", "false"]);
    assert!(line.contains(r#""successful": false"#) && line.contains("cannot change"), "{line}");
}

#[test]
fn the_lifecycle_changes_state() {
    let Some(python) = rclpy() else { return };
    let _node = Running::start(43, &example("minimal_node"), &[], &[]);
    assert_eq!(
        output(43, &python, &["lifecycle", "/minimal"]),
        concat!(
            r#"{"state": "active", "transitions": ["deactivate", "shutdown"], "#,
            r#""deactivated": true, "then": "inactive", "activated": true, "at_last": "active"}"#
        )
    );
}

#[test]
fn messages_arrive_at_their_rate_and_the_end_is_seen_at_once() {
    let Some(python) = rclpy() else { return };
    let node = Running::start(44, &example("minimal_node"), &["--beat", "50"], &[]);
    let line = output(
        44,
        &python,
        &["receive", "/minimal/beats", "geometry_msgs/PoseWithCovarianceStamped", "100"],
    );
    let rate: f64 =
        line.split(r#""rate": "#).nth(1).unwrap().split(',').next().unwrap().parse().unwrap();
    assert!((45.0..55.0).contains(&rate), "{line}");
    let watcher = peer(44, &python, &["gone", "/minimal", "20"]);
    watcher.line_with("there", LONG);
    node.signal("TERM");
    let line = watcher.line_with("gone", LONG);
    let seconds: f64 =
        line.split(r#""seconds": "#).nth(1).unwrap().trim_end_matches('}').parse().unwrap();
    eprintln!("gone from the graph of Fast DDS after {seconds:.3} s");
    assert!(line.contains(r#""gone": true"#) && seconds < 1.0, "{line}");
}
