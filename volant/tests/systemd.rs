//! systemd's units: `systemd-analyze verify` accepts them, and the options that they give exist.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

const NODES: [&str; 4] = ["marker_tracker", "imu_driver", "climber_driver", "pose_fusion"];

fn units() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch_config/systemd")
}

/// A unit with this build's executable in place of the installed one.
fn unit(name: &str) -> String {
    let text = fs::read_to_string(units().join(name)).unwrap();
    assert!(name.ends_with("target") || text.contains("/usr/local/bin/volant "), "{name}");
    text.replace("/usr/local/bin/volant ", &format!("{} ", env!("CARGO_BIN_EXE_volant")))
}

/// What `systemd-analyze verify` prints about units in `folder`; `None` without systemd.
fn verify(folder: &Path, names: &[String]) -> Option<(bool, String)> {
    let mut command = Command::new("systemd-analyze");
    command.arg("verify").args(names.iter().map(|name| folder.join(name)));
    match command.output() {
        Ok(output) => {
            let text = String::from_utf8_lossy(&output.stderr).into_owned();
            // Units of the machine itself are none of this test's.
            let ours = text.lines().filter(|line| line.contains("volant"));
            Some((output.status.success(), ours.map(|line| format!("{line}\n")).collect()))
        }
        Err(_) => {
            test_support::skip("systemd-analyze is missing; install systemd");
            None
        }
    }
}

#[test]
fn the_units_are_valid() {
    let folder = tempfile::tempdir().unwrap();
    let mut names = vec!["volant.target".to_owned(), "volant-record.service".to_owned()];
    for name in &names {
        fs::write(folder.path().join(name), unit(name)).unwrap();
    }
    for node in NODES {
        let name = format!("volant@{node}.service");
        fs::write(folder.path().join(&name), unit("volant@.service")).unwrap();
        names.push(name);
    }
    let Some((valid, text)) = verify(folder.path(), &names) else { return };
    assert!(valid && text.is_empty(), "{text}");
    // A mistake is found.
    let broken = "volant@broken.service".to_owned();
    let text = unit("volant@.service").replace("WatchdogSec=5", "WatchdogSec=often");
    fs::write(folder.path().join(&broken), text).unwrap();
    let (_, text) = verify(folder.path(), &[broken]).unwrap();
    assert!(text.contains("often"), "{text}");
}

/// The words of a unit's `ExecStart` after the program, without variables.
fn words(name: &str) -> Vec<String> {
    let text = unit(name);
    let line = text.lines().find_map(|line| line.strip_prefix("ExecStart=")).unwrap();
    line.split_whitespace().skip(1).filter(|w| !w.starts_with('$')).map(str::to_owned).collect()
}

#[test]
fn the_units_commands_exist() {
    let run = |words: &[String]| {
        let output = Command::new(env!("CARGO_BIN_EXE_volant"))
            .args(words)
            .env("ROS_DOMAIN_ID", "161")
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            .output()
            .unwrap();
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    // The rig file is not there: exit status 1. A mistake on the command line would be 2.
    for node in NODES {
        let words: Vec<String> = words("volant@.service")
            .iter()
            .map(|w| w.replace("%i", node).replace("/etc/volant", "/no/such/folder"))
            .collect();
        let (status, error) = run(&words);
        assert_eq!(status, Some(1), "{error}");
        assert!(error.contains("/no/such/folder/rig.yaml"), "{error}");
    }
    let folder = tempfile::tempdir().unwrap();
    let mut words = words("volant-record.service");
    let state = words.iter_mut().find(|w| *w == "/var/lib/volant").unwrap();
    *state = folder.path().to_str().unwrap().to_owned();
    words.extend(["--duration", "0.5"].map(str::to_owned));
    let (status, error) = run(&words);
    assert_eq!(status, Some(0), "{error}");
    let bag = fs::read_dir(folder.path()).unwrap().next().unwrap().unwrap();
    assert!(bag.file_name().to_str().unwrap().starts_with("volant_20"), "{bag:?}");
    assert!(bag.path().join("metadata.yaml").is_file());
}
