//! `volant imu` as a person starts it.
#![cfg(feature = "cli")]
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

use imu_driver::protocol::{Configuration, LegacyFormat, Measurement, MessageId, frame};
use std::{
    path::PathBuf,
    process::{Command, Output},
};

fn volant_imu(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_volant-imu")).args(arguments).output().unwrap()
}

/// A folder of its own for each test.
fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("volant-imu-{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

fn last_line(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).lines().last().unwrap_or_default().to_owned()
}

fn legacy_message(counter: u16) -> Vec<u8> {
    let mut data = Vec::new();
    let m = Measurement {
        counter: Some(counter),
        acceleration: Some([0.5, -0.25, 9.75]),
        angular_velocity: Some([0.125, 0.0, -1.5]),
        ..Measurement::default()
    };
    LegacyFormat::STANDARD.encode(&m, &mut data);
    frame(MessageId::MT_DATA, &data)
}

#[test]
fn a_damaged_legacy_log_becomes_a_table_and_the_loss_is_said() {
    let folder = folder("damaged");
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let configuration = Configuration { format: LegacyFormat::STANDARD, ..Configuration::default() };
    let config = frame(MessageId::REQ_CONFIGURATION.ack(), &configuration.to_data());
    std::fs::write(path("configuration.bin"), config).unwrap();
    let mut log = Vec::new();
    for counter in 65_530..65_540_u32 {
        log.extend(legacy_message(counter as u16));
    }
    log[59 * 3 + 20] ^= 0x10;
    log.extend(&legacy_message(4)[..30]);
    std::fs::write(path("log.bin"), &log).unwrap();
    let done = volant_imu(&[
        "decode",
        &path("log.bin"),
        "--config",
        &path("configuration.bin"),
        "--csv",
        &path("out.csv"),
    ]);
    assert!(done.status.success(), "{}", last_line(&done));
    assert_eq!(last_line(&done), "9 frames, 1 bad checksums, 89 skipped bytes");
    let table = std::fs::read_to_string(path("out.csv")).unwrap();
    let rows: Vec<&str> = table.lines().collect();
    assert_eq!(rows.len(), 10);
    assert_eq!(rows[1], "65530,,0.5,-0.25,9.75,0.125,0,-1.5,1,0,0,0");
    let played = volant_imu(&[
        "playback",
        &path("log.bin"),
        "--config",
        &path("configuration.bin"),
        "--csv",
        &path("played.csv"),
    ]);
    assert!(played.status.success(), "{}", last_line(&played));
    assert_eq!(last_line(&played), "9 messages, 9 samples, 1 lost, 0 unreadable");
    assert_eq!(std::fs::read_to_string(path("played.csv")).unwrap().lines().count(), 10);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn what_cannot_be_ends_with_one_line_that_says_why() {
    let folder = folder("cannot");
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    std::fs::write(path("empty.bin"), []).unwrap();
    std::fs::write(path("foreign.bin"), b"not a log of any unit at all").unwrap();
    std::fs::write(path("legacy.bin"), legacy_message(1)).unwrap();
    std::fs::write(path("bad_config.bin"), [1, 2, 3]).unwrap();
    let csv = path("out.csv");
    for (arguments, expected) in [
        (vec!["decode".to_owned(), path("missing.bin")], "missing.bin"),
        (vec!["decode".to_owned(), path("empty.bin")], "empty"),
        (vec!["decode".to_owned(), path("foreign.bin")], "whole frame"),
        (vec!["decode".to_owned(), path("legacy.bin")], "--config"),
        (
            vec!["decode".to_owned(), path("legacy.bin"), "--config".into(), path("bad_config.bin")],
            "bad_config.bin",
        ),
    ] {
        let mut all: Vec<&str> = arguments.iter().map(String::as_str).collect();
        all.extend(["--csv", &csv]);
        let done = volant_imu(&all);
        let text = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(1), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
        assert!(text.contains(expected), "{text}");
        assert!(!std::path::Path::new(&csv).exists());
    }
    for arguments in [vec!["info", "--port", "/nowhere/tty"], vec!["find", "--port", "/nowhere/tty"]] {
        let done = volant_imu(&arguments);
        assert_eq!(done.status.code(), Some(1));
    }
    assert_eq!(volant_imu(&["decode"]).status.code(), Some(2));
    assert_eq!(volant_imu(&["nonsense"]).status.code(), Some(2));
    std::fs::remove_dir_all(folder).unwrap();
}

#[cfg(feature = "fake")]
#[test]
fn a_unit_on_a_port_is_found_set_logged_and_its_log_decoded() {
    use imu_driver::fake_unit::{FakeSample, FakeUnitConfig, pty::PtyUnit};
    let folder = folder("unit");
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let tty = path("tty");
    let config = FakeUnitConfig { baud: 57_600, ..FakeUnitConfig::default() };
    let unit = PtyUnit::start(config, &tty, Box::new(|_| FakeSample::at_rest())).unwrap();
    let found = volant_imu(&["find", "--port", &tty]);
    let text = String::from_utf8_lossy(&found.stdout).into_owned();
    assert!(found.status.success() && text.contains("MTx-28A53G25") && text.contains("57600 baud"), "{text}");
    assert_eq!(unit.with(|u, _| u.flash_writes()), Some(0));
    let set =
        volant_imu(&["configure", "--port", &tty, "--baud", "57600", "--set-baud", "115200", "--rate", "50"]);
    let text = String::from_utf8_lossy(&set.stdout).into_owned();
    assert!(
        set.status.success() && text.contains("50.000 Hz") && text.contains("115200 baud"),
        "{text} {set:?}"
    );
    let info = volant_imu(&["info", "--port", &tty, "--baud", "115200"]);
    let text = String::from_utf8_lossy(&info.stdout).into_owned();
    assert!(text.contains("mode 0006, settings 00000001"), "{text}");
    // Other outputs, and the standard ones again.
    let line = ["--port", &tty, "--baud", "115200"];
    let outputs = ["--rate", "100", "--temperature", "--status", "--no-magnetic-field", "--no-orientation"];
    let set = volant_imu(&[&["configure"], &line[..], &outputs].concat());
    let text = String::from_utf8_lossy(&set.stdout).into_owned();
    assert!(set.status.success() && text.contains("mode 0803, settings 00000041"), "{text} {set:?}");
    let written = unit.with(|u, _| u.flash_writes());
    let again = volant_imu(&[&["configure"], &line[..], &outputs].concat());
    assert!(again.status.success() && unit.with(|u, _| u.flash_writes()) == written, "{again:?}");
    let set = volant_imu(&[&["configure"], &line[..], &["--rate", "50"]].concat());
    assert!(set.status.success(), "{set:?}");
    let log = volant_imu(&[
        "log",
        "--port",
        &tty,
        "--baud",
        "115200",
        "--out",
        &path("log.bin"),
        "--duration",
        "1",
    ]);
    assert!(log.status.success(), "{log:?}");
    let decoded = volant_imu(&["decode", &path("log.bin"), "--csv", &path("log.csv")]);
    assert!(decoded.status.success(), "{decoded:?}");
    let rows = std::fs::read_to_string(path("log.csv")).unwrap().lines().count();
    // The stream that was under way is in it too.
    assert!((50..90).contains(&rows), "{rows}");
    let played = volant_imu(&["playback", &path("log.bin"), "--csv", &path("played.csv")]);
    assert!(played.status.success(), "{played:?}");
    assert!(last_line(&played).contains("0 lost, 0 unreadable"), "{played:?}");
    drop(unit);
    std::fs::remove_dir_all(folder).unwrap();
}
