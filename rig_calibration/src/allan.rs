//! Noise of an IMU at rest: the overlapping Allan deviation (IEEE Std 952-1997, annex C).
//!
//! A sensor's white noise of density N has the deviation N/√τ over averaging times τ, its bias
//! instability B a flat minimum of 0.664 B, and the random walk of its bias, of density K, K
//! √(τ/3).

use nalgebra::Vector3;
use rig_model::{ImuSample, median};
use std::fmt;
use thiserror::Error;

/// Shortest record, s: white noise of 100 Hz is then known to 1.4 %.
pub const SHORTEST: f64 = 25.0;
/// Largest deviation of the mean over a second from the mean of the record: rad/s, m/s². Ten times
/// the noise of a consumer IMU, a tenth of a hanging platform's.
const STILL: [f64; 2] = [0.01, 0.05];
/// Largest ratio of the Allan deviation at [`SWING`] to that of white noise; the bias of an IMU
/// varies more slowly.
const SWELL: f64 = 4.0;
/// Averaging times in which a platform that hangs or a floor that vibrates shows, s.
const SWING: [f64; 2] = [0.2, 2.0];
/// Points of a curve per octave.
const PER_OCTAVE: f64 = 4.0;
/// Fewest averaging intervals in a record for a point of the curve.
const INTERVALS: usize = 9;
/// Largest deviation of a local slope from that of white noise (−½) or of a random walk (+½).
const SLOPE: [f64; 2] = [0.12, 0.2];

/// The two sensors of an IMU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensor {
    /// Angular velocity, rad/s.
    Gyroscope,
    /// Specific force, m/s².
    Accelerometer,
}

impl Sensor {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Gyroscope, Self::Accelerometer];

    /// Unit of its samples.
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Gyroscope => "rad/s",
            Self::Accelerometer => "m/s^2",
        }
    }
}

impl fmt::Display for Sensor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Gyroscope => "gyroscope",
            Self::Accelerometer => "accelerometer",
        })
    }
}

/// Why a record does not yield the noise, with numbers and the remedy.
#[derive(Clone, Debug, Error)]
#[error("{0}")]
pub struct NoiseError(String);

/// Noise of one axis of a sensor.
#[derive(Clone, Debug)]
pub struct AxisNoise {
    /// Averaging time (s) and Allan deviation (the sensor's unit).
    pub curve: Vec<(f64, f64)>,
    /// White noise, unit/√Hz: the standard deviation of a sample over the root of the rate.
    pub density: f64,
    /// Its relative standard deviation.
    pub uncertainty: f64,
    /// Bias instability (unit) and the averaging time of the minimum (s), where the record shows
    /// it.
    pub instability: Option<(f64, f64)>,
    /// Random walk of the bias, unit·√Hz, where the record shows it.
    pub walk: Option<f64>,
}

/// Noise of an IMU.
#[derive(Clone, Debug)]
pub struct ImuNoise {
    /// Sample rate, Hz.
    pub rate: f64,
    /// Length of the evaluated stretch, s.
    pub seconds: f64,
    /// Axes x, y, z of [`Sensor::ALL`].
    pub sensors: [[AxisNoise; 3]; 2],
}

impl ImuNoise {
    /// Noise density of a sensor, root mean square of its axes, unit/√Hz.
    pub fn density(&self, sensor: Sensor) -> f64 {
        let axes = &self.sensors[sensor as usize];
        (axes.iter().map(|a| a.density.powi(2)).sum::<f64>() / 3.0).sqrt()
    }
}

/// Evaluates a record of an IMU at rest, samples in the order of their stamps.
///
/// # Errors
/// The record is too short or interrupted, the IMU was moved or swings, or its noise is not white.
pub fn imu_noise(samples: &[ImuSample]) -> Result<ImuNoise, NoiseError> {
    let (stretch, period) = without_gap(samples);
    let seconds = stretch.len() as f64 * period;
    if stretch.len() < 100 || seconds < SHORTEST {
        return Err(NoiseError(format!(
            "the longest stretch of IMU samples without a gap lasts {seconds:.1} s; record at \
             least {SHORTEST} s at rest (an hour for the bias instability)"
        )));
    }
    let values = |s: &ImuSample| [s.angular_velocity, s.specific_force];
    for (sensor, limit) in Sensor::ALL.into_iter().zip(STILL) {
        let of = |part: &[ImuSample]| {
            part.iter().map(|s| values(s)[sensor as usize]).sum::<Vector3<f64>>()
                / part.len() as f64
        };
        let mean = of(stretch);
        let second = (1.0 / period).ceil() as usize;
        let worst = stretch.chunks_exact(second).map(|c| (of(c) - mean).norm()).enumerate();
        if let Some((index, off)) = worst.max_by(|a, b| a.1.total_cmp(&b.1))
            && off > limit
        {
            let (seconds, unit) = (index as f64, sensor.unit());
            return Err(NoiseError(format!(
                "the IMU is not at rest: at {seconds:.1} s the {sensor}'s mean over a second is \
                 {off:.3} {unit} off the mean of the record (limit {limit}); lay the platform on \
                 the floor, fans off, and record again"
            )));
        }
    }
    let axes = |sensor: Sensor| {
        let [x, y, z] = [(0, 'x'), (1, 'y'), (2, 'z')].map(|(i, axis)| {
            let series: Vec<f64> = stretch.iter().map(|s| values(s)[sensor as usize][i]).collect();
            axis_noise(&series, period, sensor, axis)
        });
        Ok([x?, y?, z?])
    };
    let [gyroscope, accelerometer] = Sensor::ALL.map(axes);
    Ok(ImuNoise { rate: 1.0 / period, seconds, sensors: [gyroscope?, accelerometer?] })
}

/// The longest stretch without a gap, and the mean period of the samples in it, s.
fn without_gap(samples: &[ImuSample]) -> (&[ImuSample], f64) {
    let steps = samples.windows(2).map(|w| w[1].stamp.seconds_since(w[0].stamp));
    let usual = median(steps.collect()).unwrap_or(0.0);
    let whole = |a: &ImuSample, b: &ImuSample| {
        let step = b.stamp.seconds_since(a.stamp);
        step > 0.0 && step < 1.5 * usual
    };
    let longest = samples.chunk_by(whole).max_by_key(|part| part.len()).unwrap_or(&[]);
    let span = match longest {
        [first, .., last] => last.stamp.seconds_since(first.stamp),
        _ => 0.0,
    };
    (longest, span / (longest.len().max(2) - 1) as f64)
}

fn axis_noise(
    series: &[f64],
    period: f64,
    sensor: Sensor,
    axis: char,
) -> Result<AxisNoise, NoiseError> {
    let curve = allan(series, period);
    let slopes: Vec<f64> = (0..curve.len()).map(|i| slope(&curve, i)).collect();
    let white = |i: usize| (slopes[i] + 0.5).abs() < SLOPE[0];
    // Filtered or quantized samples are white above their shortest averaging times only.
    let first = (0..curve.len()).find(|&i| white(i) && (i..curve.len()).take(4).all(white));
    let Some(first) = first else {
        let off = |i: usize| (slopes[i] + 0.5).abs();
        let best = (0..curve.len()).min_by(|&a, &b| off(a).total_cmp(&off(b))).unwrap_or(0);
        let (tau, slope) = (curve[best].0, slopes[best]);
        return Err(NoiseError(format!(
            "the {sensor}'s {axis} shows no white noise: its Allan deviation has the slope \
             {slope:.2} at {tau:.2} s instead of -0.5; are the samples quantized or filtered?"
        )));
    };
    let run = (first..curve.len()).take_while(|&i| white(i));
    // Each point is known to about √(τ/2T).
    let (sum, weights) = run.fold((0.0, 0.0), |(sum, weights), i| {
        let (tau, deviation) = curve[i];
        (sum + (deviation * tau.sqrt()).ln() / tau, weights + 1.0 / tau)
    });
    let density = (sum / weights).exp();
    for &(tau, deviation) in &curve {
        let ratio = deviation * tau.sqrt() / density;
        if (SWING[0]..=SWING[1]).contains(&tau) && tau > curve[first].0 && ratio > SWELL {
            return Err(NoiseError(format!(
                "the IMU is not at rest: over {tau:.1} s the {sensor}'s {axis} varies {ratio:.1} \
                 times as much as its white noise (limit {SWELL}), as it does on a rope or a \
                 vibrating floor; lay the platform on the floor, fans off, and record again"
            )));
        }
    }
    let lowest = (0..curve.len()).min_by(|&a, &b| curve[a].1.total_cmp(&curve[b].1)).unwrap_or(0);
    // A minimum is one only if the curve does not fall on for an octave.
    let seen = lowest + PER_OCTAVE as usize <= curve.len() && curve[lowest].0 > curve[first].0;
    let walk: Vec<f64> = (lowest..curve.len())
        .filter(|&i| (slopes[i] - 0.5).abs() < SLOPE[1])
        .map(|i| curve[i].1 * (3.0 / curve[i].0).sqrt())
        .collect();
    Ok(AxisNoise {
        density,
        uncertainty: (curve[first].0 / (2.0 * series.len() as f64 * period)).sqrt(),
        instability: seen.then(|| (curve[lowest].1 / 0.664, curve[lowest].0)),
        walk: (walk.len() >= 3).then(|| walk.iter().sum::<f64>() / walk.len() as f64),
        curve,
    })
}

/// Overlapping Allan deviation: averaging time (s) and deviation. Averaging times are spaced evenly
/// on a logarithmic scale.
fn allan(series: &[f64], period: f64) -> Vec<(f64, f64)> {
    let mean = series.iter().sum::<f64>() / series.len().max(1) as f64;
    let mut sums = vec![0.0];
    let mut sum = 0.0;
    for value in series {
        sum += value - mean;
        sums.push(sum);
    }
    let mut widths: Vec<usize> = (0..)
        .map(|i| 2f64.powf(f64::from(i) / PER_OCTAVE).round() as usize)
        .take_while(|w| w * INTERVALS <= series.len())
        .collect();
    widths.dedup();
    let deviation = |width: usize| {
        let count = sums.len() - 2 * width;
        let squares: f64 = (0..count)
            .map(|k| (sums[k + 2 * width] - 2.0 * sums[k + width] + sums[k]).powi(2))
            .sum();
        (squares / (2.0 * count as f64)).sqrt() / width as f64
    };
    widths.into_iter().map(|w| (w as f64 * period, deviation(w))).collect()
}

/// Slope of a curve on logarithmic scales around a point, over an octave to both sides.
fn slope(curve: &[(f64, f64)], index: usize) -> f64 {
    let middle = curve[index].0;
    let near: Vec<(f64, f64)> = curve
        .iter()
        .filter(|p| (middle / 2.05..=middle * 2.05).contains(&p.0))
        .map(|p| (p.0.ln(), p.1.max(f64::MIN_POSITIVE).ln()))
        .collect();
    let n = near.len() as f64;
    let (x, y) = near.iter().fold((0.0, 0.0), |s, p| (s.0 + p.0 / n, s.1 + p.1 / n));
    let (up, across) =
        near.iter().fold((0.0, 0.0), |s, p| (s.0 + (p.0 - x) * (p.1 - y), s.1 + (p.0 - x).powi(2)));
    up / across
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_model::Stamp;
    use rig_simulator::random::Random;

    /// Samples of 100 Hz with white noise of these densities.
    fn record(
        seconds: f64,
        densities: [f64; 2],
        mut also: impl FnMut(f64) -> f64,
    ) -> Vec<ImuSample> {
        let mut random = Random::fork(7, "allan");
        let mut noise = |density: f64| Vector3::from_fn(|_, _| random.normal()) * (density * 10.0);
        (0..(seconds * 100.0) as i64)
            .map(|i| {
                let more = also(i as f64 / 100.0);
                let mut sample = ImuSample {
                    stamp: Stamp::from_nanos(i * 10_000_000),
                    angular_velocity: noise(densities[0]) + Vector3::new(0.01, -0.02, 0.0),
                    specific_force: noise(densities[1]) + Vector3::new(0.3, 0.0, 9.8),
                    orientation: None,
                };
                sample.angular_velocity.x += more;
                sample
            })
            .collect()
    }

    #[test]
    fn known_densities_are_found_within_five_percent() {
        for (seconds, tolerance) in [(26.0, 0.05), (600.0, 0.015)] {
            let noise = imu_noise(&record(seconds, [0.00087, 0.002], |_| 0.0)).unwrap();
            assert!((noise.rate - 100.0).abs() < 1e-6);
            for (sensor, truth) in Sensor::ALL.into_iter().zip([0.00087, 0.002]) {
                let off = noise.density(sensor) / truth - 1.0;
                assert!(off.abs() < tolerance, "{sensor} {seconds} s: {off}");
                for axis in &noise.sensors[sensor as usize] {
                    let off = axis.density / truth - 1.0;
                    assert!(off.abs() < 4.0 * axis.uncertainty, "{off} {}", axis.uncertainty);
                    assert!(axis.walk.is_none());
                }
            }
        }
    }

    #[test]
    fn a_random_walk_shows_in_a_long_record_and_bias_instability_before_it() {
        let mut random = Random::fork(3, "walk");
        let mut bias = 0.0;
        let walk = 5e-5;
        let noise = imu_noise(&record(3600.0, [0.000125, 0.002], |_| {
            bias += walk * 0.1 * random.normal();
            bias
        }));
        let x = &noise.unwrap().sensors[0][0];
        let off = x.walk.unwrap() / walk - 1.0;
        assert!(off.abs() < 0.3, "{off}");
        // N/√τ and K √(τ/3) cross at √3 N/K = 4.3 s.
        let (_, tau) = x.instability.unwrap();
        assert!((2.0..10.0).contains(&tau), "{tau}");
        assert!((x.density / 0.000125 - 1.0).abs() < 0.05, "{}", x.density);
    }

    #[test]
    fn motion_gaps_and_short_records_are_refused_with_numbers() {
        let error = |samples: &[ImuSample]| imu_noise(samples).unwrap_err().to_string();
        let noise = [0.00087, 0.002];
        assert!(
            error(&record(20.0, noise, |_| 0.0)).contains("lasts 20.0 s; record at least 25 s")
        );
        assert!(error(&[]).contains("lasts 0.0 s"));
        let mut broken = record(40.0, noise, |_| 0.0);
        broken.drain(2000..2010);
        assert!(error(&broken).contains("lasts 20.0 s"), "{}", error(&broken));
        let knocked = record(40.0, noise, |t| if (30.0..31.0).contains(&t) { 0.05 } else { 0.0 });
        assert!(error(&knocked).contains("at 30.0 s the gyroscope's mean over a second is 0.04"));
        let hanging = record(60.0, noise, |t| 0.008 * (2.8 * t).sin());
        let error = error(&hanging);
        assert!(error.contains("the gyroscope's x varies") && error.contains("rope"), "{error}");
    }

    #[test]
    fn filtered_samples_are_evaluated_where_they_are_white() {
        let mut samples = record(120.0, [0.00087, 0.002], |_| 0.0);
        let mut state = [Vector3::zeros(), Vector3::new(0.3, 0.0, 9.8)];
        for sample in &mut samples {
            // A first-order low-pass filter of 8 Hz.
            state[0] += (sample.angular_velocity - state[0]) * 0.4;
            state[1] += (sample.specific_force - state[1]) * 0.4;
            [sample.angular_velocity, sample.specific_force] = state;
        }
        let noise = imu_noise(&samples).unwrap();
        let off = noise.density(Sensor::Gyroscope) / 0.00087 - 1.0;
        assert!(off.abs() < 0.1, "{off}");
    }
}
