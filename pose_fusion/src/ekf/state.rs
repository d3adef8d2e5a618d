//! State of the error-state Kalman filter, its error and their composition. The error is that at
//! the instant which the camera's stamp names, and that of the attitude is global: see
//! `docs/src/equations.md`, "State".

use super::{
    calibration::Calibration,
    consider::{Sensitivity, TIME_OFFSET_ERROR},
    propagation::ImuReading,
};
use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3};

/// Dimension of the error state.
pub const N: usize = 25;
/// First index of the position error.
pub const POSITION: usize = 0;
/// First index of the velocity error.
pub const VELOCITY: usize = 3;
/// First index of the attitude error.
pub const ATTITUDE: usize = 6;
/// First index of the accelerometer bias error.
pub const ACCELEROMETER_BIAS: usize = 9;
/// First index of the gyroscope bias error.
pub const GYROSCOPE_BIAS: usize = 12;
/// First index of the climber's x, y and turn errors.
pub const CLIMBER: usize = 15;
/// First index of the climber's rate errors.
pub const CLIMBER_RATE: usize = 18;
/// First index of the climber's acceleration errors.
pub const CLIMBER_ACCELERATION: usize = 21;
/// Index of the camera time offset error.
pub const TIME_OFFSET: usize = 24;

/// Covariance of the error state.
pub type Covariance = SMatrix<f64, N, N>;
/// Error state.
pub type Error = SVector<f64, N>;

/// Nominal state with the covariance of its error.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State {
    /// Position of the IMU, world, m.
    pub position: Vector3<f64>,
    /// Velocity of the IMU, world, m/s.
    pub velocity: Vector3<f64>,
    /// Attitude `world_from_imu`.
    pub attitude: UnitQuaternion<f64>,
    /// Accelerometer bias, IMU axes, m/s².
    pub accelerometer_bias: Vector3<f64>,
    /// Gyroscope bias, IMU axes, rad/s.
    pub gyroscope_bias: Vector3<f64>,
    /// x, y (m) and turn (rad) of the climber.
    pub climber: Vector3<f64>,
    /// Rates of x, y, turn, per s.
    pub climber_rate: Vector3<f64>,
    /// Accelerations of x, y, turn, per s².
    pub climber_acceleration: Vector3<f64>,
    /// Camera time offset, s (image time + offset = IMU time).
    pub time_offset: f64,
    /// Covariance of the error state.
    pub covariance: Covariance,
    /// Sensitivity of the error state to the consider parameters.
    pub sensitivity: Sensitivity,
    /// Estimated constants of the IMU and of the marker layout.
    pub calibration: Calibration,
}

impl State {
    /// Returns a state with all values and variances zero.
    pub fn zero() -> Self {
        Self::default()
    }

    /// Returns a reading without the biases.
    pub fn unbiased(&self, reading: &ImuReading) -> ImuReading {
        ImuReading {
            specific_force: reading.specific_force - self.accelerometer_bias,
            angular_velocity: reading.angular_velocity - self.gyroscope_bias,
        }
    }

    /// Returns the specific force (m/s²) and angular velocity (rad/s) of a reading, IMU axes.
    pub fn motion(&self, reading: &ImuReading) -> ImuReading {
        self.calibration.motion(&self.unbiased(reading))
    }

    /// Adds an error to the nominal state (⊞). The covariance stays.
    pub fn add(&mut self, error: &Error) {
        let three = |i: usize| Vector3::new(error[i], error[i + 1], error[i + 2]);
        self.position += three(POSITION);
        self.velocity += three(VELOCITY);
        self.attitude = UnitQuaternion::from_scaled_axis(three(ATTITUDE)) * self.attitude;
        self.attitude.renormalize_fast();
        self.accelerometer_bias += three(ACCELEROMETER_BIAS);
        self.gyroscope_bias += three(GYROSCOPE_BIAS);
        self.climber += three(CLIMBER);
        self.climber_rate += three(CLIMBER_RATE);
        self.climber_acceleration += three(CLIMBER_ACCELERATION);
        self.time_offset += error[TIME_OFFSET];
    }

    /// Returns a state of which one entry of the error is moved.
    #[cfg(test)]
    pub fn moved(&self, index: usize, by: f64) -> State {
        let mut moved = self.clone();
        moved.add(&Error::from_fn(|i, _| if i == index { by } else { 0.0 }));
        moved
    }

    /// Returns `self ⊟ other`, the error that leads from `other` to `self`.
    pub fn minus(&self, other: &State) -> Error {
        let mut e = Error::zeros();
        let mut put = |i: usize, v: Vector3<f64>| e.fixed_rows_mut::<3>(i).copy_from(&v);
        put(POSITION, self.position - other.position);
        put(VELOCITY, self.velocity - other.velocity);
        put(ATTITUDE, (self.attitude * other.attitude.inverse()).scaled_axis());
        put(ACCELEROMETER_BIAS, self.accelerometer_bias - other.accelerometer_bias);
        put(GYROSCOPE_BIAS, self.gyroscope_bias - other.gyroscope_bias);
        put(CLIMBER, self.climber - other.climber);
        put(CLIMBER_RATE, self.climber_rate - other.climber_rate);
        put(CLIMBER_ACCELERATION, self.climber_acceleration - other.climber_acceleration);
        e[TIME_OFFSET] = self.time_offset - other.time_offset;
        e
    }

    /// Moves the nominal state by `−seconds` along its own motion: the time offset was corrected by
    /// `seconds`, so that what was known at the camera's instant belongs to a later instant of the
    /// IMU's time line. `reading` is the IMU's at the state, `gravity` in m/s².
    pub fn shift_time(&mut self, reading: &ImuReading, seconds: f64, gravity: f64) {
        if seconds == 0.0 {
            return;
        }
        self.add(&(self.rates(reading, gravity) * -seconds));
    }

    /// Returns the derivative of the nominal state by time: velocity and acceleration (m/s, m/s²),
    /// angular velocity about world axes (rad/s), velocity and acceleration of the climber; zero
    /// for the rest. `reading` is the IMU's at the state, `gravity` in m/s².
    pub fn rates(&self, reading: &ImuReading, gravity: f64) -> Error {
        let motion = self.motion(reading);
        let weight = Vector3::new(0.0, 0.0, gravity);
        let mut rates = Error::zeros();
        let mut put = |i: usize, v: Vector3<f64>| rates.fixed_rows_mut::<3>(i).copy_from(&v);
        put(POSITION, self.velocity);
        put(VELOCITY, self.attitude * motion.specific_force - weight);
        put(ATTITUDE, self.attitude * motion.angular_velocity);
        put(CLIMBER, self.climber_rate);
        put(CLIMBER_RATE, self.climber_acceleration);
        rates
    }

    /// Returns whether every number is finite and every variance not negative.
    pub fn is_finite(&self) -> bool {
        let vectors = [
            &self.position,
            &self.velocity,
            &self.accelerometer_bias,
            &self.gyroscope_bias,
            &self.climber,
            &self.climber_rate,
            &self.climber_acceleration,
        ];
        vectors.into_iter().flatten().chain(self.attitude.coords.iter()).all(|x| x.is_finite())
            && self.time_offset.is_finite()
            && (0..N).all(|i| self.covariance[(i, i)] >= 0.0)
            && self.covariance.sum().is_finite()
            && self.sensitivity.sum().is_finite()
            && self.calibration.covariance().sum().is_finite()
    }

    /// Returns the standard deviation of one entry of the error.
    pub fn sigma(&self, index: usize) -> f64 {
        self.covariance[(index, index)].max(0.0).sqrt()
    }

    /// Returns the standard deviations of three entries of the error from `first` on.
    pub fn sigmas(&self, first: usize) -> Vector3<f64> {
        Vector3::from_fn(|i, _| self.sigma(first + i))
    }

    /// Sets three standard deviations and clears their correlations and sensitivities.
    pub fn set_sigmas(&mut self, first: usize, sigmas: &Vector3<f64>) {
        for i in 0..3 {
            self.set_sigma(first + i, sigmas[i]);
        }
    }

    /// Gives the time offset a new error, which affects no other entry of the state yet.
    pub fn forget_time_offset_error(&mut self) {
        self.sensitivity.row_mut(TIME_OFFSET_ERROR).fill(0.0);
        self.sensitivity[(TIME_OFFSET_ERROR, TIME_OFFSET)] = 1.0;
    }

    /// Adds uncertainty of the climber along an axis (0: x, 1: y, 2: turn): `error` of its place (m
    /// or rad, 1 sigma) and `rate` of its rate (per s). The platform is moved with it: what images
    /// show of the two stays as certain as it was.
    pub fn loosen_climber(&mut self, axis: usize, error: f64, rate: f64) {
        let (mut place, mut motion) = (Error::zeros(), Error::zeros());
        let moved = if axis < 2 {
            Vector3::ith(axis, 1.0)
        } else {
            place[ATTITUDE + 2] = 1.0;
            Vector3::z().cross(&(self.position - self.climber.xy().push(0.0)))
        };
        place.fixed_rows_mut::<3>(POSITION).copy_from(&moved);
        motion.fixed_rows_mut::<3>(VELOCITY).copy_from(&moved);
        (place[CLIMBER + axis], motion[CLIMBER_RATE + axis]) = (1.0, 1.0);
        self.covariance += place * place.transpose() * (error * error);
        self.covariance += motion * motion.transpose() * (rate * rate);
    }

    /// Sets the standard deviation of one entry and clears its correlations and sensitivities.
    pub fn set_sigma(&mut self, index: usize, sigma: f64) {
        self.covariance.row_mut(index).fill(0.0);
        self.covariance.column_mut(index).fill(0.0);
        self.sensitivity.column_mut(index).fill(0.0);
        self.covariance[(index, index)] = sigma * sigma;
        if index == TIME_OFFSET {
            self.sensitivity[(TIME_OFFSET_ERROR, TIME_OFFSET)] = 1.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn minus_is_the_inverse_of_add() {
        let mut a = State::zero();
        a.attitude = UnitQuaternion::from_euler_angles(0.3, -0.2, 1.1);
        let error =
            Error::from_fn(|i, _| 0.01 * (i as f64 + 1.0) * if i % 2 == 0 { 1.0 } else { -1.0 });
        let mut b = a.clone();
        b.add(&error);
        assert!((b.minus(&a) - error).norm() < 1e-12);
    }

    #[test]
    fn a_loose_climber_takes_the_platform_with_it() {
        for axis in 0..3 {
            let mut state = State::zero();
            state.position = Vector3::new(0.7, -0.2, 1.3);
            state.climber = Vector3::new(0.5, 0.1, 0.0);
            state.loosen_climber(axis, 0.3, 0.1);
            // The platform as the camera sees it: beside the climber, about its axis.
            let seen = |state: &State| {
                let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -state.climber.z);
                let beside = turn * (state.position - state.climber.xy().push(0.0));
                beside + (turn * state.attitude).scaled_axis()
            };
            let root = 1e-4 * state.covariance.fixed_view::<N, 3>(0, CLIMBER) / 0.3;
            let mut moved = state.clone();
            moved.add(&root.column(axis).into_owned());
            assert!((seen(&moved) - seen(&state)).norm() < 1e-8, "{axis}");
            assert!((state.sigma(CLIMBER + axis) - 0.3).abs() < 1e-12);
            assert!((state.sigma(CLIMBER_RATE + axis) - 0.1).abs() < 1e-12);
        }
    }

    #[test]
    fn one_non_finite_number_anywhere_is_found() {
        let spoil: [fn(&mut State); 6] = [
            |s| s.velocity.y = f64::NAN,
            |s| s.gyroscope_bias.x = f64::INFINITY,
            |s| s.climber_acceleration.z = f64::NAN,
            |s| s.time_offset = f64::NAN,
            |s| s.covariance[(3, 20)] = f64::NAN,
            |s| s.covariance[(7, 7)] = -1e-9,
        ];
        assert!(State::zero().is_finite());
        for change in spoil {
            let mut state = State::zero();
            change(&mut state);
            assert!(!state.is_finite());
        }
    }
}
