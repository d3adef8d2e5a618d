//! Detection of a platform at rest from the IMU's samples.

use super::imu_noise::Densities;
use crate::ekf::propagation::ImuReading;
use nalgebra::Vector3;

/// Length of the window, s.
pub const WINDOW: f64 = 0.5;
/// Fewest samples in a window that say anything about its scatter (25 at 50 Hz).
const FEWEST: f64 = 20.0;

/// Sums of one half of a window, relative to its first reading.
#[derive(Clone, Copy, Debug, Default)]
struct Half {
    count: f64,
    sum: [Vector3<f64>; 2],
    squares: [f64; 2],
}

impl Half {
    fn add(&mut self, values: [Vector3<f64>; 2]) {
        self.count += 1.0;
        for (k, value) in values.into_iter().enumerate() {
            self.sum[k] += value;
            self.squares[k] += value.norm_squared();
        }
    }
}

/// Decides every [`WINDOW`] seconds whether the platform was at rest.
#[derive(Clone, Debug, Default)]
pub struct Stationary {
    origin: Option<ImuReading>,
    elapsed: f64,
    halves: [Half; 2],
}

impl Stationary {
    /// Adds a reading `dt` seconds after the previous one, with the variances of one sample,
    /// (m/s²)² and (rad/s)². Returns the mean angular velocity of the window (rad/s, IMU axes) at
    /// its end where the platform was at rest: neither signal scatters by more than 1.5 times its
    /// variance, and the means of both halves differ by no more than their noise.
    pub fn add(
        &mut self,
        reading: &ImuReading,
        dt: f64,
        variances: &Densities,
    ) -> Option<Vector3<f64>> {
        let origin = *self.origin.get_or_insert(*reading);
        self.elapsed += dt;
        let values = [
            reading.specific_force - origin.specific_force,
            reading.angular_velocity - origin.angular_velocity,
        ];
        self.halves[usize::from(self.elapsed > WINDOW / 2.0)].add(values);
        if self.elapsed < WINDOW {
            return None;
        }
        let [a, b] = self.halves;
        *self = Self::default();
        let n = a.count + b.count;
        if n < FEWEST || a.count == 0.0 || b.count == 0.0 {
            return None;
        }
        let quiet = |k: usize, variance: f64| {
            let mean = (a.sum[k] + b.sum[k]) / n;
            let scatter =
                (a.squares[k] + b.squares[k] - n * mean.norm_squared()) / (3.0 * (n - 1.0));
            let drift = (a.sum[k] / a.count - b.sum[k] / b.count).norm_squared() / 3.0;
            (scatter < 1.5 * variance && drift < 12.0 * variance / n).then_some(mean)
        };
        quiet(0, variances.force)?;
        Some(quiet(1, variances.rate)? + origin.angular_velocity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VARIANCES: Densities = Densities { force: 4e-4, rate: 1e-4 };

    fn found(rate: f64, swing: f64) -> usize {
        let mut stationary = Stationary::default();
        let dt = 1.0 / rate;
        let steps = (4.0 * rate) as usize;
        (0..steps)
            .filter(|i| {
                let t = *i as f64 * dt;
                // A deterministic stand-in for white noise of variance 1.
                let noise = |k: usize| 1.2 * ((i * 7919 + k * 104_729) as f64 * 0.618).sin();
                let reading = ImuReading {
                    specific_force: Vector3::new(noise(1), noise(2), 9.81 + noise(3)) * 0.02,
                    angular_velocity: Vector3::new(swing * (3.0 * t).sin(), 0.0, 0.0)
                        + Vector3::new(noise(4), noise(5), noise(6)) * 0.01,
                };
                stationary.add(&reading, dt, &VARIANCES).is_some()
            })
            .count()
    }

    #[test]
    fn the_window_is_half_a_second_at_any_rate() {
        for rate in [50.0, 100.0, 286.0, 1000.0] {
            assert!((6..=8).contains(&found(rate, 0.0)), "{rate}: {}", found(rate, 0.0));
            assert_eq!(found(rate, 0.3), 0, "{rate}");
        }
    }
}
