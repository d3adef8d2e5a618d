//! Bursts, drift, clock steps, and hosts that sleep.

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

/// Deterministic uniform numbers in 0..1.
struct Uniform(u64);

impl Uniform {
    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// Timing of an adapter.
#[derive(Clone, Copy, Debug)]
struct Line {
    rate: f64,
    ppm: f64,
    /// Period of its bursts, s.
    burst: f64,
    /// Largest prolongation of a period, s.
    jitter: f64,
    /// Probability per sample that the host stalls for up to 30 ms.
    stalls: f64,
}

struct Outcome {
    rms: f64,
    max: f64,
    mean: f64,
    backwards: usize,
    interval_rms: f64,
}

fn simulate(line: Line, seconds: f64, seed: u64) -> Outcome {
    let start = Stamp::from_nanos(1_760_001_000_000_000_000);
    let mut random = Uniform(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    let mut fit = ClockFit::new(ClockFitConfig::default());
    let mut burst = random.next() * line.burst;
    let (mut sum, mut squares, mut interval_squares, mut max, mut n) =
        (0.0, 0.0, 0.0, 0.0_f64, 0.0);
    let mut backwards = 0;
    let mut last: Option<(Stamp, f64)> = None;
    let mut not_before = 0.0_f64;
    for k in 0..(seconds * line.rate) as i64 {
        let device = k as f64 / line.rate;
        let truth = device / (1.0 + line.ppm * 1e-6);
        while line.burst > 0.0 && burst < truth {
            burst += line.burst + line.jitter * random.next();
        }
        let mut arrival = if line.burst > 0.0 { burst } else { truth };
        arrival += 20e-6 + 80e-6 * random.next();
        if random.next() < line.stalls {
            not_before = arrival + 0.03 * random.next();
        }
        arrival = arrival.max(not_before);
        let (stamp, stepped) =
            stamp(&mut fit, (device * 1e9).round() as i64, start.plus_seconds(arrival));
        assert_eq!(stepped, None);
        let error = stamp.seconds_since(start) - truth;
        if let Some((before, previous)) = last {
            backwards += usize::from(stamp <= before);
            if device > 5.0 {
                let interval = stamp.seconds_since(before) - (truth - previous);
                interval_squares += interval * interval;
            }
        }
        last = Some((stamp, truth));
        if device > 5.0 {
            sum += error;
            squares += error * error;
            max = max.max(error.abs());
            n += 1.0;
        }
    }
    Outcome {
        rms: (squares / n).sqrt(),
        max,
        mean: sum / n,
        backwards,
        interval_rms: (interval_squares / n).sqrt(),
    }
}

#[test]
fn stamps_behind_bursts_and_drift_are_within_a_fifth_of_a_millisecond() {
    println!("rate ppm burst jitter stalls | rms max mean interval-rms, ms (worst seed of 20)");
    for (rate, burst, jitter, stalls, bound) in [
        (100.0, 0.016, 0.001, 0.001, 0.2e-3),
        (100.0, 0.016, 0.004, 0.01, 0.2e-3),
        (400.0, 0.016, 0.001, 0.001, 0.2e-3),
        (100.0, 0.0, 0.0, 0.01, 0.1e-3),
        // Complete messages in bursts synchronous with the samples: 2 ms are not observable.
        (100.0, 0.016, 0.0, 0.0, 2.2e-3),
    ] {
        for ppm in [-30.0, 0.0, 30.0] {
            let line = Line { rate, ppm, burst, jitter, stalls };
            let mut worst = simulate(line, 60.0, 1);
            for seed in 2..=20 {
                let outcome = simulate(line, 60.0, seed);
                assert_eq!(outcome.backwards, 0);
                if outcome.rms > worst.rms {
                    worst = outcome;
                }
            }
            let Outcome { rms, max, mean, interval_rms, .. } = worst;
            println!(
                "{rate} {ppm} {burst} {jitter} {stalls} | {:.3} {:.3} {:.3} {:.4}",
                rms * 1e3,
                max * 1e3,
                mean * 1e3,
                interval_rms * 1e3
            );
            assert!(rms <= bound, "{line:?}: {rms}");
        }
    }
}

#[test]
fn clock_steps_are_detected_and_followed() {
    let start = Stamp::from_nanos(1_760_001_000_000_000_000);
    for jump in [3.0, -3.0] {
        let mut fit = ClockFit::new(ClockFitConfig::default());
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
        let mut fit = ClockFit::new(ClockFitConfig::default());
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
    let mut fit = ClockFit::new(ClockFitConfig::default());
    let first = stamp(&mut fit, 1_000_000_000, start.plus_seconds(10.0)).0;
    fit.restart();
    let second = stamp(&mut fit, 0, start.plus_seconds(10.0)).0;
    assert!(second > first);
    let third = stamp(&mut fit, 500_000_000, start.plus_seconds(10.5)).0;
    assert!(third.seconds_since(start.plus_seconds(10.5)).abs() < 1e-5);
}
