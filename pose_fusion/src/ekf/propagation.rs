//! Propagation of the state from one instant to the next with inertial readings. Equations:
//! `docs/src/equations.md`, "Propagation".

use super::{
    calibration::Calibration,
    consider::{ESTIMATED, Sensitivity},
    state::{
        ACCELEROMETER_BIAS, ATTITUDE, CLIMBER, CLIMBER_ACCELERATION, CLIMBER_RATE, Covariance,
        GYROSCOPE_BIAS, N, POSITION, State, TIME_OFFSET, VELOCITY,
    },
    transition::{Blocks, times_transition},
};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use rig_model::ImuSample;

/// Specific force and angular velocity at an instant, IMU axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImuReading {
    /// Specific force, m/s².
    pub specific_force: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub angular_velocity: Vector3<f64>,
}

impl From<&ImuSample> for ImuReading {
    fn from(sample: &ImuSample) -> Self {
        Self { specific_force: sample.specific_force, angular_velocity: sample.angular_velocity }
    }
}

impl ImuReading {
    /// Interpolates linearly between `self` (share 0) and `other` (share 1).
    pub fn lerp(&self, other: &ImuReading, share: f64) -> ImuReading {
        ImuReading {
            specific_force: self.specific_force.lerp(&other.specific_force, share),
            angular_velocity: self.angular_velocity.lerp(&other.angular_velocity, share),
        }
    }

    /// Returns the reading of an IMU in uniform motion without rotation. `gravity` in m/s².
    pub fn of_uniform_motion(state: &State, gravity: f64) -> ImuReading {
        let specific_force = state.attitude.inverse() * Vector3::new(0.0, 0.0, gravity);
        let angular_velocity = Vector3::zeros();
        let reading = state.calibration.reading(&ImuReading { specific_force, angular_velocity });
        ImuReading {
            specific_force: reading.specific_force + state.accelerometer_bias,
            angular_velocity: reading.angular_velocity + state.gyroscope_bias,
        }
    }
}

/// Specific force (m/s²) and angular velocity (rad/s), IMU axes, whose changes make an error of the
/// time offset observable. In single precision: the history holds many.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Specific force, m/s².
    pub force: Vector3<f32>,
    /// Angular velocity, rad/s.
    pub rate: Vector3<f32>,
}

impl From<ImuReading> for Motion {
    fn from(reading: ImuReading) -> Self {
        Self {
            force: reading.specific_force.map(|x| x as f32),
            rate: reading.angular_velocity.map(|x| x as f32),
        }
    }
}

impl Motion {
    fn vectors(&self) -> [Vector3<f64>; 2] {
        [self.force.map(f64::from), self.rate.map(f64::from)]
    }

    /// Returns the change since `before`, less the shares of it that are noise.
    pub fn change_since(&self, before: &Motion, [force, rate]: [f64; 2]) -> Motion {
        Motion {
            force: (self.force - before.force) * (1.0 - force) as f32,
            rate: (self.rate - before.rate) * (1.0 - rate) as f32,
        }
    }
}

/// Power spectral densities of the process noise.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ProcessNoise {
    /// Of the specific force, (m/s²)²/Hz.
    pub force: f64,
    /// Of the angular velocity, (rad/s)²/Hz.
    pub rate: f64,
    /// Of the accelerometer bias' random walk, (m/s²)²/s.
    pub accelerometer_bias: f64,
    /// Of the gyroscope bias' random walk, (rad/s)²/s.
    pub gyroscope_bias: f64,
    /// Of the climber's jerk: x, y, (m/s³)²/Hz, turn, (rad/s³)²/Hz.
    pub jerk: Vector3<f64>,
    /// Of the time offset's random walk, s²/s.
    pub time_offset: f64,
    /// Change of the motion over the step without the share that is noise: the derivative of
    /// velocity and attitude by the time offset.
    pub change: Motion,
}

impl ProcessNoise {
    /// Returns the noise with more force, (m/s²)²/Hz, and angular velocity, (rad/s)²/Hz.
    pub fn plus(&self, force: f64, rate: f64) -> Self {
        Self { force: self.force + force, rate: self.rate + rate, ..*self }
    }
}

/// Propagates `state` by `dt` seconds with the readings at both ends. `gravity` in m/s².
pub fn propagate(
    state: &mut State,
    from: &ImuReading,
    to: &ImuReading,
    dt: f64,
    gravity: f64,
    noise: &ProcessNoise,
) {
    let mean = from.lerp(to, 0.5);
    let measured = state.unbiased(&mean);
    let ImuReading { specific_force: force, angular_velocity: rate } =
        state.calibration.motion(&measured);
    let half = UnitQuaternion::from_scaled_axis(rate * (dt / 2.0));
    let middle = state.attitude * half;
    let rotation = middle.to_rotation_matrix();
    let rotation: &Matrix3<f64> = rotation.matrix();
    let rate_change = to.angular_velocity - from.angular_velocity;
    let force_change = to.specific_force - from.specific_force;
    let sculling = (rate.cross(&force_change) - rate_change.cross(&force)) * (dt / 12.0)
        + rate.cross(&rate.cross(&force)) * (dt * dt / 24.0);
    // ω₀ × ω₁ = ω × Δω.
    let coning = UnitQuaternion::from_scaled_axis(rate.cross(&rate_change) * (dt * dt / 12.0));
    let moved = rotation * (force + sculling);
    let acceleration = Vector3::new(moved.x, moved.y, moved.z - gravity);
    let force = rotation * force;
    state.position += state.velocity * dt + acceleration * (dt * dt / 2.0);
    state.velocity += acceleration * dt;
    state.attitude = middle * half * coning;
    state.attitude.renormalize_fast();
    state.climber += state.climber_rate * dt + state.climber_acceleration * (dt * dt / 2.0);
    state.climber_rate += state.climber_acceleration * dt;
    let blocks = Blocks::new(rotation, &force, dt, noise.change.vectors());
    // F P Fᵀ as ((P Fᵀ)ᵀ Fᵀ): columns only, which are contiguous in memory; P is symmetric.
    times_transition(&mut state.covariance, &blocks, dt);
    state.covariance.transpose_mut();
    times_transition(&mut state.covariance, &blocks, dt);
    symmetrize(&mut state.covariance);
    add_noise(&mut state.covariance, dt, noise);
    times_transition(&mut state.sensitivity, &blocks, dt);
    drive_sensitivity(&mut state.sensitivity, rotation, &measured, dt);
}

/// Returns the transition matrix `F` of the error over a step of `dt` seconds.
pub fn transition(
    state: &State,
    from: &ImuReading,
    to: &ImuReading,
    dt: f64,
    noise: &ProcessNoise,
) -> Covariance {
    let mean = from.lerp(to, 0.5);
    let motion = state.motion(&mean);
    let half = UnitQuaternion::from_scaled_axis(motion.angular_velocity * (dt / 2.0));
    let rotation = (state.attitude * half).to_rotation_matrix();
    let rotation: &Matrix3<f64> = rotation.matrix();
    let force = rotation * motion.specific_force;
    let mut f = Covariance::identity();
    times_transition(&mut f, &Blocks::new(rotation, &force, dt, noise.change.vectors()), dt);
    f.transpose()
}

/// Removes asymmetry by rounding, with which a variance would be negative after an hour.
fn symmetrize(p: &mut Covariance) {
    for j in 0..N {
        for i in j + 1..N {
            let mean = 0.5 * (p[(i, j)] + p[(j, i)]);
            p[(i, j)] = mean;
            p[(j, i)] = mean;
        }
    }
}

/// Adds the motion that the constants of the IMU hide in a step from its readings without bias.
fn drive_sensitivity(
    sensitivity: &mut Sensitivity,
    rotation: &Matrix3<f64>,
    measured: &ImuReading,
    dt: f64,
) {
    let mut add = |row: usize, column: usize, by: Matrix3<f64>| {
        let mut block = sensitivity.fixed_view_mut::<3, 3>(ESTIMATED + column, row);
        block += by.transpose().map(|x| x as f32);
    };
    for (k, by) in Calibration::derivative(0, rotation, &measured.angular_velocity) {
        add(ATTITUDE, k, by * dt);
    }
    for (k, by) in Calibration::derivative(1, rotation, &measured.specific_force) {
        add(VELOCITY, k, by * dt);
        add(POSITION, k, by * (0.5 * dt * dt));
    }
}

fn add_noise(p: &mut Covariance, dt: f64, noise: &ProcessNoise) {
    let (dt2, dt3) = (dt * dt, dt * dt * dt);
    for i in 0..3 {
        let mut add = |i: usize, j: usize, x: f64| {
            p[(i, j)] += x;
            if i != j {
                p[(j, i)] += x;
            }
        };
        add(POSITION + i, POSITION + i, noise.force * dt3 / 3.0);
        add(POSITION + i, VELOCITY + i, noise.force * dt2 / 2.0);
        add(VELOCITY + i, VELOCITY + i, noise.force * dt);
        add(ATTITUDE + i, ATTITUDE + i, noise.rate * dt);
        add(ACCELEROMETER_BIAS + i, ACCELEROMETER_BIAS + i, noise.accelerometer_bias * dt);
        add(GYROSCOPE_BIAS + i, GYROSCOPE_BIAS + i, noise.gyroscope_bias * dt);
        let (c, r, a) = (CLIMBER + i, CLIMBER_RATE + i, CLIMBER_ACCELERATION + i);
        let q = noise.jerk[i];
        add(c, c, q * dt2 * dt3 / 20.0);
        add(c, r, q * dt2 * dt2 / 8.0);
        add(c, a, q * dt3 / 6.0);
        add(r, r, q * dt3 / 3.0);
        add(r, a, q * dt2 / 2.0);
        add(a, a, q * dt);
    }
    p[(TIME_OFFSET, TIME_OFFSET)] += noise.time_offset * dt;
}

#[cfg(test)]
mod tests {
    use super::{
        super::calibration::{CONSTANTS, Constants},
        *,
    };
    use nalgebra::SMatrix;

    fn example() -> (State, ImuReading) {
        let mut s = State::zero();
        s.attitude = UnitQuaternion::from_euler_angles(0.3, -0.2, 1.1);
        s.velocity = Vector3::new(0.4, -0.2, 0.1);
        s.accelerometer_bias = Vector3::new(0.02, -0.01, 0.03);
        s.gyroscope_bias = Vector3::new(0.01, 0.02, -0.01);
        s.climber_rate = Vector3::new(0.3, 0.1, -0.2);
        s.climber_acceleration = Vector3::new(-0.1, 0.2, 0.05);
        let reading = ImuReading {
            specific_force: Vector3::new(0.5, -1.0, 9.6),
            angular_velocity: Vector3::new(1.0, -2.0, 0.5),
        };
        (s, reading)
    }

    #[test]
    fn rotation_during_a_step_is_integrated_as_in_twenty_small_steps() {
        let (start, _) = example();
        let noise = ProcessNoise::default();
        // Half a second of an elliptic swing at 1 Hz, 100 readings per second.
        let reading_at = |t: f64| {
            let angle = std::f64::consts::TAU * t;
            ImuReading {
                angular_velocity: Vector3::new(3.5 * angle.cos(), 2.5 * angle.sin(), 0.3),
                specific_force: Vector3::new(
                    2.0 * angle.sin(),
                    -3.0 * angle.cos(),
                    11.0 + 3.0 * (2.0 * angle).cos(),
                ),
            }
        };
        let (mut coarse, mut fine) = (start.clone(), start);
        for k in 0..50 {
            let (from, to) = (reading_at(f64::from(k) * 0.01), reading_at(f64::from(k + 1) * 0.01));
            propagate(&mut coarse, &from, &to, 0.01, 9.81, &noise);
            for j in 0..20 {
                let (a, b) = (f64::from(j) / 20.0, f64::from(j + 1) / 20.0);
                propagate(&mut fine, &from.lerp(&to, a), &from.lerp(&to, b), 0.0005, 9.81, &noise);
            }
        }
        let error = coarse.minus(&fine);
        // Without the two terms: 5e-4 rad and 2e-3 m/s.
        let of = |i: usize| error.fixed_rows::<3>(i).norm();
        assert!(of(ATTITUDE) < 2e-5 && of(VELOCITY) < 2e-4, "{} {}", of(ATTITUDE), of(VELOCITY));
    }

    #[test]
    fn covariance_and_sensitivity_follow_the_numerical_jacobian() {
        let (start, reading) = example();
        let (dt, noise) = (0.01, ProcessNoise::default());
        let mut end = start.clone();
        propagate(&mut end, &reading, &reading, dt, 9.81, &noise);
        let h = 1e-6;
        let mut jacobian = Covariance::zeros();
        for i in 0..N {
            let moved = |sign: f64| {
                let mut s = start.moved(i, sign * h);
                propagate(&mut s, &reading, &reading, dt, 9.81, &noise);
                s.minus(&end)
            };
            jacobian.set_column(i, &((moved(1.0) - moved(-1.0)) / (2.0 * h)));
        }
        let seed = Covariance::from_fn(|i, j| ((i * 7 + j * 13) % 11) as f64 / 11.0);
        let p0 = seed * seed.transpose() + Covariance::identity();
        let mut s = start;
        s.covariance = p0;
        s.sensitivity = Sensitivity::from_fn(|i, j| 0.1 * ((7 * i + j) as f32).cos());
        s.sensitivity.fixed_rows_mut::<CONSTANTS>(ESTIMATED).fill(0.0);
        let mut expected = s.sensitivity.map(f64::from)
            * transition(&s, &reading, &reading, dt, &noise).transpose();
        for k in 0..CONSTANTS {
            let moved = |sign: f64| {
                let mut s = s.clone();
                let constants = Constants::ith(k, sign * h);
                s.calibration = Calibration::known(constants, &SMatrix::zeros());
                propagate(&mut s, &reading, &reading, dt, 9.81, &noise);
                s.minus(&end)
            };
            expected.set_row(ESTIMATED + k, &((moved(1.0) - moved(-1.0)) / (2.0 * h)).transpose());
        }
        propagate(&mut s, &reading, &reading, dt, 9.81, &noise);
        let wrong = (s.sensitivity.map(f64::from) - expected).abs();
        assert!(wrong.rows(0, ESTIMATED).max() < 1e-6);
        // First order in dt, as for the covariance.
        let by_constants = expected.fixed_rows::<CONSTANTS>(ESTIMATED);
        assert!(
            wrong.fixed_rows::<CONSTANTS>(ESTIMATED).norm() < 0.02 * by_constants.norm(),
            "{wrong}"
        );
        let expected = jacobian * p0 * jacobian.transpose();
        // First order in dt: the terms left out are those of δb_g on δv (dt²).
        assert!((s.covariance - expected).norm() / expected.norm() < 5e-4);
    }

    #[test]
    fn uniform_motion_keeps_velocity_and_attitude() {
        let (start, _) = example();
        let reading = ImuReading::of_uniform_motion(&start, 9.81);
        let mut end = start.clone();
        propagate(&mut end, &reading, &reading, 0.1, 9.81, &ProcessNoise::default());
        let error = end.minus(&start);
        assert!(error.fixed_rows::<6>(VELOCITY).amax() < 1e-12);
        assert!((error.fixed_rows::<3>(POSITION) - start.velocity * 0.1).amax() < 1e-12);
    }
}
