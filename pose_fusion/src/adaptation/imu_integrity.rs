//! Integrity of IMU samples: rejection of impossible samples, and additional noise for suspicious
//! ones.

use crate::ekf::propagation::ImuReading;
use nalgebra::Vector3;

use super::imu_noise::Densities;

/// Sigmas of a second difference (which cancels a swing) from which it is an undersampled shock.
const JUMP_SIGMAS: f64 = 6.0;
/// Share of a jump that the integration may have missed, 1 sigma.
const MISSED: f64 = 0.5;
/// An axis that repeats its largest magnitude above this is saturated, m/s², rad/s.
const SATURATION: [f64; 2] = [15.0, 0.1];
/// Equal samples in a row that are no coincidence of a quantized peak.
const REPEATED: u32 = 3;
/// Motion that a saturated or stuck axis may hide, m/s², rad/s, 1 sigma: a fast swing.
const HIDDEN: [f64; 2] = [3.0, 2.0];
/// Relative scale error beside the estimated constants: nonlinearity.
const SCALE: f64 = 0.001;
/// Correlation time of what is hidden and of scale errors in a swing, s.
const CORRELATION: f64 = 0.3;
/// Samples that repeat all six values for this long are stuck, s.
const STUCK: f64 = 0.05;
/// Time constant of the mean specific force, whose scale error the bias absorbs, s.
const MEAN_FORCE: f64 = 5.0;
/// Largest reading, m/s², rad/s: the ranges of an MTx, 18 g and 2000°/s.
const LARGEST_FORCE: f64 = 180.0;
const LARGEST_RATE: f64 = 40.0;

/// Memory of the previous sample and of the mean force.
#[derive(Clone, Debug, Default)]
pub struct ImuIntegrity {
    previous: Option<ImuReading>,
    before: Option<ImuReading>,
    mean_force: Option<Vector3<f64>>,
    /// Time for which all six values have been repeated, s.
    pub unchanged: f64,
    /// The last reading was saturated or stuck.
    pub hides_motion: bool,
    /// Largest magnitude of each axis, and how often it was repeated: force, rate.
    peaks: [[(f64, u32); 3]; 2],
}

impl ImuIntegrity {
    /// Checks a reading against the range of an IMU.
    ///
    /// # Errors
    /// What is not finite or beyond the range of any IMU; a disconnected sensor outputs zeros.
    pub fn check(reading: &ImuReading) -> Result<(), &'static str> {
        let within =
            |v: &Vector3<f64>, most: f64| v.iter().all(|x| x.is_finite() && x.abs() <= most);
        if !within(&reading.specific_force, LARGEST_FORCE) {
            Err("linear_acceleration")
        } else if !within(&reading.angular_velocity, LARGEST_RATE) {
            Err("angular_velocity")
        } else if *reading == ImuReading::default() {
            Err("every value is zero: linear_acceleration")
        } else {
            Ok(())
        }
    }

    /// Returns the densities of the IMU's nonlinearity, which grows with rate and specific force,
    /// in the step of `dt` seconds to this reading.
    pub fn nonlinearity(&mut self, reading: &ImuReading, dt: f64) -> Densities {
        let mean = *self.mean_force.get_or_insert(reading.specific_force);
        let share = (dt / MEAN_FORCE).clamp(0.0, 1.0);
        self.mean_force = Some(mean + (reading.specific_force - mean) * share);
        Densities {
            force: (SCALE * (reading.specific_force - mean).norm()).powi(2) * CORRELATION,
            rate: (SCALE * reading.angular_velocity.norm()).powi(2) * CORRELATION,
        }
    }

    /// Returns the additional densities of the step of `dt` seconds to this reading: shocks between
    /// samples, saturated and stuck values. `variances` are those of one sample, (m/s²)² and
    /// (rad/s)².
    pub fn additional(
        &mut self,
        reading: &ImuReading,
        dt: f64,
        variances: &Densities,
    ) -> Densities {
        let mut more = Densities::default();
        let Some(previous) = self.previous.replace(*reading) else { return more };
        if let Some(before) = self.before.replace(previous) {
            let jump = |of: fn(&ImuReading) -> Vector3<f64>, variance: f64| {
                let bend = (of(reading) - of(&previous)) - (of(&previous) - of(&before));
                // Second differences of white noise have six times its variance.
                let limit = JUMP_SIGMAS * JUMP_SIGMAS * 6.0 * variance;
                let square = bend.map(|c| if c * c > limit { c * c } else { 0.0 }).sum();
                MISSED * MISSED * square * dt
            };
            more.force += jump(|r| r.specific_force, variances.force);
            more.rate += jump(|r| r.angular_velocity, variances.rate);
        }
        self.unchanged = if *reading == previous { self.unchanged + dt } else { 0.0 };
        let stuck = self.unchanged > STUCK;
        let saturated = [
            self.is_saturated(0, &previous.specific_force, &reading.specific_force),
            self.is_saturated(1, &previous.angular_velocity, &reading.angular_velocity),
        ];
        self.hides_motion = stuck || saturated[0] || saturated[1];
        if stuck || saturated[0] {
            more.force += HIDDEN[0].powi(2) * CORRELATION;
        }
        if stuck || saturated[1] {
            more.rate += HIDDEN[1].powi(2) * CORRELATION;
        }
        more
    }

    fn is_saturated(
        &mut self,
        signal: usize,
        previous: &Vector3<f64>,
        values: &Vector3<f64>,
    ) -> bool {
        let mut saturated = false;
        for (axis, (peak, count)) in self.peaks[signal].iter_mut().enumerate() {
            let (magnitude, before) = (values[axis].abs(), previous[axis].abs());
            // A single sample may be an error of the transmission.
            *peak = peak.max(magnitude.min(before));
            *count = if magnitude == *peak { *count + 1 } else { 0 };
            saturated |= *count + 1 >= REPEATED && magnitude > SATURATION[signal];
        }
        saturated
    }

    /// Discards the memory, after a gap.
    pub fn clear(&mut self) {
        *self = Self { mean_force: self.mean_force, peaks: self.peaks, ..Self::default() };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const VARIANCES: Densities = Densities { force: 4e-4, rate: 7.6e-5 };

    fn reading(force: f64, rate: f64) -> ImuReading {
        ImuReading {
            specific_force: Vector3::new(force, 0.1 * force, 9.8),
            angular_velocity: Vector3::new(rate, 0.05, 0.01 + 1e-3 * force),
        }
    }

    #[test]
    fn impossible_samples_are_rejected() {
        let force = Err("linear_acceleration");
        assert_eq!(ImuIntegrity::check(&reading(1.0, 0.3)), Ok(()));
        assert_eq!(ImuIntegrity::check(&reading(1000.0, 0.3)), force);
        assert_eq!(ImuIntegrity::check(&reading(f64::NAN, 0.3)), force);
        assert_eq!(ImuIntegrity::check(&reading(1.0, 50.0)), Err("angular_velocity"));
        assert!(ImuIntegrity::check(&ImuReading::default()).is_err());
    }

    #[test]
    fn shocks_saturation_and_stuck_values_raise_the_noise_and_calm_motion_does_not() {
        let mut integrity = ImuIntegrity::default();
        let mut next = |r: ImuReading| integrity.additional(&r, 0.01, &VARIANCES);
        next(reading(0.0, 0.29));
        next(reading(0.02, 0.3));
        let calm = next(reading(0.05, 0.31));
        assert!(calm.force < 1e-7 && calm.rate < 1e-6, "{calm:?}");
        let shock = next(reading(20.0, 0.32));
        assert!(shock.force > 0.9, "{shock:?}");
        // A single sample that was larger is no end of the range.
        next(reading(0.0, 3.0));
        next(reading(0.0, 0.5));
        next(reading(0.03, 0.5));
        let saturated = next(reading(0.01, 0.5));
        assert!(saturated.rate > 1.0 && saturated.force < 1.1, "{saturated:?}");
        let stuck = (0..10).map(|_| next(reading(0.02, 0.05))).last().unwrap();
        assert!(stuck.rate > 1.0 && stuck.force > 1.0, "{stuck:?}");
    }

    #[test]
    fn a_scale_error_counts_in_proportion_to_the_motion() {
        let mut integrity = ImuIntegrity::default();
        let slow = integrity.nonlinearity(&reading(0.0, 0.1), 0.01).rate;
        let fast = integrity.nonlinearity(&reading(0.01, 3.0), 0.0).rate;
        assert!(fast > 300.0 * slow, "{slow} {fast}");
    }
}
