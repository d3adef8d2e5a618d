//! Executables whose standard output is closed or full, and arguments that are not UTF-8.
#![allow(clippy::unwrap_used)]

use bag::{BagWriter, Qos, Topic, WriteOptions};
use rig_model::topics::absolute::{GROUND_TRUTH, ODOMETRY};
use std::{
    ffi::OsStr,
    fs::File,
    os::unix::ffi::OsStrExt,
    path::Path,
    process::{Command, Output, Stdio},
};
use volant_msgs::nav_msgs::msg::Odometry;

/// Runs `volant` with its standard output closed by the reader.
fn without_reader(arguments: &[&OsStr]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_volant"));
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    command.args(arguments).stdout(writer).stderr(Stdio::piped()).output().unwrap()
}

/// Runs `volant` with its standard output on a full disk.
fn on_full_disk(arguments: &[&OsStr]) -> Output {
    let full = File::options().write(true).open("/dev/full").unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_volant"));
    command.args(arguments).stdout(full).stderr(Stdio::piped()).output().unwrap()
}

/// Writes three seconds of an odometry and the truth that it equals.
fn write_run(path: &Path) {
    let mut bag = BagWriter::create(path, WriteOptions::default()).unwrap();
    let topics = [ODOMETRY, GROUND_TRUTH]
        .map(|name| bag.add_topic(Topic::of::<Odometry>(name, &Qos::RELIABLE)));
    for k in 0..300_u32 {
        let mut message = Odometry::default();
        (message.header.stamp.sec, message.header.stamp.nanosec) =
            (1 + (k / 100) as i32, k % 100 * 10_000_000);
        message.pose.pose.orientation.w = 1.0;
        for i in 0..6 {
            message.pose.covariance[7 * i] = 1e-6;
        }
        for topic in topics {
            bag.write_message(topic, 1_000_000_000 + u64::from(k) * 10_000_000, &message).unwrap();
        }
    }
    bag.finish().unwrap();
}

#[test]
fn standard_output_that_is_closed_or_full_ends_a_command_without_a_panic() {
    let folder = tempfile::tempdir().unwrap();
    let (run, csv) = (folder.path().join("run.mcap"), folder.path().join("run.csv"));
    write_run(&run);
    let commands: Vec<Vec<&OsStr>> = vec![
        vec!["bag".as_ref(), "info".as_ref(), run.as_ref()],
        vec!["--help".as_ref()],
        vec!["--version".as_ref()],
        vec!["replay".as_ref(), "--help".as_ref()],
        vec!["calibrate".as_ref(), "colors".as_ref(), "--help".as_ref()],
        vec![
            "evaluate".as_ref(),
            run.as_ref(),
            "--truth".as_ref(),
            run.as_ref(),
            "--csv".as_ref(),
            csv.as_ref(),
            "--overwrite".as_ref(),
        ],
        vec!["up".as_ref(), "--help".as_ref()],
    ];
    for command in commands {
        let closed = without_reader(&command);
        assert_eq!(closed.status.code(), Some(141), "{command:?}: {closed:?}");
        assert_eq!(String::from_utf8_lossy(&closed.stderr), "", "{command:?}");
        let full = on_full_disk(&command);
        assert_eq!(full.status.code(), Some(1), "{command:?}: {full:?}");
        let message = String::from_utf8_lossy(&full.stderr);
        assert!(message.contains("standard output"), "{command:?}: {message}");
        assert_eq!(message.lines().count(), 1, "{command:?}: {message}");
    }
    assert!(csv.is_file(), "the files are written although the table could not be printed");
}

#[test]
fn an_argument_that_is_not_utf_8_is_a_wrong_command_line() {
    let odd = OsStr::from_bytes(b"\xff\xfe");
    let commands: Vec<Vec<&OsStr>> = vec![
        vec![odd],
        vec![
            "evaluate".as_ref(),
            "x".as_ref(),
            "--truth".as_ref(),
            "x".as_ref(),
            "--skip".as_ref(),
            odd,
        ],
        vec!["replay".as_ref(), "x".as_ref(), "--namespace".as_ref(), odd],
        vec!["calibrate".as_ref(), "colors".as_ref(), odd],
        vec!["up".as_ref(), odd],
        vec!["record".as_ref(), "--out".as_ref(), "x".as_ref(), odd],
    ];
    for command in commands {
        let output = Command::new(env!("CARGO_BIN_EXE_volant")).args(&command).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{command:?}: {output:?}");
        assert!(!output.stderr.is_empty() && output.stdout.is_empty(), "{command:?}: {output:?}");
    }
}
