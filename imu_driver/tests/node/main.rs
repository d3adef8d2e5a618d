//! The node as a process, between a pseudo-terminal and DDS.
#![cfg(all(feature = "node", feature = "simulated"))]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

mod harness;

use harness::{Harness, RIG, Received, check_truth, received};
use imu_driver::{
    protocol::{MessageId, frame},
    simulated_imu::{SentSample, SimulatedImuConfig, pty::now},
};
use node_kit::convert;
use rig_model::Stamp;
use std::{
    process::{Command, Stdio},
    sync::Arc,
    time::Duration,
};
use volant_msgs::sensor_msgs::msg::Imu;

fn percentile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share).round() as usize]
}

/// Latencies of the messages (from the end of the transmission, which includes the lateness of the
/// simulated IMU, to the receipt) and root mean square of their stamp errors, ms.
fn latencies(messages: &[(Stamp, Arc<Imu>)], sent: &[SentSample]) -> (Vec<f64>, f64) {
    let (mut latencies, mut squares) = (Vec::new(), 0.0);
    for (at, message) in messages {
        let stamp = convert::stamp(&message.header.stamp);
        let truth =
            sent.iter().min_by_key(|s| (s.measured.as_nanos() - stamp.as_nanos()).abs()).unwrap();
        latencies.push(at.seconds_since(truth.sent) * 1e3);
        squares += (stamp.seconds_since(truth.measured) * 1e3).powi(2);
    }
    let stamps_rms = (squares / messages.len() as f64).sqrt();
    let [p50, p99] = [0.5, 0.99].map(|share| percentile(&mut latencies.clone(), share));
    println!(
        "last byte on the line → message received over DDS, {} samples: p50 {p50:.3} ms, \
         p99 {p99:.3} ms; stamps {stamps_rms:.3} ms RMS",
        latencies.len()
    );
    (latencies, stamps_rms)
}

/// Smallest median of ten consecutive latencies, which other load did not delay.
fn smallest_median(latencies: &[f64]) -> f64 {
    latencies.windows(10).map(|w| percentile(&mut w.to_vec(), 0.5)).fold(f64::INFINITY, f64::min)
}

/// p99 <= 2 ms after the transmission, on a quiet machine.
#[test]
#[ignore = "needs a quiet machine"]
fn p99_from_the_last_byte_to_the_message_is_at_most_two_milliseconds() {
    let harness = Harness::start(75, SimulatedImuConfig::default(), &[]);
    assert!(harness.wait_for_samples(3200, 60.0));
    let sent = harness.imu.take_sent();
    let messages = received(|r| std::mem::take(&mut r.imu));
    let (mut latencies, _) = latencies(&messages[200..], &sent);
    let p99 = percentile(&mut latencies, 0.99);
    assert!(p99 <= 2.0, "{p99}");
}

#[test]
fn messages_are_published_without_delay_and_with_accurate_stamps() {
    let harness = Harness::start(71, SimulatedImuConfig::default(), &[]);
    assert!(harness.wait_for_samples(200, 30.0));
    assert!(harness.wait_for_samples(900, 30.0));
    let sent = harness.imu.take_sent();
    let messages = received(|r| std::mem::take(&mut r.imu));
    // DDS discovery delays the first samples.
    let (latencies, stamps_rms) = latencies(&messages[200..], &sent);
    check_truth(&messages, 5e-3);
    let message = &messages[250].1;
    assert_eq!(message.header.frame_id, "imu");
    // Variances, not standard deviations: 0.002² · 100 Hz.
    assert!((message.linear_acceleration_covariance[0] - 4e-4).abs() < 1e-9);
    assert!((message.orientation_covariance[8] - 0.087 * 0.087).abs() < 1e-9);
    received(|r| {
        let field = &r.field[10].magnetic_field;
        assert!((field.x - 0.4 * 5e-5).abs() < 1e-9 && (field.z + 0.9 * 5e-5).abs() < 1e-9);
        let transform = &r.tf[0].transforms[0];
        assert_eq!(
            (transform.header.frame_id.as_str(), transform.child_frame_id.as_str()),
            ("volant", "imu")
        );
        assert!((transform.transform.translation.z + 0.0218).abs() < 1e-12);
    });
    // 100 Hz without missing samples, as delivered by DDS.
    let intervals = messages[200..].windows(2).map(|w| {
        convert::stamp(&w[1].1.header.stamp).seconds_since(convert::stamp(&w[0].1.header.stamp))
    });
    let holes = intervals.clone().filter(|i| *i > 0.015).count();
    assert!(holes <= 5, "{holes}");
    assert!(intervals.clone().all(|i| (i / 0.01 - (i / 0.01).round()).abs() < 0.1));
    // Other load delays samples by time slices (up to 192 ms were seen), so that percentiles of all
    // samples are asserted on a quiet machine only. The smallest median contains any delay of the
    // driver or the node.
    let smallest = smallest_median(&latencies);
    println!("{smallest:.3} ms smallest median of ten samples");
    assert!(smallest <= 2.0, "{smallest} {latencies:?}");
    assert!(stamps_rms < 1.0, "{stamps_rms}");
}

#[test]
fn with_settings_left_as_they_are_the_covariance_has_the_rate_of_the_imu() {
    let config = SimulatedImuConfig { period: 2304, ..SimulatedImuConfig::default() };
    let harness = Harness::start(76, config, &["-p", "leave_settings:=true"]);
    assert!(harness.wait_for_samples(20, 30.0));
    // 0.002² · 50 Hz, from the first sample on.
    for (_, message) in received(|r| std::mem::take(&mut r.imu)) {
        let variance = message.linear_acceleration_covariance[0];
        assert!((variance - 2e-4).abs() < 1e-9, "{variance}");
    }
}

#[test]
fn the_node_recovers_from_unplugging_slow_replies_garbage_and_power_loss() {
    let config = SimulatedImuConfig { ack_delay: 0.02, ..SimulatedImuConfig::default() };
    let harness = Harness::start(72, config, &[]);
    assert!(harness.wait_for_samples(100, 20.0));
    for outage in [0.2, 1.2] {
        harness.imu.unplug();
        std::thread::sleep(Duration::from_secs_f64(outage));
        let before = received(|r| r.imu.len());
        harness.imu.replug();
        let plugged = now();
        assert!(harness.wait_for_samples(before + 1, 10.0));
        let back = received(|r| r.imu[before].0).seconds_since(plugged);
        println!("plugged in again after {outage} s: first sample after {back:.2} s");
        // Up to one pause (1 s) until the port is opened, 0.1 s to settle, then within a second.
        assert!(back < 3.0, "{back}");
        assert!(harness.wait_for_samples(before + 100, 10.0));
    }
    harness.imu.with(|imu, at| {
        for k in 0..200_u8 {
            imu.inject(&[0xFA, 0xFF, 0x32, k, 0xFA, k.wrapping_mul(37)], at);
        }
        imu.inject(&frame(MessageId::GO_TO_CONFIG.ack(), &[]), at);
        imu.inject(&frame(MessageId::MT_DATA, &[0; 54])[..40], at);
    });
    let before = received(|r| r.imu.len());
    assert!(harness.wait_for_samples(before + 200, 10.0));
    harness.imu.with(|imu, at| imu.power_cycle(at));
    let before = received(|r| r.imu.len());
    assert!(harness.wait_for_samples(before + 200, 10.0));
    let messages = received(|r| r.imu.clone());
    check_truth(&messages, 30e-3);
    // Only the missing counter was written.
    assert_eq!(harness.imu.with(|imu, _| imu.flash_writes()), Some(1));
    assert!(harness.wait(5.0, |r| r.value("connections") == Some("4")));
}

#[test]
fn a_missing_port_ends_the_node_with_one_line_or_is_waited_for() {
    let node = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_imu_driver"));
        command.args(["--ros-args", "--params-file", RIG]).args(arguments);
        command.env("ROS_DOMAIN_ID", "73").stderr(Stdio::piped());
        command
    };
    for (arguments, code, expected) in [
        (["-p", "port:=/nowhere/tty0"], 1, "/nowhere/tty0"),
        (["-p", "port:=/dev/null"], 1, "/dev/null"),
        (["-p", "baud:=12345"], 1, "12345"),
        (["-p", "rate:=400.0"], 1, "baud"),
    ] {
        let done = node(&arguments).output().unwrap();
        let text = String::from_utf8_lossy(&done.stderr).into_owned();
        assert_eq!(done.status.code(), Some(code), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
        assert!(text.contains(expected), "{text}");
    }
    let mut waiting =
        node(&["-p", "port:=/nowhere/tty0", "-p", "wait_for_device:=true"]).spawn().unwrap();
    std::thread::sleep(Duration::from_secs(1));
    assert!(waiting.try_wait().unwrap().is_none());
    waiting.kill().unwrap();
    waiting.wait().unwrap();
}

#[test]
#[ignore = "takes ten minutes"]
fn ten_minutes_at_400_hz_lose_nothing_at_constant_memory() {
    let config = SimulatedImuConfig {
        baud: 460_800,
        first_counter: 50_000,
        ..SimulatedImuConfig::default()
    };
    let harness = Harness::start(74, config, &["-p", "baud:=460800", "-p", "rate:=400.0"]);
    let seconds = std::env::var("VOLANT_SOAK").ok().and_then(|s| s.parse().ok()).unwrap_or(600.0);
    assert!(harness.wait_for_samples(400, 20.0));
    harness.imu.take_sent();
    received(|r| *r = Received::default());
    let start = now();
    let mut memory = Vec::new();
    let (mut sent, mut count, mut gaps) = (0, 0, 0);
    let mut last: Option<Stamp> = None;
    while now().seconds_since(start) < seconds {
        std::thread::sleep(Duration::from_secs(1));
        memory.push(harness.node.memory());
        sent += harness.imu.take_sent().len();
        let messages = received(|r| std::mem::take(&mut r.imu));
        count += messages.len();
        for (_, message) in messages {
            let stamp = convert::stamp(&message.header.stamp);
            gaps += usize::from(last.is_some_and(|l| stamp.seconds_since(l) > 0.004));
            last = Some(stamp);
        }
    }
    std::thread::sleep(Duration::from_secs(2));
    let [lost, checksums, connections, samples] = received(|r| {
        ["lost samples", "checksum errors", "connections", "samples"]
            .map(|key| r.value(key).unwrap().to_owned())
    });
    let settled = memory.len() / 5;
    let (early, late) = (memory[settled], memory[memory.len() - 1]);
    println!(
        "{seconds:.0} s at 400 Hz: {sent} samples sent, {samples} in all, {lost} lost by the \
         counter, {checksums} checksum errors, {count} received over DDS (best effort) with \
         {gaps} gaps; resident {early} KiB after {settled} s, {late} KiB at the end"
    );
    assert_eq!((lost.as_str(), checksums.as_str(), connections.as_str()), ("0", "0", "1"));
    assert!(late < early + 2048, "{early} {late}");
}
