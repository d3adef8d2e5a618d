//! Checkpoint: everything the filter knows at an instant, as plain numbers.

use crate::ekf::{
    calibration::{CONSTANTS, Calibration},
    consider,
    state::{N, State},
};
use nalgebra::{Cholesky, Const, Quaternion, SMatrix, UnitQuaternion, Vector3};
use rig_model::Stamp;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Version of the format.
const VERSION: u32 = 3;

/// State and covariance in SI units (see [`crate::ekf::state`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Checkpoint {
    /// Version of the format: 3.
    pub version: u32,
    /// IMU time, ns.
    pub stamp_ns: i64,
    /// Position of the IMU, world.
    pub position: [f64; 3],
    /// Velocity of the IMU, world.
    pub velocity: [f64; 3],
    /// `world_from_imu`: x, y, z, w.
    pub attitude: [f64; 4],
    /// Accelerometer bias, IMU axes.
    pub accelerometer_bias: [f64; 3],
    /// Gyroscope bias, IMU axes.
    pub gyroscope_bias: [f64; 3],
    /// x, y, turn of the climber; their rates; their accelerations.
    pub climber: [[f64; 3]; 3],
    /// Camera time offset.
    pub time_offset: f64,
    /// Covariance of the error, that of the constants included, row by row.
    pub covariance: Vec<f64>,
    /// Scale factors of gyroscope and accelerometer, rotations of both, rad; offsets of the
    /// markers' centers, x and y of red, green, blue, yellow, m.
    pub constants: [f64; CONSTANTS],
    /// Their covariance, row by row.
    pub constants_covariance: Vec<f64>,
}

/// Why an operator's request is refused.
#[derive(Clone, Debug, Error, PartialEq)]
#[allow(missing_docs, reason = "the message explains each variant and names its fields")]
pub enum Refusal {
    #[error("the filter is not initialized: there is nothing to save before its first pose")]
    NotInitialized,
    #[error("no message on {what} yet: start its publisher")]
    Missing { what: &'static str },
    #[error(
        "the stamp is {:.3} s {} the newest IMU sample, and the history reaches {limit_s:.1} s \
         back: stamp the pose with the present time, and synchronize the clocks",
        away_s.abs(),
        if away_s.is_sign_negative() { "ahead of" } else { "before" }
    )]
    OutOfReach { away_s: f64, limit_s: f64 },
    #[error("{what} is invalid: {why}")]
    Invalid { what: &'static str, why: &'static str },
}

impl Checkpoint {
    /// Returns the checkpoint of a state at an instant.
    pub fn of(state: &State, stamp: Stamp) -> Self {
        let q = state.attitude.coords;
        let by_constants = consider::of_constants(&state.sensitivity);
        let covariance = state.covariance
            + by_constants * state.calibration.covariance() * by_constants.transpose();
        let three = |v: &Vector3<f64>| [v.x, v.y, v.z];
        Self {
            version: VERSION,
            stamp_ns: stamp.as_nanos(),
            position: three(&state.position),
            velocity: three(&state.velocity),
            attitude: [q.x, q.y, q.z, q.w],
            accelerometer_bias: three(&state.accelerometer_bias),
            gyroscope_bias: three(&state.gyroscope_bias),
            climber: [&state.climber, &state.climber_rate, &state.climber_acceleration].map(three),
            time_offset: state.time_offset,
            covariance: covariance.as_slice().to_vec(),
            constants: state.calibration.constants().into(),
            constants_covariance: state.calibration.covariance().as_slice().to_vec(),
        }
    }

    /// Returns the state.
    ///
    /// # Errors
    /// Another version, a number that is not finite, an attitude of another norm than 1, an IMU
    /// constant beyond its limit, a covariance of another size or that is not symmetric and
    /// positive.
    pub fn state(&self) -> Result<State, Refusal> {
        let refuse = |what, why| Err(Refusal::Invalid { what, why });
        if self.version != VERSION {
            return refuse("the checkpoint", "it has another version");
        }
        let numbers =
            [&self.position, &self.velocity, &self.accelerometer_bias, &self.gyroscope_bias]
                .into_iter()
                .chain(&self.climber)
                .flatten()
                .chain(&self.attitude)
                .chain([&self.time_offset])
                .chain(&self.covariance)
                .chain(&self.constants)
                .chain(&self.constants_covariance);
        if !numbers.into_iter().all(|x| x.is_finite()) {
            return refuse("the checkpoint", "a number in it is not finite");
        }
        let [x, y, z, w] = self.attitude;
        let attitude = Quaternion::new(w, x, y, z);
        if (attitude.norm() - 1.0).abs() > 1e-3 {
            return refuse("the checkpoint's attitude", "its norm is not 1");
        }
        if !Calibration::within_limits(&self.constants.into()) {
            let why = "a constant is larger than 0.1, or a marker further off than 0.04 m";
            return refuse("the checkpoint's calibration", why);
        }
        let covariance = positive::<N>("the checkpoint's covariance", &self.covariance, 1e-9)?;
        // Kept in single precision.
        let of_constants = "the checkpoint's covariance of the constants";
        let of_constants = positive::<CONSTANTS>(of_constants, &self.constants_covariance, 1e-6)?;
        let [climber, rate, acceleration] = self.climber.map(Vector3::from);
        Ok(State {
            position: self.position.into(),
            velocity: self.velocity.into(),
            attitude: UnitQuaternion::from_quaternion(attitude),
            accelerometer_bias: self.accelerometer_bias.into(),
            gyroscope_bias: self.gyroscope_bias.into(),
            climber,
            climber_rate: rate,
            climber_acceleration: acceleration,
            time_offset: self.time_offset,
            covariance,
            calibration: Calibration::known(self.constants.into(), &of_constants),
            ..State::zero()
        })
    }
}

/// Returns a covariance from its rows, symmetric and positive within a relative `rounding`.
fn positive<const D: usize>(
    what: &'static str,
    rows: &[f64],
    rounding: f64,
) -> Result<SMatrix<f64, D, D>, Refusal> {
    if rows.len() != D * D {
        return Err(Refusal::Invalid { what, why: "it has another size" });
    }
    let matrix = SMatrix::<f64, D, D>::from_row_slice(rows);
    let limit = rounding * matrix.amax().max(1e-12);
    let asymmetric = (matrix - matrix.transpose()).amax() > limit;
    let raised = matrix + SMatrix::<f64, D, D>::identity() * limit;
    if asymmetric || Cholesky::<f64, Const<D>>::new(raised).is_none() {
        return Err(Refusal::Invalid { what, why: "it is not symmetric and positive" });
    }
    Ok((matrix + matrix.transpose()) * 0.5)
}
