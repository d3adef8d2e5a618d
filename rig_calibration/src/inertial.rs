//! Preintegration of IMU samples between two images (Lupton and Sukkarieh).

use crate::parameters::SensorErrors;
use nalgebra::{UnitQuaternion, Vector3};

/// Samples: time (s), specific force (m/s²), angular velocity (rad/s).
pub type Samples = [(f64, Vector3<f64>, Vector3<f64>)];

/// Change of attitude, velocity and position in the IMU frame at the start, without gravity.
#[derive(Clone, Copy, Debug)]
pub struct Change {
    /// Rotation start_from_end.
    pub rotation: UnitQuaternion<f64>,
    /// Change of velocity, m/s.
    pub velocity: Vector3<f64>,
    /// Change of position, m.
    pub position: Vector3<f64>,
    /// Duration, s.
    pub duration: f64,
}

/// Integrates from `from` to `to` (s, the IMU's clock) with the sensor's errors removed, by
/// the midpoint rule.
pub fn integrate(samples: &Samples, from: f64, to: f64, errors: &SensorErrors) -> Change {
    let mut change = Change {
        rotation: UnitQuaternion::identity(),
        velocity: Vector3::zeros(),
        position: Vector3::zeros(),
        duration: to - from,
    };
    let mut index = samples.partition_point(|s| s.0 <= from).clamp(1, samples.len() - 1);
    let mut time = from;
    while time < to - 1e-9 {
        let (a, b) = (&samples[index - 1], &samples[index]);
        let end = if index + 1 < samples.len() { b.0.min(to) } else { to };
        let middle = ((0.5 * (time + end) - a.0) / (b.0 - a.0)).clamp(-1.0, 2.0);
        let dt = end - time;
        let force = a.1 + (b.1 - a.1) * middle - errors.force_bias;
        let force = force.component_div(&errors.force_scale);
        let rate = a.2 + (b.2 - a.2) * middle - errors.rate_bias;
        let rate = rate.component_div(&errors.rate_scale);
        let half = UnitQuaternion::from_scaled_axis(rate * (0.5 * dt));
        let acceleration = change.rotation * half * force;
        change.position += change.velocity * dt + acceleration * (0.5 * dt * dt);
        change.velocity += acceleration * dt;
        change.rotation *= UnitQuaternion::from_scaled_axis(rate * dt);
        time = end;
        index = (index + 1).min(samples.len() - 1);
    }
    change
}
