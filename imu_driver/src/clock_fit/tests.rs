//! Clock steps, restarts, and hosts that sleep; `tests/driver` has bursts, drift and a busy host.

use super::*;

/// Stamps one sample without settling; returns the stamp and the size of a detected step.
fn stamp(fit: &mut ClockFit, device: i64, arrival: Stamp) -> (Stamp, Option<f64>) {
    let jump = fit.jump(device, arrival);
    if let Some(jump) = jump {
        fit.step(jump, arrival);
    }
    fit.observe(device, arrival);
    (fit.stamp(device), jump)
}

#[test]
fn clock_steps_are_detected_and_followed() {
    let start = Stamp::from_nanos(1_760_001_000_000_000_000);
    for jump in [3.0, -3.0] {
        let mut fit = ClockFit::new(1.0);
        let mut steps = Vec::new();
        let mut last_error = 0.0;
        for k in 0..2000_i64 {
            let t = k as f64 * 0.01;
            let arrival = start.plus_seconds(t + if k >= 1000 { jump } else { 0.0 });
            let (stamp, stepped) = stamp(&mut fit, k * 10_000_000, arrival);
            steps.extend(stepped);
            last_error = stamp.seconds_since(arrival);
        }
        assert_eq!(steps.len(), 1, "{jump}");
        assert!((steps[0] - jump).abs() < 1e-3);
        assert!(last_error.abs() < 1e-3, "{jump}: {last_error}");
    }
}

#[test]
fn late_messages_after_a_sleeping_host_are_no_clock_step() {
    let start = Stamp::from_nanos(1_760_001_000_000_000_000);
    for sleep in [0.5, 1.5, 3.0, 10.0] {
        let mut fit = ClockFit::new(1.0);
        for k in 0..4000_i64 {
            let t = k as f64 * 0.01;
            // Nothing is read from 10 s on, then everything at once.
            let arrival =
                if t > 10.0 && t < 10.0 + sleep { 10.0 + sleep + 1e-5 * k as f64 } else { t };
            let (stamp, stepped) = stamp(&mut fit, k * 10_000_000, start.plus_seconds(arrival));
            assert_eq!(stepped, None, "{sleep} {t}");
            let error = stamp.seconds_since(start) - t;
            assert!(error.abs() < 1e-4, "{sleep} {t}: {error}");
        }
    }
}

#[test]
fn after_a_restart_stamps_increase_and_use_the_new_offset() {
    let start = Stamp::from_nanos(0);
    let mut fit = ClockFit::new(1.0);
    let first = stamp(&mut fit, 1_000_000_000, start.plus_seconds(10.0)).0;
    fit.restart();
    let second = stamp(&mut fit, 0, start.plus_seconds(10.0)).0;
    assert!(second > first);
    let third = stamp(&mut fit, 500_000_000, start.plus_seconds(10.5)).0;
    assert!(third.seconds_since(start.plus_seconds(10.5)).abs() < 1e-5);
}
