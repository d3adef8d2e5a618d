//! Executable `volant-imu`.
#![cfg(feature = "cli")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

use imu_driver::protocol::{Configuration, LegacyFormat, Measurement, MessageId, frame};
use std::process::Command;
use test_support::place::{Place, Ran};

fn volant_imu(arguments: &[&str]) -> Ran {
    Command::new(env!("CARGO_BIN_EXE_volant-imu")).args(arguments).output().unwrap().into()
}

fn last_line(ran: &Ran) -> &str {
    ran.err.lines().last().unwrap_or_default()
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
    let place = Place::new();
    let path = |name: &str| place.path(name).to_str().unwrap().to_owned();
    let configuration =
        Configuration { format: LegacyFormat::STANDARD, ..Configuration::default() };
    let config = frame(MessageId::REQ_CONFIGURATION.ack(), &configuration.to_data());
    place.write("configuration.bin", config);
    let mut log = Vec::new();
    for counter in 65_530..65_540_u32 {
        log.extend(legacy_message(counter as u16));
    }
    log[59 * 3 + 20] ^= 0x10;
    log.extend(&legacy_message(4)[..30]);
    place.write("log.bin", &log);
    let (log, config, csv) = (path("log.bin"), path("configuration.bin"), path("out.csv"));
    let done = volant_imu(&["decode", &log, "--config", &config, "--csv", &csv]);
    assert_eq!(done.status, Some(0), "{}", done.err);
    assert_eq!(last_line(&done), "9 frames, 1 bad checksums, 89 skipped bytes");
    let table = place.text("out.csv");
    let rows: Vec<&str> = table.lines().collect();
    assert_eq!(rows.len(), 10);
    assert_eq!(rows[1], "65530,,0.5,-0.25,9.75,0.125,0,-1.5,1,0,0,0");
}

#[test]
fn errors_are_one_line_with_file_and_remedy() {
    let place = Place::new();
    let path = |name: &str| place.path(name).to_str().unwrap().to_owned();
    place.write("empty.bin", []);
    place.write("foreign.bin", b"not a log of any IMU at all");
    place.write("legacy.bin", legacy_message(1));
    place.write("bad_config.bin", [1, 2, 3]);
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
        done.failed_with(&[expected]);
        assert!(!place.path("out.csv").exists());
    }
    for arguments in
        [vec!["info", "--port", "/nowhere/tty"], vec!["find", "--port", "/nowhere/tty"]]
    {
        assert_eq!(volant_imu(&arguments).status, Some(1));
    }
    // Nothing is left that would keep another attempt from using the name.
    let log = path("port.bin");
    for _ in 0..2 {
        volant_imu(&["log", "--port", "/nowhere/tty", "--out", &log])
            .failed_with(&["/nowhere/tty"]);
    }
    // Before the baud rate of the IMU is changed.
    let line = ["configure", "--port", "/nowhere/tty", "--rate", "400", "--set-baud", "115200"];
    let done = volant_imu(&line);
    assert_eq!(done.status, Some(1));
    assert!(last_line(&done).contains("236000 baud"), "{}", done.err);
    for time in ["nan", "inf", "-1", "soon"] {
        for arguments in [
            ["info", "--port", "/nowhere/tty", "--timeout"],
            ["find", "--port", "/nowhere/tty", "--timeout"],
            ["log", "--port=/nowhere/tty", "--out=/nowhere/log.bin", "--duration"],
        ] {
            let done = volant_imu(&[&arguments[..], &[time]].concat());
            assert_eq!(done.status, Some(2), "{arguments:?} {time}: {}", done.err);
        }
    }
    assert_eq!(volant_imu(&["decode"]).status, Some(2));
    assert_eq!(volant_imu(&["nonsense"]).status, Some(2));
}

#[cfg(feature = "simulated")]
#[test]
fn an_imu_is_found_configured_and_logged_and_the_log_decoded() {
    use imu_driver::simulated_imu::{SimulatedImuConfig, SimulatedSample, pty::PtyImu};
    let place = Place::new();
    let path = |name: &str| place.path(name).to_str().unwrap().to_owned();
    let tty = path("tty");
    let config = SimulatedImuConfig { baud: 57_600, ..SimulatedImuConfig::default() };
    let imu = PtyImu::start(config, &tty, Box::new(|_| SimulatedSample::stationary())).unwrap();
    let assert_prints = |arguments: &[&[&str]], texts: &[&str]| {
        let done = volant_imu(&arguments.concat());
        let complete = texts.iter().all(|text| done.out.contains(*text));
        let printed = done.out + &done.err;
        assert!(done.status == Some(0) && complete, "{arguments:?}: {printed}");
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
    let rows = place.text("log.csv").lines().count();
    // Includes data of the stream before the configuration.
    assert!((50..90).contains(&rows), "{rows}");
}

#[test]
fn a_log_is_never_replaced_by_its_table() {
    let place = Place::new();
    let path = |name: &str| place.path(name).to_str().unwrap().to_owned();
    place.write("log.bin", legacy_message(1));
    std::fs::hard_link(path("log.bin"), path("other.bin")).unwrap();
    for csv in ["log.bin", "other.bin"] {
        let refused = volant_imu(&["decode", &path("log.bin"), "--csv", &path(csv), "--overwrite"]);
        assert!(last_line(&refused).contains("the output is the input"), "{}", refused.err);
    }
    assert_eq!(place.read("log.bin"), legacy_message(1));
}
