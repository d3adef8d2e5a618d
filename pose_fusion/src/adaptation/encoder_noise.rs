//! Noise of the climber's encoders, identified from their readings.
//!
//! Third divided differences cancel any smooth motion, however the readings are spaced (some are
//! lost or late); divided by the norm of their weights they leave the variance of white noise in
//! their square.

use nalgebra::{Vector3, Vector4};
use rig_model::{Stamp, wrap_angle};

/// Over this span a climber's motion is a parabola but for less than its encoders' step, s.
const SMOOTH: f64 = 0.2;
/// After this time the noise is known, s.
const YOUNG: f64 = 1.0;
/// Noise that is assumed beforehand where the steps are finer (m, m, rad; 1 sigma), that of steps
/// of 1 mm: readings of fine steps may be noisy …
const ASSUMED: [f64; 3] = [3e-4, 3e-4, 3e-4];
/// … with the weight of this many differences.
const ASSUMED_WEIGHT: f64 = 2.0;
/// Largest noise of encoders (m, m, rad; 1 sigma): beyond it something else is wrong, such as a
/// second publisher.
const NOISIEST: f64 = 0.02;
/// Equal readings in a row count as one, up to this number.
pub const STANDING: f64 = 8.0;

/// Running estimate of the encoders' noise.
#[derive(Clone, Debug)]
pub struct EncoderNoise {
    last: [(Stamp, Vector3<f64>); 4],
    count: usize,
    first: Option<Stamp>,
    variance: Vector3<f64>,
    weight: Vector3<f64>,
    floor: Vector3<f64>,
    equal: [f64; 3],
}

impl EncoderNoise {
    /// Creates an estimate with the quantization noise of the steps (m, m, rad) as the floor.
    pub fn new(steps: Vector3<f64>) -> Self {
        Self {
            last: [(Stamp::default(), Vector3::zeros()); 4],
            count: 0,
            first: None,
            variance: Vector3::from(ASSUMED).map(|s| s * s),
            weight: Vector3::repeat(ASSUMED_WEIGHT),
            floor: steps.map(|q| q * q / 12.0),
            equal: [1.0; 3],
        }
    }

    /// Adds a reading that is newer than those before. Returns the variance of a moving climber's
    /// reading, and for each value the number of equal readings in a row, at most [`STANDING`].
    pub fn add(&mut self, stamp: Stamp, values: &Vector3<f64>) -> (Vector3<f64>, [f64; 3]) {
        self.first.get_or_insert(stamp);
        let before = self.last[3].1;
        let mut values = *values;
        if self.count > 0 {
            values.z = before.z + wrap_angle(values.z - before.z);
        }
        self.last.rotate_left(1);
        self.last[3] = (stamp, values);
        self.count = self.count.saturating_add(1);
        for axis in 0..3 {
            let equal = self.count > 1 && values[axis] == before[axis];
            self.equal[axis] = if equal { (self.equal[axis] + 1.0).min(STANDING) } else { 1.0 };
        }
        if let (true, Some(weights)) = (self.count >= 4, self.weights()) {
            let norm = weights.norm_squared();
            for axis in 0..3 {
                let still = (0..3).all(|k| self.last[k].1[axis] == self.last[k + 1].1[axis]);
                if !still {
                    // Relative to the newest value, which is far from zero on a long rail.
                    let d: f64 =
                        (0..3).map(|k| weights[k] * (self.last[k].1[axis] - values[axis])).sum();
                    // Mean of the first differences, then a memory of a hundred; one jump counts
                    // ten times at most.
                    self.weight[axis] = (self.weight[axis] + 1.0).min(100.0);
                    let most = 10.0 * self.variance[axis].max(self.floor[axis]);
                    let most = most.min(NOISIEST * NOISIEST).max(self.floor[axis]);
                    let square = (d * d / norm).min(most);
                    self.variance[axis] += (square - self.variance[axis]) / self.weight[axis];
                }
            }
        }
        (self.variance(), self.equal)
    }

    /// Returns the same for a reading that arrives after newer ones, `neighbor` being the one
    /// before it. It changes nothing, and where it equals its neighbor it counts as little as that
    /// one.
    pub fn late(
        &self,
        values: &Vector3<f64>,
        neighbor: Option<&Vector3<f64>>,
    ) -> (Vector3<f64>, [f64; 3]) {
        let equal = std::array::from_fn(|axis| {
            if neighbor.is_some_and(|n| n[axis] == values[axis]) { STANDING } else { 1.0 }
        });
        (self.variance(), equal)
    }

    /// Returns the weights of the third divided difference of the last four readings; `None` where
    /// they are too far apart for a smooth motion.
    fn weights(&self) -> Option<Vector4<f64>> {
        let newest = self.last[3].0;
        let t = self.last.map(|(at, _)| at.seconds_since(newest));
        if t[0] < -SMOOTH {
            return None;
        }
        // In units of the mean interval, so that the weights stay near one.
        let unit = -t[0] / 3.0;
        Some(Vector4::from_fn(|i, _| {
            (0..4).filter(|j| *j != i).map(|j| unit / (t[i] - t[j])).product::<f64>()
        }))
    }

    /// Returns the variance of a moving climber's reading, m², m², rad².
    pub fn variance(&self) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| {
            let (found, count) = (self.variance[axis], self.weight[axis]);
            // The estimate scatters while it has few differences.
            let scatter = if count >= 15.0 { 1.5 } else { 1.0 + 7.5 / count };
            if found > scatter * self.floor[axis] { found } else { self.floor[axis] }
        })
    }

    /// Returns whether the noise is still being identified and may yet change by much.
    pub fn is_young(&self) -> bool {
        self.first.is_none_or(|first| self.last[3].0.seconds_since(first) < YOUNG)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_simulator::random::Random;

    #[test]
    fn a_second_publisher_a_meter_away_is_no_noise() {
        let mut noise = EncoderNoise::new(Vector3::repeat(1e-3));
        for i in 0..500 {
            let away = if (200..400).contains(&i) && i % 2 == 0 { 1.0 } else { 0.0 };
            let at = Stamp::from_nanos(i * 10_000_000);
            let x = (4e-3 * i as f64 * 1e3).round() * 1e-3;
            noise.add(at, &Vector3::new(x + away, 0.0, 0.0));
            assert!(noise.variance().x.sqrt() <= NOISIEST, "{i}");
        }
        assert!(noise.variance().x.sqrt() < 0.015, "{}", noise.variance().x.sqrt());
    }

    /// A poor link leaves the readings of a moving climber unevenly spaced.
    #[test]
    fn lost_or_late_readings_are_not_taken_for_noise() {
        let step = 0.001;
        let reading = |i: i32| {
            let t = f64::from(i) * 0.02 + 0.002 * f64::from(i % 3);
            let x = ((0.4 * t.sin()) / step).round() * step;
            (Stamp::default().plus_seconds(t), Vector3::new(x, 0.0, 0.0))
        };
        for lost in [&[][..], &[3], &[2, 3], &[1, 2, 5, 6]] {
            let mut noise = EncoderNoise::new(Vector3::repeat(step));
            for (stamp, values) in (0..400).filter(|i| !lost.contains(&(i % 7))).map(reading) {
                noise.add(stamp, &values);
            }
            let sigma = noise.variance().x.sqrt() * 12.0_f64.sqrt() / step;
            assert!(sigma < 1.25, "{lost:?} lost of each seven: {sigma} steps");
        }
        // A late reading that equals its neighbor counts as little as that one.
        let noise = EncoderNoise::new(Vector3::repeat(step));
        let (_, share) =
            noise.late(&Vector3::new(0.3, 0.2, 0.1), Some(&Vector3::new(0.3, 0.1, 0.1)));
        assert_eq!(share, [STANDING, 1.0, STANDING]);
    }

    #[test]
    fn encoders_of_fine_steps_are_not_trusted_before_their_noise_is_known() {
        let step = 1e-5;
        let mut noise = EncoderNoise::new(Vector3::repeat(step));
        assert!(noise.variance().min() > 8.9e-8, "{}", noise.variance());
        let mut random = Random::new(2);
        for (readings, least, most) in [(6, 0.0005, 0.006), (300, 0.0016, 0.0024)] {
            for i in noise.count..readings {
                let x = 0.002 * random.normal();
                let stamp = Stamp::default().plus_seconds(i as f64 * 0.02);
                noise.add(stamp, &Vector3::new(x, 0.001 * i as f64, 0.0));
            }
            let sigmas = noise.variance().map(f64::sqrt);
            assert!(sigmas.x > least && sigmas.x < most, "{readings}: {sigmas}");
            assert_eq!(noise.is_young(), readings == 6);
        }
        assert!(noise.variance().y.sqrt() < 1e-4, "no noise: {}", noise.variance());
    }

    #[test]
    fn one_wrong_reading_of_a_climber_that_has_just_set_off_is_not_taken_for_noise() {
        let step = 0.001;
        for wrong in [100.0, 1e6] {
            let mut noise = EncoderNoise::new(Vector3::repeat(step));
            for i in 0..150 {
                let t = f64::from(i - 50) * 0.02;
                let x = ((0.1 * t.max(0.0)) / step).round() * step;
                let wrong = if i == 53 { wrong } else { 0.0 };
                let stamp = Stamp::default().plus_seconds(f64::from(i) * 0.02);
                noise.add(stamp, &Vector3::new(x + wrong, 0.0, 0.0));
            }
            let sigma = noise.variance().x.sqrt() * 12.0_f64.sqrt() / step;
            assert!(sigma < 10.0, "{sigma} steps after 2 s");
        }
    }

    #[test]
    fn a_climber_at_rest_is_not_known_much_better_than_its_step() {
        let mut noise = EncoderNoise::new(Vector3::repeat(0.001));
        let values = Vector3::new(0.3, 0.2, 0.1);
        let mut variance = 0.01;
        for i in 0..100 {
            let (moving, equal) =
                noise.add(Stamp::default().plus_seconds(f64::from(i) * 0.02), &values);
            variance += 1e-8;
            variance = 1.0 / (1.0 / variance + 1.0 / (moving.x * equal[0]));
        }
        assert!(variance.sqrt() > 0.0001, "{}", variance.sqrt());
    }
}
