//! Devices with unusual settings: rates, lines and clocks.

use crate::bench::Bench;
use imu_driver::{
    driver::{DriverConfig, Event},
    protocol::{DeviceError, MessageId, OutputEntry, OutputMode, message::baud_code},
    simulated_imu::SimulatedImuConfig,
};

#[test]
fn an_mti_100_with_legacy_messages_has_the_rate_of_its_configuration() {
    let imu = SimulatedImuConfig {
        outputs: Some(vec![]),
        product_code: "MTi-100".into(),
        format: DriverConfig::default().legacy_format(),
        baud: 460_800,
        period: 288,
        ..SimulatedImuConfig::default()
    };
    let driver = DriverConfig { leave_settings: true, baud: 460_800, ..DriverConfig::default() };
    let mut bench = Bench::after(12.0, driver, imu);
    assert_eq!(bench.driver.identity().outputs, Some(vec![]), "{:?}", bench.events);
    assert!((bench.driver.statistics().rate - 400.0).abs() < 1e-9);
    assert_eq!(bench.imu.flash_writes(), 0);
    assert!(bench.samples.len() > 4000, "{}", bench.samples.len());
    bench.check_truth(0.3e-3);
}

#[test]
fn settings_that_the_line_found_cannot_carry_are_not_written() {
    let driver = DriverConfig { baud: 0, rate: 400.0, ..DriverConfig::default() };
    let bench = Bench::after(8.0, driver.clone(), SimulatedImuConfig::default());
    assert_eq!(bench.imu.flash_writes(), 0, "{:?}", bench.events);
    assert!(!bench.driver.is_measuring());
    let is_slow = |e: &&Event| matches!(e, Event::LineTooSlow(_));
    let reports: Vec<_> = bench.events.iter().filter(is_slow).map(Event::to_string).collect();
    assert!(matches!(&reports[..], [text] if text.contains("the line has 115200")), "{reports:?}");
    // The messages of an MTi-100 are longer: 81 bytes instead of 59.
    let modern = SimulatedImuConfig {
        outputs: Some(vec![OutputEntry { id: 0x2010, rate: 100 }]),
        ..SimulatedImuConfig::default()
    };
    let faster = DriverConfig { rate: 150.0, ..DriverConfig::default() };
    let other = Bench::after(3.0, faster.clone(), modern.clone());
    let slow = other.events.iter().find(is_slow).unwrap().to_string();
    assert!(slow.contains("121500 baud") && other.imu.flash_writes() == 0, "{slow}");
    // Nor is the baud rate written at which the line could not carry them.
    let fast = SimulatedImuConfig { baud: 460_800, ..modern.clone() };
    let set = DriverConfig { baud: 460_800, set_baud: baud_code(115_200), ..faster.clone() };
    let other = Bench::after(3.0, set, fast);
    let slow = other.events.iter().find(is_slow).unwrap().to_string();
    assert!(slow.contains("the line has 115200") && other.imu.flash_writes() == 0, "{slow}");
    // Nor does the device begin to send them.
    let leave = DriverConfig { leave_settings: true, ..DriverConfig::default() };
    let other =
        Bench::after(3.0, leave, SimulatedImuConfig { outputs: Some(faster.outputs()), ..modern });
    assert!(!other.driver.is_measuring(), "{:?}", other.events);
    // The device is called again, at the baud rate at which it answers.
    assert!(bench.bauds.is_empty(), "{:?}", bench.bauds);
    // A line that carries them.
    let imu = SimulatedImuConfig { baud: 460_800, ..SimulatedImuConfig::default() };
    let bench = Bench::after(4.0, driver, imu);
    assert!(bench.driver.is_measuring(), "{:?}", bench.events);
}

#[test]
fn a_device_that_sends_but_does_not_answer_is_no_wrong_baud_rate() {
    // The last baud rates of the search yield garbage only.
    for baud in [0, 115_200] {
        let driver = DriverConfig { baud, ..DriverConfig::default() };
        let imu = SimulatedImuConfig { needs_two_stop_bits: true, ..SimulatedImuConfig::default() };
        let bench = Bench::after(12.0, driver, imu);
        let event = bench.events.iter().find(|e| matches!(e, Event::NoAnswer { .. })).unwrap();
        let text = event.to_string();
        assert!(text.contains("valid messages at 115200 baud"), "{text}");
        assert!(text.contains("set two_stop_bits: true"), "{text}");
    }
}

#[test]
fn a_device_that_sends_on_request_only_is_named_once() {
    let imu = SimulatedImuConfig { skip: u16::MAX, ..SimulatedImuConfig::default() };
    let driver = DriverConfig { leave_settings: true, ..DriverConfig::default() };
    let bench = Bench::after(10.0, driver, imu.clone());
    assert!(bench.samples.is_empty());
    assert!(!bench.has(|e| matches!(e, Event::Silent(_))), "{:?}", bench.events);
    let named = bench.events.iter().filter(|e| **e == Event::OnRequestOnly).count();
    assert_eq!(named, 1, "{:?}", bench.events);
    // The driver sets the skip factor.
    let bench = Bench::after(3.0, DriverConfig::default(), imu);
    assert!(bench.samples.len() > 150, "{:?}", bench.events);
    assert!(!bench.has(|e| *e == Event::OnRequestOnly));
}

#[test]
fn messages_without_inertial_data_are_reported_after_every_connection() {
    let mut imu = SimulatedImuConfig::default();
    imu.format.mode = OutputMode::ORIENTATION;
    let driver = DriverConfig { leave_settings: true, ..DriverConfig::default() };
    let mut bench = Bench::after(3.0, driver, imu);
    bench.replug(0.2, 3.0);
    let reports = bench.events.iter().filter(|e| **e == Event::NoInertialData).count();
    assert_eq!(reports, 2, "{:?}", bench.events);
}

#[test]
fn rejected_requests_are_repeated_after_growing_pauses() {
    // Error 0x29: the baud rate is too low for the data.
    let driver = DriverConfig { leave_settings: true, ..DriverConfig::default() };
    let imu = SimulatedImuConfig { period: 288, ..SimulatedImuConfig::default() };
    let bench = Bench::after(30.0, driver, imu);
    let event = Event::Rejected { what: MessageId::GO_TO_MEASUREMENT, error: DeviceError(0x29) };
    let rejected = bench.events.iter().filter(|e| **e == event).count();
    assert!((20..35).contains(&rejected), "{rejected}");
    assert_eq!(bench.imu.flash_writes(), 0);
}

#[test]
fn a_drift_beyond_the_limit_is_reported() {
    for (ppm, exceeded) in [(-400.0, true), (400.0, true), (-100.0, false), (100.0, false)] {
        let imu = SimulatedImuConfig { clock_ppm: ppm, ..SimulatedImuConfig::default() };
        let mut bench = Bench::new(DriverConfig::default(), imu);
        bench.host.lateness = 1e-3;
        bench.run(40.0);
        let is_drift = |e: &&Event| matches!(e, Event::DriftExceeded);
        let reports = bench.events.iter().filter(is_drift).count();
        assert_eq!(bench.driver.statistics().drift_exceeded, exceeded, "{ppm}");
        assert!(if exceeded { (2..5).contains(&reports) } else { reports == 0 }, "{reports}");
    }
}

/// The bytes that were skipped before the search are no garbage of the search.
#[test]
fn a_device_that_falls_silent_after_its_start_is_no_wrong_baud_rate() {
    let mut bench = Bench::after(3.0, DriverConfig::default(), SimulatedImuConfig::default());
    bench.imu.inject(&[1], bench.now);
    bench.run(0.5);
    bench.imu.power_cycle(bench.now);
    while !bench.has(|e| *e == Event::WokeUp) {
        bench.run(0.001);
    }
    bench.imu.set_mute(true);
    bench.run(6.0);
    assert!(bench.has(|e| matches!(e, Event::NoAnswer { garbage: false, .. })));
}
