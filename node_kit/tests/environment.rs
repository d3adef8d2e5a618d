//! Environment and options of a process: log file, console, and settings that have no effect.
#![allow(clippy::disallowed_methods, reason = "a test that waits")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod common;

use common::minimal;
use std::{path::Path, time::Duration};
use test_support::process::wait_until;

const LONG: Duration = Duration::from_secs(20);

/// Names and texts of the files of a folder.
fn files(folder: &Path) -> Vec<(String, String)> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    entries
        .map(|entry| {
            let entry = entry.unwrap();
            let text = std::fs::read_to_string(entry.path()).unwrap();
            (entry.file_name().into_string().unwrap(), text)
        })
        .collect()
}

#[test]
fn the_log_is_in_a_file_as_on_the_console() {
    let folder = tempfile::tempdir().unwrap();
    let logs = folder.path().join("logs");
    let profile = ("CYCLONEDDS_URI", "file:///etc/cyclone.xml");
    let environment = [("ROS_LOG_DIR", logs.to_str().unwrap()), profile];
    let mut node = minimal(57, &[], &environment);
    let line = node.line_with("CYCLONEDDS_URI is set", LONG);
    assert!(line.starts_with("[WARN] ["), "{line}");
    node.wait_for_signal_handler();
    node.signal("INT");
    assert!(node.wait(LONG).success());
    let written = files(&logs);
    let [(name, text)] = &written[..] else { panic!("{written:?}") };
    let prefix = format!("minimal_node_{}_", node.id());
    let milliseconds = name.strip_prefix(&prefix).and_then(|rest| rest.strip_suffix(".log"));
    assert!(
        milliseconds.is_some_and(|ms| ms.parse::<u64>().unwrap() > 1_700_000_000_000),
        "{name}"
    );
    assert!(text.lines().any(|l| l == line), "{text}");
}

#[test]
fn the_console_and_the_file_can_be_turned_off() {
    let folder = tempfile::tempdir().unwrap();
    // Logged before and while the process joins the domain.
    let environment = [
        ("ROS_LOG_DIR", folder.path().to_str().unwrap()),
        ("CYCLONEDDS_URI", "file:///x"),
        ("NOTIFY_SOCKET", "/nowhere/socket"),
    ];
    let early = ["CYCLONEDDS_URI", "NOTIFY_SOCKET"];
    let quiet = ["--ros-args", "--disable-stdout-logs", "--log-file-name", "mine"];
    let node = minimal(58, &quiet, &environment);
    let logged = |word| files(folder.path()).iter().any(|(_, text)| text.contains(word));
    assert!(wait_until(LONG, || early.into_iter().all(logged)));
    assert!(files(folder.path()).iter().all(|(name, _)| name.starts_with("mine_")));
    node.signal("INT");
    let (_, lines) = node.finish(LONG);
    assert!(!lines.iter().any(|line| early.iter().any(|word| line.contains(word))), "{lines:?}");

    let folder = tempfile::tempdir().unwrap();
    let environment =
        [("ROS_LOG_DIR", folder.path().to_str().unwrap()), ("CYCLONEDDS_URI", "file:///x")];
    let node = minimal(59, &["--ros-args", "--disable-external-lib-logs"], &environment);
    node.line_with("CYCLONEDDS_URI", LONG);
    assert_eq!(files(folder.path()), []);
}

#[test]
fn a_folder_that_cannot_be_written_is_named_and_the_node_runs() {
    let node = minimal(60, &[], &[("ROS_LOG_DIR", "/proc/none")]);
    let line = node.line_with("no log file", LONG);
    assert!(line.contains("/proc/none") && line.contains("ROS_LOG_DIR"), "{line}");
}

#[test]
fn parameters_of_other_nodes_in_a_shared_file_are_ignored_with_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("robot.yaml");
    let shared = "/**: {ros__parameters: {robot_description: x, use_sim_tim: false}}\n";
    std::fs::write(&file, shared).unwrap();
    let arguments = ["--ros-args", "--params-file", file.to_str().unwrap()];
    let node = minimal(61, &arguments, &[]);
    let line = node.line_with("robot_description", LONG);
    assert!(line.contains("[WARN]") && line.contains("robot.yaml"), "{line}");
    let line = node.line_with("use_sim_tim", LONG);
    assert!(line.contains("[WARN]") && line.contains("use_sim_time"), "{line}");
    drop(node);
    for (text, word) in [
        ("minimal: {ros__parameters: {robot_description: x}}\n", "robot_description"),
        ("/rig*/minimal: {ros__parameters: {use_sim_time: true}}\n", "/rig*/minimal"),
    ] {
        std::fs::write(&file, text).unwrap();
        let (status, lines) = minimal(61, &arguments, &[]).finish(LONG);
        assert_eq!(status.code(), Some(1), "{text}: {lines:?}");
        assert!(lines.iter().any(|line| line.contains(word)), "{text}: {lines:?}");
    }
}

#[test]
fn endpoints_whose_quality_of_service_differs_are_named_at_both_ends() {
    let best_effort = "qos_overrides./loop.publisher.reliability:=best_effort";
    let to = ["--ros-args", "-r", "__node:=a", "-r", "~/beats:=/loop", "-p", best_effort];
    let from = ["--ros-args", "-r", "__node:=b", "-r", "pose:=/loop"];
    let nodes = [minimal(62, &to, &[]), minimal(62, &from, &[])];
    for (node, end) in nodes.iter().zip(["publisher", "subscription"]) {
        let line = node.line_with(&format!("the {end} of /loop here"), LONG);
        assert!(line.contains(&format!("qos_overrides./loop.{end}.reliability")), "{line}");
    }
}

#[test]
fn a_node_without_a_simulated_clock_logs_that_it_waits_for_it() {
    let node = minimal(63, &["--ros-args", "-p", "use_sim_time:=true"], &[]);
    let line = node.line_with("use_sim_time is set", LONG);
    assert!(line.contains("/clock") && line.contains("volant play --clock"), "{line}");
}
