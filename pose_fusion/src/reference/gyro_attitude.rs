//! Attitude of an IMU that does not compute one, for the published filter: the gyroscope
//! integrated, its tilt corrected by the accelerometer (Mahony, Hamel and Pflimlin 2008).
//! Equations: `docs/src/equations.md`, "The published filter".

use nalgebra::{UnitQuaternion, Vector3};
use rig_model::{ImuSample, Stamp};

/// Gain of the tilt correction, 1/s. Ten seconds of averaging are many swings of a rope (2 to 4 s)
/// and short against the drift of a MEMS gyroscope's bias.
const GAIN: f64 = 0.1;
/// A longer step between two samples starts over, s.
const LONGEST_STEP: f64 = 0.5;

/// Attitude of an IMU, from its samples.
#[derive(Clone, Debug, Default)]
pub struct GyroAttitude {
    newest: Option<(Stamp, Vector3<f64>, UnitQuaternion<f64>)>,
}

impl GyroAttitude {
    /// Takes in a finite sample and returns the rotation from IMU axes to axes with z up whose
    /// heading is arbitrary; `None` while the accelerometer reads nothing.
    pub fn update(&mut self, sample: &ImuSample) -> Option<UnitQuaternion<f64>> {
        let up = sample.specific_force.try_normalize(1e-3);
        let step = |since: Stamp| sample.stamp.seconds_since(since);
        let attitude = match &self.newest {
            Some((stamp, rate, attitude)) if (0.0..LONGEST_STEP).contains(&step(*stamp)) => {
                let dt = step(*stamp);
                let mean = (rate + sample.angular_velocity) / 2.0;
                let turned = attitude * UnitQuaternion::from_scaled_axis(mean * dt);
                let estimated = turned.inverse() * Vector3::z();
                let correction = up.map_or(Vector3::zeros(), |up| up.cross(&estimated)) * GAIN;
                turned * UnitQuaternion::from_scaled_axis(correction * dt)
            }
            _ => UnitQuaternion::rotation_between(&up?, &Vector3::z()).unwrap_or_else(|| {
                UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI)
            }),
        };
        self.newest = Some((sample.stamp, sample.angular_velocity, attitude));
        Some(attitude)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rolled by `ROLL`, turning about its own z axis.
    const ROLL: f64 = 0.3;
    const RATE: f64 = 0.5;

    fn sample(seconds: f64, bias: Vector3<f64>) -> (ImuSample, UnitQuaternion<f64>) {
        let world_from_imu = UnitQuaternion::from_euler_angles(ROLL, 0.0, 0.0)
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), RATE * seconds);
        let sample = ImuSample {
            stamp: Stamp::from_nanos(0).plus_seconds(seconds),
            specific_force: world_from_imu.inverse() * Vector3::new(0.0, 0.0, 9.81),
            angular_velocity: Vector3::new(0.0, 0.0, RATE) + bias,
            orientation: None,
        };
        (sample, world_from_imu)
    }

    /// Angle between the true "up" and that of an estimate, rad.
    fn tilt_error(estimate: &UnitQuaternion<f64>, truth: &UnitQuaternion<f64>) -> f64 {
        (estimate.inverse() * Vector3::z()).angle(&(truth.inverse() * Vector3::z()))
    }

    #[test]
    fn a_turning_imu_keeps_its_attitude_and_gravity_bounds_the_tilt_that_a_bias_causes() {
        for bias in [0.0, 0.002] {
            let mut filter = GyroAttitude::default();
            for i in 0..10_000 {
                let (sample, truth) = sample(f64::from(i) * 0.01, Vector3::x() * bias);
                let attitude = filter.update(&sample).unwrap();
                let error = tilt_error(&attitude, &truth);
                assert!(
                    error < (2.0 * bias / GAIN).max(1e-6),
                    "sample {i}: tilt error {error} rad"
                );
                let exact = bias > 0.0 || attitude.angle_to(&truth) < 1e-6;
                assert!(exact, "sample {i}: {attitude}, truth {truth}");
            }
        }
    }

    #[test]
    fn free_fall_at_the_start_is_no_attitude_and_a_gap_restarts() {
        let mut filter = GyroAttitude::default();
        let (mut first, _) = sample(0.0, Vector3::zeros());
        first.specific_force = Vector3::zeros();
        assert_eq!(filter.update(&first), None);
        filter.update(&sample(1.0, Vector3::zeros()).0).unwrap();
        let (late, truth) = sample(9.0, Vector3::zeros());
        let tilt = tilt_error(&filter.update(&late).unwrap(), &truth);
        assert!(tilt < 1e-6, "{tilt}");
    }
}
