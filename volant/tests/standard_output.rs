//! Executables whose standard output is closed or full, and arguments that are not UTF-8.
#![allow(clippy::unwrap_used)]

mod place;

use bag::{BagWriter, Qos, WriteOptions};
use place::{Place, put};
use rig_model::topics::absolute::{GROUND_TRUTH, ODOMETRY};
use std::{ffi::OsStr, fs::File, os::unix::ffi::OsStrExt, path::Path, process::Stdio};
use volant_msgs::nav_msgs::msg::Odometry;

/// Writes three seconds of an odometry and the truth that it equals.
fn write_run(path: &Path) {
    let mut bag = BagWriter::create(path, WriteOptions::default()).unwrap();
    for k in 0..300_u32 {
        let mut message = Odometry::default();
        (message.header.stamp.sec, message.header.stamp.nanosec) =
            (1 + (k / 100) as i32, k % 100 * 10_000_000);
        message.pose.pose.orientation.w = 1.0;
        for i in 0..6 {
            message.pose.covariance[7 * i] = 1e-6;
        }
        for topic in [ODOMETRY, GROUND_TRUTH] {
            let at = 1_000_000_000 + u64::from(k) * 10_000_000;
            put(&mut bag, topic, &Qos::RELIABLE, at, &message);
        }
    }
    bag.finish().unwrap();
}

#[test]
fn standard_output_that_is_closed_or_full_ends_a_command_without_a_panic() {
    let place = Place::new();
    write_run(&place.path("run.mcap"));
    for arguments in [
        "bag info run.mcap",
        "--help",
        "--version",
        "replay --help",
        "calibrate colors --help",
        "evaluate run.mcap --truth run.mcap --csv run.csv --overwrite",
        "up --help",
    ] {
        let to = |output: Stdio| place.command(arguments).stdout(output).output().unwrap();
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let closed = to(writer.into());
        assert_eq!(closed.status.code(), Some(141), "{arguments}: {closed:?}");
        assert_eq!(String::from_utf8_lossy(&closed.stderr), "", "{arguments}");
        let full = to(File::options().write(true).open("/dev/full").unwrap().into());
        assert_eq!(full.status.code(), Some(1), "{arguments}: {full:?}");
        let message = String::from_utf8_lossy(&full.stderr);
        assert!(message.contains("standard output"), "{arguments}: {message}");
        assert_eq!(message.lines().count(), 1, "{arguments}: {message}");
    }
    let written = place.path("run.csv").is_file();
    assert!(written, "the files are written although the table could not be printed");
}

#[test]
fn an_argument_that_is_not_utf_8_is_a_wrong_command_line() {
    let place = Place::new();
    for arguments in [
        "",
        "evaluate x --truth x --skip",
        "replay x --namespace",
        "calibrate colors",
        "up",
        "record --out x",
    ] {
        let mut command = place.command(arguments);
        let output = command.arg(OsStr::from_bytes(b"\xff\xfe")).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments}: {output:?}");
        assert!(!output.stderr.is_empty() && output.stdout.is_empty(), "{arguments}: {output:?}");
    }
}
