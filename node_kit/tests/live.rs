//! Nodes of `node_kit` against a foreign DDS peer (PyPI `cyclonedds`), in processes of their own.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod common;

use common::{minimal, number, peer, python, start};
use std::{process::Command, time::Duration};
use test_support::process::example;

const LONG: Duration = Duration::from_secs(20);

#[test]
fn messages_cross_both_ways_unchanged() {
    let Some(python) = python() else { return };
    let _node = minimal(1, &[], &[]);
    for (from, to, kind) in [("/pose", "/echo", "pose"), ("/imu", "/imu_echo", "imu")] {
        let (_, lines) = peer(1, &python, &["echo", from, to, kind, "20"]).finish(LONG);
        assert_eq!(lines, ["20"], "{kind}");
    }
}

#[test]
fn a_late_joiner_gets_the_static_transform_once() {
    let Some(python) = python() else { return };
    let _node = minimal(2, &[], &[]);
    std::thread::sleep(Duration::from_millis(500));
    let (_, lines) = peer(2, &python, &["receive", "/tf_static", "tf", "5", "1.5"]).finish(LONG);
    assert_eq!(lines.len(), 1, "{lines:?}");
    assert!(lines[0].contains(r#""child_frame_id": "minimal""#), "{lines:?}");
}

/// RustDDS's threads end when the process is stopped and continued; the node rejoins the domain.
#[test]
fn a_node_that_was_stopped_and_continued_publishes_again() {
    let Some(python) = python() else { return };
    let node = minimal(39, &[], &[]);
    let _ = peer(39, &python, &["echo", "/pose", "/echo", "pose", "5"]).finish(LONG);
    node.signal("STOP");
    std::thread::sleep(Duration::from_millis(300));
    node.signal("CONT");
    node.line_with("rejoining the DDS domain", Duration::from_secs(5));
    let (_, lines) = peer(39, &python, &["echo", "/pose", "/echo", "pose", "20"]).finish(LONG);
    assert_eq!(lines, ["20"]);
}

#[test]
fn diagnostics_name_the_topic_that_is_missing() {
    let Some(python) = python() else { return };
    let _node = minimal(5, &[], &[]);
    let (_, lines) =
        peer(5, &python, &["receive", "/diagnostics", "diagnostics", "1", "5"]).finish(LONG);
    assert!(
        lines[0].contains("no messages on /pose") && !lines[0].contains("no messages on /imu"),
        "{lines:?}"
    );
}

#[test]
fn parameters_and_lifecycle_are_served() {
    let Some(python) = python() else { return };
    let node = minimal(6, &[], &[("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")]);
    let caller = peer(6, &python, &["calls", "/minimal"]);
    for (what, needles) in [
        ("list", vec![r#""beat""#, r#""use_sim_time""#, r#""markers.size""#, r#""markers""#]),
        ("get", vec![r#""type": 3"#, r#""double_value": 10.0"#, r#""type": 0"#]),
        (
            "describe",
            vec!["Beats per second. [Hz]", r#""read_only": true"#, r#""to_value": 1000.0"#],
        ),
        ("set_live", vec![r#""successful": true"#]),
        ("set_fixed", vec![r#""successful": false"#, "`beat` cannot change"]),
        ("get_after", vec![r#""bool_value": true"#]),
        ("state", vec![r#""active""#]),
        ("activate_again", vec![r#""success": false"#]),
        ("deactivate", vec![r#""success": true"#]),
        ("state_after", vec![r#""inactive""#]),
        ("cleanup", vec![r#""success": true"#]),
        ("configure", vec![r#""success": true"#]),
        ("activate", vec![r#""success": true"#]),
    ] {
        let line = caller.line_with(&format!("\"{what}\": "), LONG);
        for needle in needles {
            assert!(line.contains(needle), "{what}: {needle} in {line}");
        }
    }
    // The topics work again afterwards.
    let (_, lines) = peer(6, &python, &["echo", "/pose", "/echo", "pose", "5"]).finish(LONG);
    assert_eq!(lines, ["5"]);
    drop(node);
}

/// As rmw_cyclonedds configures Cyclone DDS for `ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST`: RViz or
/// a bridge that runs before the rig starts.
#[test]
fn a_cyclone_process_without_multicast_sees_a_new_node() {
    let Some(python) = python() else { return };
    let uri = "<CycloneDDS><Domain><General><AllowMulticast>false</AllowMulticast></General>\
               <Discovery><ParticipantIndex>auto</ParticipantIndex>\
               <MaxAutoParticipantIndex>32</MaxAutoParticipantIndex>\
               <Peers><Peer address=\"localhost\"/></Peers></Discovery></Domain></CycloneDDS>";
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peer.py");
    let arguments = [script, "graph", "15", "rt/pose"];
    for (domain, range) in [(28, "LOCALHOST"), (29, "SUBNET")] {
        let peer = start(domain, &python, &arguments, &[("CYCLONEDDS_URI", uri)]);
        peer.line_with(r#""pub": []"#, LONG);
        let _node = minimal(domain, &[], &[("ROS_AUTOMATIC_DISCOVERY_RANGE", range)]);
        peer.line_with("PoseWithCovarianceStamped", LONG);
    }
}

#[test]
fn a_node_without_autostart_waits_without_topics() {
    let Some(python) = python() else { return };
    let _node = minimal(7, &["--ros-args", "-p", "autostart:=false"], &[]);
    let graph = peer(7, &python, &["graph", "2", "rt/"]);
    let (_, lines) = graph.finish(LONG);
    let last = lines.last().unwrap();
    assert!(
        last.contains("rt/rosout") && !last.contains("rt/pose") && !last.contains("rt/echo"),
        "{last}"
    );
}

#[test]
fn simulated_time_drives_stamps_and_timers() {
    let Some(python) = python() else { return };
    let _node = minimal(8, &["--ros-args", "-p", "use_sim_time:=true", "-p", "beat:=2.0"], &[]);
    let beats = peer(8, &python, &["receive", "/minimal/beats", "pose", "3", "15"]);
    std::thread::sleep(Duration::from_millis(500));
    // 6 s of simulated time in 1.2 s.
    peer(8, &python, &["clock", "1000", "60"]).finish(LONG);
    let (_, lines) = beats.finish(LONG);
    assert_eq!(lines.len(), 3, "{lines:?}");
    for line in lines {
        assert!((1000.0..=1006.0).contains(&number(&line, "sec")), "{line}");
    }
}

#[test]
fn errors_of_the_command_line_name_the_mistake_and_the_remedy() {
    for (arguments, code, needle) in [
        (vec!["--bet", "3"], 2, "did you mean `beat`"),
        (vec!["stray"], 2, "stray"),
        (vec!["--ros-args", "-p", "bet:=1"], 2, "did you mean `beat`"),
        (vec!["--ros-args", "--bogus"], 2, "--bogus"),
        (vec!["--ros-args", "-r", "__node:=a b"], 2, "a b"),
        (vec!["--ros-args", "-p", "beat:=fast"], 2, "`beat` is a double"),
        (vec!["--beat", "5000"], 2, "between 0.1 and 1000 Hz"),
        (vec!["--rig", "/no/such/rig.yaml"], 1, "/no/such/rig.yaml"),
        (vec!["--help"], 0, "Beats per second."),
        (vec!["--version"], 0, concat!("minimal ", env!("CARGO_PKG_VERSION"))),
    ] {
        let output = Command::new(example("minimal_node"))
            .args(&arguments)
            .env("ROS_DOMAIN_ID", "9")
            .output()
            .unwrap();
        let output_text =
            String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {output_text}");
        assert!(output_text.contains(needle), "{arguments:?}: {output_text}");
        assert!(
            code == 0 || output_text.trim().lines().count() == 1,
            "{arguments:?}: {output_text}"
        );
    }
    let output =
        Command::new(example("minimal_node")).env("ROS_DOMAIN_ID", "300").output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("ROS_DOMAIN_ID=300"));
}
