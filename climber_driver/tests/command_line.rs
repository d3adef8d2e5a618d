//! A node's executable whose standard output is closed or full, and an argument that is not UTF-8.
//! All nodes share this code: `node_kit::run_node`.
#![cfg(feature = "node")]
#![allow(clippy::unwrap_used)]

use std::{
    ffi::OsStr,
    fs::File,
    os::unix::ffi::OsStrExt,
    process::{Command, Stdio},
};

fn node() -> Command {
    Command::new(env!("CARGO_BIN_EXE_climber_driver"))
}

#[test]
fn standard_output_that_is_closed_or_full_ends_help_without_a_panic() {
    for option in ["--help", "--print-parameters=yaml"] {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let closed = node().arg(option).stdout(writer).stderr(Stdio::piped()).output().unwrap();
        assert_eq!((closed.status.code(), closed.stderr.len()), (Some(141), 0), "{closed:?}");
        let full = File::options().write(true).open("/dev/full").unwrap();
        let full = node().arg(option).stdout(full).stderr(Stdio::piped()).output().unwrap();
        let message = String::from_utf8_lossy(&full.stderr);
        assert_eq!(full.status.code(), Some(1), "{message}");
        assert!(message.starts_with("climber_driver: standard output"), "{message}");
    }
}

#[test]
fn an_argument_that_is_not_utf_8_is_a_wrong_command_line() {
    let output = node().arg(OsStr::from_bytes(b"\xff")).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(message.contains("not UTF-8"), "{message}");
}

#[test]
fn the_height_must_be_given() {
    // The rig file's template without the driver's block.
    let template = include_str!("../../launch_config/config/rig.yaml");
    let (rig, _) = template.split_once("/**/climber_driver").unwrap();
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("rig.yaml");
    std::fs::write(&path, rig).unwrap();
    let output = node()
        .args(["--ros-args", "--params-file"])
        .arg(&path)
        .envs([("ROS_DOMAIN_ID", "99"), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")])
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("`height` must be given"), "{message}");
    assert!(message.contains("volant calibrate climber"), "{message}");
}
