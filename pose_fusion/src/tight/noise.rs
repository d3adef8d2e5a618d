//! How noisy the inertial unit is, told from its own samples.
//!
//! Third differences cancel any motion that is smooth over four samples (a 1 Hz swing of 35° leaves a tenth of an
//! MTx's noise at 100 Hz), and white noise of variance σ² leaves 20 σ² in their square. The rig file's density is
//! the floor. The noise that is found within the first second serves from then on; it follows changes within a second.

use super::propagate::Felt;
use nalgebra::Vector3;

/// Variances per sample of the specific force and the rate of turn, with the time between samples.
#[derive(Clone, Debug)]
pub struct InertialNoise {
    last: [Felt; 4],
    count: usize,
    force: f64,
    rate: f64,
    weight: f64,
    period: f64,
}

impl Default for InertialNoise {
    fn default() -> Self {
        let none = Felt { force: Vector3::zeros(), rate: Vector3::zeros() };
        Self { last: [none; 4], count: 0, force: 0.0, rate: 0.0, weight: 0.0, period: 0.01 }
    }
}

impl InertialNoise {
    /// Takes in a sample that came `dt` seconds after the one before.
    pub fn take(&mut self, felt: &Felt, dt: f64) {
        if !(dt > 0.0 && dt < 0.05) {
            self.count = 0;
        }
        self.last.rotate_left(1);
        self.last[3] = *felt;
        self.count = self.count.saturating_add(1);
        if self.count < 4 {
            return;
        }
        self.weight = (self.weight + 1.0).min(100.0);
        let third = |f: &dyn Fn(&Felt) -> Vector3<f64>| {
            (f(&self.last[3]) - f(&self.last[2]) * 3.0 + f(&self.last[1]) * 3.0 - f(&self.last[0]))
                .norm_squared()
                / 60.0
        };
        let mut force = third(&|f| f.force);
        let mut rate = third(&|f| f.rate);
        if self.weight > 20.0 {
            // A single knock is no noise.
            force = force.min(20.0 * self.force);
            rate = rate.min(20.0 * self.rate);
        }
        self.force += (force - self.force) / self.weight;
        self.rate += (rate - self.rate) / self.weight;
        self.period += (dt - self.period) / self.weight.max(10.0);
    }

    /// Power densities to be assumed, given those of the rig file: (m/s²)²/Hz, (rad/s)²/Hz.
    pub fn densities(&self, force: f64, rate: f64, limit: f64) -> (f64, f64) {
        let believed = |found: f64, given: f64| {
            let found = found * self.period;
            // The estimate scatters by a fifth; below half as much again the rig file is right.
            if self.weight >= 15.0 && found > 1.5 * given { found.min(given * limit * limit) } else { given }
        };
        (believed(self.force, force), believed(self.rate, rate))
    }

    /// Variances per sample that belong to the densities.
    pub fn period(&self) -> f64 {
        self.period
    }
}

/// Half a second of samples, to tell whether the platform stands still.
#[derive(Clone, Debug)]
pub struct Stillness {
    force: [Vector3<f64>; WINDOW],
    rate: [Vector3<f64>; WINDOW],
    next: usize,
    filled: usize,
}

const WINDOW: usize = 50;

impl Default for Stillness {
    fn default() -> Self {
        Self { force: [Vector3::zeros(); WINDOW], rate: [Vector3::zeros(); WINDOW], next: 0, filled: 0 }
    }
}

impl Stillness {
    /// Takes in a sample. Every half second, the mean rate of turn where the unit stood still for so long: neither mean of
    /// the two halves differs by more than its noise (variances per sample given), and neither scatters more.
    pub fn take(&mut self, felt: &Felt, force_variance: f64, rate_variance: f64) -> Option<Vector3<f64>> {
        self.force[self.next] = felt.force;
        self.rate[self.next] = felt.rate;
        self.next = (self.next + 1) % WINDOW;
        self.filled += 1;
        if self.filled < WINDOW {
            return None;
        }
        if self.next != 0 {
            return None;
        }
        let quiet = |samples: &[Vector3<f64>; WINDOW], variance: f64| {
            let (a, b) = samples.split_at(WINDOW / 2);
            let mean = |s: &[Vector3<f64>]| s.iter().sum::<Vector3<f64>>() / s.len() as f64;
            let all = mean(samples);
            let scatter =
                samples.iter().map(|x| (x - all).norm_squared()).sum::<f64>() / (3.0 * (WINDOW as f64 - 1.0));
            let drift = (mean(a) - mean(b)).norm_squared() / 3.0;
            (scatter < 1.5 * variance && drift < 12.0 * variance / WINDOW as f64).then_some(all)
        };
        quiet(&self.force, force_variance)?;
        quiet(&self.rate, rate_variance)
    }

    /// Forgets all.
    pub fn clear(&mut self) {
        self.filled = 0;
        self.next = 0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ten_times_the_noise_is_found_within_a_second_while_it_swings() {
        let mut noise = InertialNoise::default();
        let mut state = 3u64;
        let mut normal = || {
            let mut sum = 0.0;
            for _ in 0..12 {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                sum += (state >> 11) as f64 * 2f64.powi(-53);
            }
            sum - 6.0
        };
        for i in 0..100 {
            let t = f64::from(i) * 0.01;
            let swing = (std::f64::consts::TAU * t).sin();
            let mut white = |s: f64| Vector3::new(normal(), normal(), normal()) * s;
            let felt = Felt {
                force: Vector3::new(3.0 * swing, 1.0, 9.8) + white(0.2),
                rate: Vector3::new(3.0 * swing, 0.0, 0.0) + white(0.087),
            };
            noise.take(&felt, 0.01);
        }
        let (force, rate) = noise.densities(4e-6, 7.6e-7, 30.0);
        assert!((force.sqrt() / 0.02 - 1.0).abs() < 0.25 && (rate.sqrt() / 0.0087 - 1.0).abs() < 0.25);
        let (force, _) = noise.densities(3.5e-4, 7.6e-7, 30.0);
        assert_eq!(force, 3.5e-4);
    }
}
