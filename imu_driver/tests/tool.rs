//! Executable `volant-imu`.
#![cfg(feature = "cli")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

use imu_driver::protocol::{Configuration, LegacyFormat, Measurement, MessageId, frame};
use std::{
    path::PathBuf,
    process::{Command, Output},
};

fn volant_imu(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_volant-imu")).args(arguments).output().unwrap()
}

/// A separate folder for each test.
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
fn a_corrupted_legacy_log_is_decoded_and_its_losses_are_counted() {
    let folder = folder("damaged");
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let configuration =
        Configuration { format: LegacyFormat::STANDARD, ..Configuration::default() };
    let config = frame(MessageId::REQ_CONFIGURATION.ack(), &configuration.to_data());
    std::fs::write(path("configuration.bin"), config).unwrap();
    let mut log = Vec::new();
    for counter in 65_530..65_540_u32 {
        log.extend(legacy_message(counter as u16));
    }
    log[59 * 3 + 20] ^= 0x10;
    log.extend(&legacy_message(4)[..30]);
    std::fs::write(path("log.bin"), &log).unwrap();
    let (log, config, csv) = (path("log.bin"), path("configuration.bin"), path("out.csv"));
    let done = volant_imu(&["decode", &log, "--config", &config, "--csv", &csv]);
    assert!(done.status.success(), "{}", last_line(&done));
    assert_eq!(last_line(&done), "9 frames, 1 bad checksums, 89 skipped bytes");
    let table = std::fs::read_to_string(csv).unwrap();
    let rows: Vec<&str> = table.lines().collect();
    assert_eq!(rows.len(), 10);
    assert_eq!(rows[1], "65530,,0.5,-0.25,9.75,0.125,0,-1.5,1,0,0,0");
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn errors_are_one_line_with_file_and_remedy() {
    let folder = folder("cannot");
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    std::fs::write(path("empty.bin"), []).unwrap();
    std::fs::write(path("foreign.bin"), b"not a log of any IMU at all").unwrap();
    std::fs::write(path("legacy.bin"), legacy_message(1)).unwrap();
    std::fs::write(path("bad_config.bin"), [1, 2, 3]).unwrap();
    let csv = path("out.csv");
    let bad_config = path("bad_config.bin");
    let cases: [(&str, &[&str], &str); 5] = [
        ("missing.bin", &[], "missing.bin"),
        ("empty.bin", &[], "the log is empty"),
        ("foreign.bin", &[], "no valid frame"),
        ("legacy.bin", &[], "--config"),
        ("legacy.bin", &["--config", &bad_config], "bad_config.bin"),
    ];
    for (log, config, expected) in cases {
        let done = volant_imu(&[&["decode", &path(log), "--csv", &csv], config].concat());
        let text = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(1), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
        assert!(text.contains(expected), "{text}");
        assert!(!std::path::Path::new(&csv).exists());
    }
    for arguments in
        [vec!["info", "--port", "/nowhere/tty"], vec!["find", "--port", "/nowhere/tty"]]
    {
        let done = volant_imu(&arguments);
        assert_eq!(done.status.code(), Some(1));
    }
    // Before the baud rate of the IMU is changed.
    let line = ["configure", "--port", "/nowhere/tty", "--rate", "400", "--set-baud", "115200"];
    let done = volant_imu(&line);
    assert_eq!(done.status.code(), Some(1));
    assert!(last_line(&done).contains("236000 baud"), "{}", last_line(&done));
    for time in ["nan", "inf", "-1", "soon"] {
        for arguments in [
            ["info", "--port", "/nowhere/tty", "--timeout"],
            ["find", "--port", "/nowhere/tty", "--timeout"],
            ["log", "--port=/nowhere/tty", "--out=/nowhere/log.bin", "--duration"],
        ] {
            let done = volant_imu(&[&arguments[..], &[time]].concat());
            assert_eq!(done.status.code(), Some(2), "{arguments:?} {time}: {done:?}");
        }
    }
    assert_eq!(volant_imu(&["decode"]).status.code(), Some(2));
    assert_eq!(volant_imu(&["nonsense"]).status.code(), Some(2));
    std::fs::remove_dir_all(folder).unwrap();
}

#[cfg(feature = "simulated")]
#[test]
fn an_imu_is_found_configured_and_logged_and_the_log_decoded() {
    use imu_driver::simulated_imu::{SimulatedImuConfig, SimulatedSample, pty::PtyImu};
    let folder = folder("imu");
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    let tty = path("tty");
    let config = SimulatedImuConfig { baud: 57_600, ..SimulatedImuConfig::default() };
    let imu = PtyImu::start(config, &tty, Box::new(|_| SimulatedSample::stationary())).unwrap();
    let assert_prints = |arguments: &[&[&str]], texts: &[&str]| {
        let done = volant_imu(&arguments.concat());
        let printed = String::from_utf8_lossy(&done.stdout);
        let complete = texts.iter().all(|text| printed.contains(*text));
        assert!(done.status.success() && complete, "{arguments:?}: {done:?}");
    };
    let flash_writes = || imu.with(|u, _| u.flash_writes());
    assert_prints(&[&["find", "--port", &tty]], &["MTx-28A53G25", "57600 baud"]);
    assert_eq!(flash_writes(), Some(0));
    let faster = ["--baud", "57600", "--set-baud", "115200", "--rate", "50"];
    assert_prints(&[&["configure", "--port", &tty], &faster], &["50.000 Hz", "115200 baud"]);
    let line: &[&str] = &["--port", &tty, "--baud", "115200"];
    assert_prints(&[&["info"], line], &["mode 0006, settings 00000001"]);
    // Other outputs, then the standard ones again.
    let outputs =
        ["--rate", "100", "--temperature", "--status", "--no-magnetic-field", "--no-orientation"];
    assert_prints(&[&["configure"], line, &outputs], &["mode 0803, settings 00000041"]);
    let written = flash_writes();
    assert_prints(&[&["configure"], line, &outputs], &[]);
    assert_eq!(flash_writes(), written);
    assert_prints(&[&["configure"], line, &["--rate", "50"]], &[]);
    let (log, csv) = (path("log.bin"), path("log.csv"));
    assert_prints(&[&["log"], line, &["--out", &log, "--duration", "1"]], &[]);
    assert_prints(&[&["decode", &log, "--csv", &csv]], &[]);
    let rows = std::fs::read_to_string(csv).unwrap().lines().count();
    // Includes data of the stream before the configuration.
    assert!((50..90).contains(&rows), "{rows}");
    drop(imu);
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_log_is_never_replaced_by_its_table() {
    let folder = folder("files");
    let path = |name: &str| folder.join(name).to_str().unwrap().to_owned();
    std::fs::write(path("log.bin"), legacy_message(1)).unwrap();
    std::fs::hard_link(path("log.bin"), path("other.bin")).unwrap();
    for csv in ["log.bin", "other.bin"] {
        let refused = volant_imu(&["decode", &path("log.bin"), "--csv", &path(csv), "--overwrite"]);
        assert!(last_line(&refused).contains("the output is the input"), "{refused:?}");
    }
    assert_eq!(std::fs::read(path("log.bin")).unwrap(), legacy_message(1));
    std::fs::remove_dir_all(&folder).unwrap();
}
