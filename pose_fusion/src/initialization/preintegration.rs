//! Motion from IMU readings alone, relative to the first reading, with its derivatives by the
//! biases (Forster et al. 2017, "On-manifold preintegration", without noise terms).

use crate::ekf::propagation::ImuReading;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use rig_model::Stamp;

/// Rotation, velocity and position relative to the first reading, in its axes and without gravity.
#[derive(Clone, Copy, Debug, Default)]
pub struct Preintegrated {
    /// Time.
    pub stamp: Stamp,
    /// Reading at that time.
    pub reading: ImuReading,
    /// Rotation `first_from_this`.
    pub rotation: UnitQuaternion<f64>,
    /// Velocity, m/s.
    pub velocity: Vector3<f64>,
    /// Position, m.
    pub position: Vector3<f64>,
    /// Derivative of the rotation (first axes) by the gyroscope bias, s.
    pub rotation_by_gyroscope: Matrix3<f64>,
    /// Derivatives of the velocity by gyroscope and accelerometer bias.
    pub velocity_by: [Matrix3<f64>; 2],
    /// Derivatives of the position by gyroscope and accelerometer bias.
    pub position_by: [Matrix3<f64>; 2],
}

impl Preintegrated {
    /// Starts at a reading.
    pub fn first(stamp: Stamp, reading: ImuReading) -> Self {
        Self { stamp, reading, ..Self::default() }
    }

    /// Returns the motion up to a later reading, with the readings as linear in between.
    pub fn to(&self, stamp: Stamp, reading: &ImuReading) -> Self {
        let dt = stamp.seconds_since(self.stamp);
        let mean = self.reading.lerp(reading, 0.5);
        let half = UnitQuaternion::from_scaled_axis(mean.angular_velocity * (dt / 2.0));
        let middle = self.rotation * half;
        let rotation: Matrix3<f64> = *middle.to_rotation_matrix().matrix();
        let force = rotation * mean.specific_force;
        // Global rotation error: a force error is −[force]× times it.
        let by_rotation = -force.cross_matrix();
        let velocity_step = [by_rotation * self.rotation_by_gyroscope * dt, -rotation * dt];
        let mut next = *self;
        next.stamp = stamp;
        next.reading = *reading;
        next.position += self.velocity * dt + force * (dt * dt / 2.0);
        next.velocity += force * dt;
        next.rotation = middle * half;
        next.rotation_by_gyroscope -= rotation * dt;
        for (k, step) in velocity_step.into_iter().enumerate() {
            next.position_by[k] += self.velocity_by[k] * dt + step * (dt / 2.0);
            next.velocity_by[k] += step;
        }
        next
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(gyroscope_bias: Vector3<f64>, accelerometer_bias: Vector3<f64>) -> Preintegrated {
        let at = |i: i64| {
            let t = i as f64 * 0.01;
            ImuReading {
                specific_force: Vector3::new(2.0 * (3.0 * t).sin(), 0.5, 9.8) - accelerometer_bias,
                angular_velocity: Vector3::new((3.0 * t).cos(), 0.4 * t, -0.2) - gyroscope_bias,
            }
        };
        let stamp = |i: i64| Stamp::from_nanos(i * 10_000_000);
        (1..100).fold(Preintegrated::first(stamp(0), at(0)), |p, i| p.to(stamp(i), &at(i)))
    }

    #[test]
    fn the_derivatives_by_the_biases_are_the_numerical_ones() {
        let zero = Vector3::zeros();
        let base = run(zero, zero);
        let h = 1e-5;
        for axis in 0..3 {
            let e = Vector3::ith(axis, h);
            for (k, moved) in [run(e, zero), run(zero, e)].into_iter().enumerate() {
                for (change, by) in [
                    (moved.velocity - base.velocity, &base.velocity_by[k]),
                    (moved.position - base.position, &base.position_by[k]),
                ] {
                    let numeric = change / h;
                    let error = (numeric - by.column(axis)).norm();
                    assert!(error < 0.03 * numeric.norm(), "{k} {axis}: {error}");
                }
            }
            let turned = (run(e, zero).rotation * base.rotation.inverse()).scaled_axis() / h;
            assert!((turned - base.rotation_by_gyroscope.column(axis)).norm() < 1e-2);
        }
    }
}
