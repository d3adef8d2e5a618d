//! Noise of the IMU, identified from its own samples by third differences at two time scales; the
//! rig file's density is the floor. Why two: `docs/src/equations.md`, "Adaptation".

use crate::ekf::propagation::ImuReading;
use nalgebra::Vector3;

/// Length of a block, s; its differences measure at 8–12 Hz, above motion and below vibration.
const BLOCK: f64 = 0.04;
/// Longer intervals between samples interrupt the differences, s.
const INTERRUPTED: f64 = 0.05;
/// Memory, differences.
const MEMORY: f64 = 100.0;
/// Fewest differences before the estimate counts.
const FEWEST: f64 = 15.0;
/// Fewest blocks before their changes count.
const FEWEST_CHANGES: f64 = 4.0;
/// Memory of the changes, differences.
const CHANGE_MEMORY: f64 = 50.0;
/// An estimate within this factor of the rig file's density confirms it: it scatters by a fifth.
const CONFIRMED: f64 = 1.5;
/// Largest factor by which the identified noise may exceed the rig file's density.
const LARGEST: f64 = 30.0;

/// Densities of specific force, (m/s²)²/Hz, and angular velocity, (rad/s)²/Hz.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Densities {
    /// Of the specific force.
    pub force: f64,
    /// Of the angular velocity.
    pub rate: f64,
}

impl Densities {
    /// Changes both values.
    pub fn map(&self, f: impl Fn(f64) -> f64) -> Self {
        Self { force: f(self.force), rate: f(self.rate) }
    }

    /// Combines both values with those of `other`.
    pub fn zip(&self, other: &Self, f: impl Fn(f64, f64) -> f64) -> Self {
        Self { force: f(self.force, other.force), rate: f(self.rate, other.rate) }
    }
}

/// Variance of a mean with triangular weights, which suppress vibration, over equal weights.
const TRIANGULAR: f64 = 4.0 / 3.0;

/// Running estimate of the IMU's noise.
#[derive(Clone, Debug)]
pub struct ImuNoise {
    samples: Differences,
    blocks: Differences,
    sum: ImuReading,
    weights: f64,
    filled: f64,
    period: f64,
}

impl Default for ImuNoise {
    fn default() -> Self {
        Self {
            samples: Differences::default(),
            blocks: Differences::default(),
            sum: ImuReading::default(),
            weights: 0.0,
            filled: 0.0,
            period: 0.01,
        }
    }
}

impl ImuNoise {
    /// Adds a reading `dt` seconds after the previous one; zero or a gap interrupts differences.
    pub fn add(&mut self, reading: &ImuReading, dt: f64) {
        if !(dt > 0.0 && dt < INTERRUPTED) {
            self.samples.interrupt();
            self.blocks.interrupt();
            (self.sum, self.weights, self.filled) = (ImuReading::default(), 0.0, 0.0);
            // The first reading of a block has no weight.
            return self.samples.add(reading);
        }
        self.samples.add(reading);
        self.period += (dt - self.period) / self.samples.weight.max(10.0);
        let weight = 1.0 - (2.0 * (self.filled + 0.5 * dt) / BLOCK - 1.0).abs().min(1.0);
        self.sum.specific_force += reading.specific_force * weight;
        self.sum.angular_velocity += reading.angular_velocity * weight;
        (self.weights, self.filled) = (self.weights + weight, self.filled + dt);
        if self.filled >= BLOCK - 0.5 * self.period && self.weights > 0.0 {
            let mean = ImuReading {
                specific_force: self.sum.specific_force / self.weights,
                angular_velocity: self.sum.angular_velocity / self.weights,
            };
            self.blocks.add(&mean);
            (self.sum, self.weights, self.filled) = (ImuReading::default(), 0.0, 0.0);
        }
    }

    /// Returns the densities to assume, given those of the rig file.
    pub fn densities(&self, given: &Densities) -> Densities {
        if !self.is_known() {
            return *given;
        }
        let found = self.samples.variance.zip(&self.blocks.variance, |sample, block| {
            let (sample, block) = (sample * self.period, block * BLOCK / TRIANGULAR);
            if self.blocks.weight >= FEWEST { sample.min(block) } else { sample }
        });
        found.zip(given, |found, given| {
            if found > CONFIRMED * given { found.min(given * LARGEST * LARGEST) } else { given }
        })
    }

    /// Returns the share of noise in the change of the motion from one image to the next, for
    /// specific force and angular velocity. Only the rest of the change measures the time offset.
    /// The motion is the triangular mean of the readings up to `half_width` seconds around it.
    pub fn noise_of_changes(&self, half_width: f64) -> Densities {
        if self.blocks.weight < FEWEST_CHANGES {
            return Densities::default();
        }
        let samples = (1.5 * half_width / self.period()).max(1.0);
        let share = |block: f64, change: f64, sample: f64| {
            let noise = 2.0 * sample / samples;
            noise / (noise + (change - 2.0 * block).max(0.0) + f64::MIN_POSITIVE)
        };
        let (block, change, sample) =
            (self.blocks.variance, self.blocks.change, self.samples.variance);
        Densities {
            force: share(block.force, change.force, sample.force),
            rate: share(block.rate, change.rate, sample.rate),
        }
    }

    /// Returns the variances of one sample, (m/s²)² and (rad/s)², at full bandwidth.
    pub fn sample_variances(&self) -> Densities {
        self.samples.variance
    }

    /// Returns the mean time between samples, s.
    pub fn period(&self) -> f64 {
        self.period.max(1e-4)
    }

    /// Returns whether enough samples came for [`ImuNoise::sample_variances`] to mean something.
    pub fn is_known(&self) -> bool {
        self.samples.weight >= FEWEST
    }
}

/// Variance of a series by its third differences.
#[derive(Clone, Debug, Default)]
struct Differences {
    last: [ImuReading; 4],
    count: usize,
    weight: f64,
    variance: Densities,
    /// Mean squares of the first differences.
    change: Densities,
}

impl Differences {
    fn interrupt(&mut self) {
        self.count = 0;
    }

    fn add(&mut self, reading: &ImuReading) {
        self.last.rotate_left(1);
        self.last[3] = *reading;
        self.count = self.count.saturating_add(1);
        if self.count < 4 {
            return;
        }
        let weight = (self.weight + 1.0).min(MEMORY);
        self.weight = weight;
        let [a, b, c, d] = self.last;
        let third = squares(|of| of(&d) - of(&c) * 3.0 + of(&b) * 3.0 - of(&a), 60.0);
        self.variance = self.variance.zip(&third, |mean, square| {
            // A single shock is no noise.
            let square = if weight > 20.0 { square.min(20.0 * mean) } else { square };
            mean + (square - mean) / weight
        });
        let first = squares(|of| of(&d) - of(&c), 3.0);
        self.change = self
            .change
            .zip(&first, |mean, newest| mean + (newest - mean) / weight.min(CHANGE_MEMORY));
    }
}

/// Returns the squares of a difference of both signals over `divisor`.
fn squares(
    difference: impl Fn(fn(&ImuReading) -> Vector3<f64>) -> Vector3<f64>,
    divisor: f64,
) -> Densities {
    Densities {
        force: difference(|r| r.specific_force).norm_squared() / divisor,
        rate: difference(|r| r.angular_velocity).norm_squared() / divisor,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_simulator::random::Random;

    const GIVEN: Densities = Densities { force: 4e-6, rate: 7.6e-7 };

    /// Reading of a swing at 1 Hz at its `i`-th sample of a hundred, with white noise of these
    /// standard deviations, m/s² and rad/s.
    fn swing(i: i32, random: &mut Random, [force, rate]: [f64; 2]) -> ImuReading {
        let swing = (std::f64::consts::TAU * f64::from(i) * 0.01).sin();
        let mut white = |s: f64| Vector3::from_fn(|_, _| random.normal()) * s;
        ImuReading {
            specific_force: Vector3::new(3.0 * swing, 1.0, 9.8) + white(force),
            angular_velocity: Vector3::new(3.0 * swing, 0.0, 0.0) + white(rate),
        }
    }

    #[test]
    fn ten_times_the_noise_is_found_within_a_second_of_swing() {
        let (mut noise, mut random) = (ImuNoise::default(), Random::new(3));
        for i in 0..100 {
            noise.add(&swing(i, &mut random, [0.2, 0.087]), 0.01);
        }
        let found = noise.densities(&GIVEN);
        assert!((found.force.sqrt() / 0.02 - 1.0).abs() < 0.3, "{}", found.force.sqrt());
        assert!((found.rate.sqrt() / 0.0087 - 1.0).abs() < 0.3, "{}", found.rate.sqrt());
        let loud = Densities { force: 3.5e-4, rate: 7.6e-7 };
        assert_eq!(noise.densities(&loud).force, 3.5e-4);
    }

    #[test]
    fn a_platform_that_sets_off_during_a_gap_is_seen_to_move() {
        let (mut noise, mut random) = (ImuNoise::default(), Random::new(3));
        let mut add = |i: i32, dt: f64| {
            noise.add(&swing(i, &mut random, [0.02, 0.0087]), dt);
            noise.noise_of_changes(0.0)
        };
        let rest = (0..300).map(|_| add(0, 0.01)).last().unwrap();
        assert!(rest.force > 0.5 && rest.rate > 0.5, "{rest:?}");
        add(0, 2.0);
        let moving = (1..50).map(|i| add(i, 0.01)).last().unwrap();
        assert!(moving.force < 0.2 && moving.rate < 0.2, "{moving:?}");
    }

    #[test]
    fn vibration_between_samples_is_not_taken_for_noise_that_is_integrated() {
        let (mut noise, mut random) = (ImuNoise::default(), Random::new(3));
        for i in 0..2000 {
            let sine = |hertz: f64| (std::f64::consts::TAU * hertz * f64::from(i) / 286.0).sin();
            let vibration = sine(93.0) + sine(118.0);
            let mut reading =
                swing(0, &mut random, [0.002 * 286f64.sqrt(), 0.00087 * 286f64.sqrt()]);
            reading.specific_force += Vector3::new(2.0 * vibration, vibration - 1.0, 0.0);
            noise.add(&reading, 1.0 / 286.0);
        }
        let found = noise.densities(&GIVEN);
        assert!(noise.sample_variances().force > 1.0, "{:?}", noise.sample_variances());
        assert!(found.force.sqrt() < 0.02, "{}", found.force.sqrt());
    }
}
