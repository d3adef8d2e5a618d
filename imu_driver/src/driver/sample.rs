//! Conversion of a measurement to a sample with the conventions of REP-145.

use crate::{
    orientation::{enu_from_imu, rotation_of},
    protocol::{Measurement, Status},
};
use nalgebra::Vector3;
use rig_model::{ImuSample, OrientationSample, Stamp};

/// Sample of the IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Time of measurement.
    pub stamp: Stamp,
    /// Specific force, angular velocity, orientation; `None` if one of the first two is missing.
    pub imu: Option<ImuSample>,
    /// Magnetic field in the sensor frame, arbitrary unit (about 1 in the Earth's field).
    pub magnetic_field: Option<Vector3<f64>>,
    /// Temperature, °C.
    pub temperature: Option<f64>,
    /// Status bits.
    pub status: Option<Status>,
    /// Message counter.
    pub counter: Option<u16>,
}

impl Sample {
    /// The same sample with another stamp.
    pub(super) fn stamped(mut self, stamp: Stamp) -> Self {
        self.stamp = stamp;
        if let Some(imu) = &mut self.imu {
            imu.stamp = stamp;
        }
        self
    }
}

fn finite(v: [f64; 3]) -> Option<Vector3<f64>> {
    v.iter().all(|x| x.is_finite()).then(|| Vector3::from(v))
}

/// Converts a measurement to a sample; non-finite values are omitted.
///
/// `periods` (s) of the increments of velocity and orientation convert them if the message has no
/// rates.
pub fn sample_of(m: &Measurement, stamp: Stamp, periods: [f64; 2]) -> Sample {
    let per_second = |v: [f64; 3]| v.map(|x| x / periods[0]);
    let specific_force = m
        .acceleration
        .or(m.acceleration_hr)
        .or_else(|| m.delta_velocity.map(per_second))
        .and_then(finite);
    let angular_velocity = m
        .angular_velocity
        .or(m.angular_velocity_hr)
        .and_then(finite)
        .or_else(|| Some(rotation_of(m.delta_orientation?)?.scaled_axis() / periods[1]))
        .filter(|rate| rate.iter().all(|x| x.is_finite()));
    let orientation = m.orientations[0]
        .as_ref()
        .and_then(enu_from_imu)
        .map(|enu_from_imu| OrientationSample { enu_from_imu, covariance: None });
    let imu = specific_force.zip(angular_velocity).map(|(specific_force, angular_velocity)| {
        ImuSample { stamp, specific_force, angular_velocity, orientation }
    });
    Sample {
        stamp,
        imu,
        magnetic_field: m.magnetic_field.and_then(finite),
        temperature: m.temperature.filter(|t| t.is_finite()),
        status: m.status,
        counter: m.counter,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    #[test]
    fn increments_become_rates_and_nan_is_omitted() {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.001, -0.002, 0.003));
        let m = Measurement {
            delta_velocity: Some([0.0, 0.0, 0.0981]),
            delta_orientation: Some([turn.w, turn.i, turn.j, turn.k]),
            ..Measurement::default()
        };
        let imu = sample_of(&m, Stamp::default(), [0.01, 0.02]).imu.unwrap();
        assert!((imu.specific_force.z - 9.81).abs() < 1e-12);
        assert!((imu.angular_velocity - Vector3::new(0.05, -0.1, 0.15)).norm() < 1e-9);
        let m =
            Measurement { delta_velocity: Some([f64::NAN; 3]), temperature: Some(f64::NAN), ..m };
        let sample = sample_of(&m, Stamp::default(), [0.01; 2]);
        assert_eq!((sample.imu, sample.temperature), (None, None));
    }
}
