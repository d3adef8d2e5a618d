//! Driver and simulated IMU on simulated time, without port, clock or thread.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod bench;
mod devices;

use bench::{Bench, rms_and_worst};
use imu_driver::{
    driver::{DriverConfig, Event},
    protocol::{MessageId, NumberFormat, OutputEntry, OutputSettings, Status, frame},
    simulated_imu::SimulatedImuConfig,
};

#[test]
fn factory_settings_are_changed_once_and_the_flash_is_not_written_again() {
    let mut bench = Bench::after(2.0, DriverConfig::default(), SimulatedImuConfig::default());
    assert!(bench.driver.is_measuring(), "{:?}", bench.events);
    assert!(bench.has(|e| *e == Event::Set(MessageId::OUTPUT_SETTINGS)));
    assert_eq!(bench.imu.flash_writes(), 1);
    assert!(bench.samples.len() > 130, "{}", bench.samples.len());
    bench.check_truth(0.2e-3);
    let identity = bench.driver.identity();
    assert_eq!(identity.product_code, "MTx-28A53G25");
    assert_eq!(identity.firmware, "2.6.0");
    // The same device again: nothing differs.
    let config = bench.imu.config().clone();
    let bench = Bench::after(2.0, DriverConfig::default(), config);
    assert!(bench.samples.len() > 130);
    assert_eq!(bench.imu.flash_writes(), 0);
}

#[test]
fn every_setting_is_applied() {
    let default = DriverConfig::default;
    for (driver, expected_rate) in [
        (DriverConfig { orientation: false, temperature: true, status: true, ..default() }, 100.0),
        (DriverConfig { rate: 50.0, magnetic_field: false, ..default() }, 50.0),
        (DriverConfig { number_format: NumberFormat::Fp1632, ..default() }, 100.0),
        (DriverConfig { rate: 400.0, baud: 460_800, ..default() }, 400.0),
    ] {
        let baud = driver.baud;
        let imu = SimulatedImuConfig { baud, period: 2304, ..SimulatedImuConfig::default() };
        let mut bench = Bench::after(3.0, driver.clone(), imu);
        let configuration = bench.imu.config().configuration();
        assert_eq!(configuration.rate(), Some(expected_rate));
        assert_eq!(configuration.format, driver.legacy_format());
        bench.check_truth(0.3e-3);
        let last = bench.samples.last().unwrap();
        assert_eq!(last.imu.as_ref().unwrap().orientation.is_some(), driver.orientation);
        assert_eq!(last.magnetic_field.is_some(), driver.magnetic_field);
        assert_eq!(last.temperature.is_some(), driver.temperature);
        assert_eq!(last.status.is_some(), driver.status);
    }
}

#[test]
fn a_device_at_another_baud_rate_is_found_by_scanning() {
    let driver = DriverConfig { baud: 0, ..DriverConfig::default() };
    let imu = SimulatedImuConfig { baud: 460_800, ..SimulatedImuConfig::default() };
    let mut bench = Bench::after(4.0, driver, imu);
    assert!(bench.driver.is_measuring(), "{:?}", bench.events);
    assert_eq!(bench.bauds, [921_600, 460_800]);
    assert_eq!(bench.driver.identity().baud, 460_800);
    // After an interruption the search starts at that baud rate.
    bench.replug(0.5, 2.0);
    assert_eq!(bench.bauds, [921_600, 460_800]);
    assert!(bench.driver.is_measuring());
}

#[test]
fn a_wrong_baud_rate_is_reported_and_two_stop_bits_are_sent() {
    let imu = SimulatedImuConfig { baud: 57_600, ..SimulatedImuConfig::default() };
    let bench = Bench::after(4.0, DriverConfig::default(), imu);
    let garbage = bench.has(|e| matches!(e, Event::NoAnswer { garbage: true, .. }));
    assert!(garbage, "{:?}", bench.events);
    let imu = SimulatedImuConfig { needs_two_stop_bits: true, ..SimulatedImuConfig::default() };
    let driver = DriverConfig { two_stop_bits: true, ..DriverConfig::default() };
    let mut bench = Bench::after(2.0, driver, imu);
    assert!(bench.driver.is_measuring());
    bench.check_truth(0.3e-3);
}

#[test]
fn the_driver_recovers_from_power_up_and_brown_out() {
    let imu = SimulatedImuConfig { already_measuring: false, ..SimulatedImuConfig::default() };
    let mut bench = Bench::after(2.0, DriverConfig::default(), imu);
    assert!(bench.driver.is_measuring(), "{:?}", bench.events);
    let before = bench.samples.len();
    bench.imu.power_cycle(bench.now);
    bench.run(1.5);
    assert!(bench.has(|e| *e == Event::WokeUp));
    assert!(bench.driver.is_measuring());
    // 0.2 s of booting, then samples within a second of the first answer.
    assert!(bench.samples.len() > before + 60, "{} {before}", bench.samples.len());
    bench.check_truth(0.3e-3);
}

#[test]
fn slow_acknowledgements_and_lost_requests_are_handled() {
    for (ack_delay, ignored_requests) in [(0.7, 0), (1.3, 0), (0.002, 5), (0.1, 20)] {
        let imu = SimulatedImuConfig {
            ack_delay,
            ignored_requests,
            config_ack_delay: 0.3,
            ..SimulatedImuConfig::default()
        };
        let mut bench = Bench::after(25.0, DriverConfig::default(), imu);
        assert!(bench.driver.is_measuring(), "{ack_delay} {ignored_requests}: {:?}", bench.events);
        let configuration = bench.imu.config().configuration();
        assert_eq!(configuration.format, DriverConfig::default().legacy_format());
        bench.check_truth(0.3e-3);
    }
}

#[test]
fn after_replugging_samples_resume_and_no_frames_are_mixed() {
    let mut bench = Bench::after(3.0, DriverConfig::default(), SimulatedImuConfig::default());
    for outage in [0.05, 1.0, 30.0] {
        let before = bench.samples.len();
        bench.replug(outage, 2.5);
        assert!(bench.driver.is_measuring(), "{outage}");
        // Up to the longest pause until the port is opened, then calling and configuring.
        assert!(bench.samples.len() > before + 50, "{outage}: {}", bench.samples.len() - before);
    }
    assert!(bench.has(|e| matches!(e, Event::PortMissing { .. })));
    assert_eq!(bench.imu.flash_writes(), 1);
    bench.check_truth(0.3e-3);
    assert_eq!(bench.driver.statistics().connections, 4);
    assert_eq!(bench.driver.statistics().lost, 0);
}

#[test]
fn a_silent_device_is_called_until_it_answers() {
    let mut bench = Bench::after(3.0, DriverConfig::default(), SimulatedImuConfig::default());
    bench.imu.set_mute(true);
    bench.run(20.0);
    assert!(bench.has(|e| matches!(e, Event::Silent(_))));
    assert!(bench.has(|e| matches!(e, Event::NoAnswer { garbage: false, .. })));
    let calls = bench.written;
    bench.run(10.0);
    // The pauses have grown: only a few calls per second.
    assert!(bench.written - calls < 50, "{}", bench.written - calls);
    bench.imu.set_mute(false);
    let before = bench.samples.len();
    bench.run(2.5);
    assert!(bench.samples.len() > before + 50);
    bench.check_truth(0.3e-3);
}

#[test]
fn garbage_between_frames_loses_no_other_frames() {
    let mut bench = Bench::after(2.0, DriverConfig::default(), SimulatedImuConfig::default());
    let before = bench.samples.len();
    for k in 0..50_u8 {
        // Noise, invalid preambles, a header with 8 KiB, half a frame, an unexpected reply.
        bench.imu.inject(&[0xFA, 0xFF, k, 0x00, 0xFA], bench.now);
        bench.imu.inject(&[0xFA, 0xFF, 0x32, 0xFF, 0x1F, 0x00], bench.now);
        bench.imu.inject(&frame(MessageId::OUTPUT_MODE.ack(), &[])[..3], bench.now);
        bench.imu.inject(&frame(MessageId::GO_TO_CONFIG.ack(), &[]), bench.now);
        bench.run(0.4);
    }
    assert!(bench.driver.is_measuring());
    assert_eq!(bench.driver.statistics().connections, 1);
    assert_eq!(bench.driver.statistics().lost, 0);
    assert!(bench.samples.len() > before + 1980, "{}", bench.samples.len() - before);
    bench.check_truth(2e-3);
}

#[test]
fn an_mtdata2_device_is_set_up_by_its_output_configuration() {
    let imu = SimulatedImuConfig {
        outputs: Some(vec![OutputEntry { id: 0x2010, rate: 100 }]),
        product_code: "MTi-100".into(),
        ..SimulatedImuConfig::default()
    };
    let driver = DriverConfig { temperature: true, status: true, ..DriverConfig::default() };
    let mut bench = Bench::after(3.0, driver.clone(), imu);
    assert_eq!(bench.imu.config().outputs, Some(driver.outputs()), "{:?}", bench.events);
    assert!(bench.driver.is_measuring(), "{:?}", bench.events);
    assert!(bench.samples.last().unwrap().status.unwrap().contains(Status::SELF_TEST_PASSED));
    // SampleTimeFine has a resolution of 0.1 ms.
    bench.check_truth(1.3e-3);
    let written = bench.imu.flash_writes();
    bench.replug(0.2, 2.0);
    assert!(bench.driver.is_measuring());
    assert_eq!(bench.imu.flash_writes(), written);
}

#[test]
fn legacy_orientation_in_north_east_down_is_converted() {
    let mut imu = SimulatedImuConfig::default();
    let euler = OutputSettings::from_bits_retain(1 << 2);
    imu.format.settings = OutputSettings::NED | OutputSettings::COUNTER | euler;
    let driver = DriverConfig { leave_settings: true, ..DriverConfig::default() };
    let mut bench = Bench::after(2.0, driver, imu);
    bench.check_truth(0.3e-3);
    assert_eq!(bench.imu.flash_writes(), 0);
}

/// Stamp errors (s) behind an adapter, after the first seconds.
fn stamp_errors(driver: DriverConfig, imu: SimulatedImuConfig, seconds: f64) -> Vec<f64> {
    let mut bench = Bench::new(driver, imu);
    bench.host.lateness = 80e-6;
    bench.run(6.5);
    bench.samples.clear();
    bench.run(seconds);
    assert_eq!(bench.driver.statistics().lost, 0);
    for pair in bench.samples.windows(2) {
        assert!(pair[1].stamp > pair[0].stamp);
    }
    bench.stamp_errors()
}

#[test]
fn stamps_behind_bursts_with_drift_and_jitter_are_accurate() {
    for (rate, baud, ppm) in
        [(100.0, 115_200, -30.0), (100.0, 115_200, 30.0), (400.0, 460_800, -30.0)]
    {
        let driver = DriverConfig { rate, baud, ..DriverConfig::default() };
        let imu = SimulatedImuConfig {
            baud,
            clock_ppm: ppm,
            burst: Some(0.016),
            burst_jitter: 0.002,
            ..SimulatedImuConfig::default()
        };
        let errors = stamp_errors(driver, imu, 30.0);
        let (rms, _) = rms_and_worst(&errors);
        println!(
            "16 ms bursts, {rate} Hz, {ppm} ppm: {:.3} ms RMS over {} samples",
            rms * 1e3,
            errors.len()
        );
        assert!(rms < 0.2e-3, "{rms}");
    }
}

#[test]
fn stamps_behind_bursts_synchronous_with_the_samples_are_accurate() {
    // Periods of exactly 16 ms and 10 ms have five phases: with complete messages an error of up to
    // 2 ms would not be observable. Half of the bursts split a message, which determines its begin.
    let mut worst = 0.0_f64;
    for ppm in [-30.0, 0.0, 30.0] {
        for phase in 0..8 {
            let imu = SimulatedImuConfig {
                clock_ppm: ppm,
                burst: Some(0.016),
                config_ack_delay: 0.1 + 0.25e-3 * f64::from(phase),
                ..SimulatedImuConfig::default()
            };
            let (rms, _) = rms_and_worst(&stamp_errors(DriverConfig::default(), imu, 10.0));
            worst = worst.max(rms);
            assert!(rms < 0.2e-3, "{ppm} ppm, phase {phase}: {rms}");
        }
    }
    println!(
        "16 ms bursts synchronous with 10 ms samples: at most {:.3} ms RMS in 24 runs",
        worst * 1e3
    );
}

#[test]
fn stamps_on_a_busy_host_are_accurate_from_the_first_sample_on() {
    let mut all = Vec::new();
    for seed in 1..=40_u64 {
        let mut bench = Bench::new(DriverConfig::default(), SimulatedImuConfig::default());
        bench.host.busy = true;
        bench.host.random = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
        bench.run(4.0);
        bench.replug(0.3, 4.0);
        let statistics = bench.driver.statistics();
        assert_eq!(statistics.lost, 0);
        assert_eq!(statistics.samples as usize, bench.samples.len(), "samples are withheld");
        assert!(bench.samples.len() > 500, "{}", bench.samples.len());
        all.extend(bench.stamp_errors());
    }
    let (rms, worst) = rms_and_worst(&all);
    println!(
        "busy host, from the first sample on: {:.3} ms RMS, {:.3} ms at worst",
        rms * 1e3,
        worst * 1e3
    );
    assert!(rms < 0.2e-3 && worst < 1e-3, "{rms} {worst}");
}

/// Largest stamp error (s) before and after a step of the host's clock, and the events.
fn stamps_around_a_clock_step(by: f64, report: bool) -> (f64, Vec<Event>) {
    let imu = SimulatedImuConfig { clock_ppm: 20.0, ..SimulatedImuConfig::default() };
    let mut bench = Bench::new(DriverConfig::default(), imu);
    bench.host.lateness = 2e-3;
    bench.run(20.0);
    bench.samples.clear();
    bench.events.clear();
    bench.run(2.0);
    bench.set_clock(by, report);
    bench.run(10.0);
    assert_eq!(bench.driver.statistics().lost, 0);
    assert!(bench.samples.len() > 1100, "{}", bench.samples.len());
    (rms_and_worst(&bench.stamp_errors()).1, bench.events)
}

#[test]
fn stamps_follow_a_reported_clock_step_at_once() {
    for by in [3600.0 * 24.0 * 365.25 * 56.0, 5.0, 0.3, 0.02, -0.02, -0.3, -5.0, -1e6] {
        let (worst, events) = stamps_around_a_clock_step(by, true);
        println!("clock step of {by} s: stamp error {:.3} ms at worst", worst * 1e3);
        assert!(worst < 0.3e-3, "{by}: {worst}");
        assert!(
            matches!(events[..], [Event::ClockSet(seconds)] if (seconds - by).abs() < 1e-6),
            "{events:?}"
        );
    }
    // An unreported step is detected after a second of consistent samples.
    let (worst, events) = stamps_around_a_clock_step(2.0, false);
    assert!(worst > 1.0 && matches!(events[..], [Event::ClockStepped(_)]), "{worst} {events:?}");
}
