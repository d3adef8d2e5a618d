//! Constants that are estimated beside the state: scale factors and misalignment of the IMU, and
//! the places of the markers. Equations: `docs/src/equations.md`, "Calibration of the IMU and of
//! the marker layout".

use super::{
    consider::{ESTIMATED, PARAMETERS},
    propagation::ImuReading,
};
use crate::config::ImuConfig;
use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};
use rig_model::MarkerLayout;

/// Number of constants: six scale factors, six rotations, rad, eight marker offsets, m.
pub const CONSTANTS: usize = 20;
/// First rotation.
const ROTATION: usize = 6;
/// First offset of a marker: x and y of red, green, blue, yellow, m.
pub const MARKERS: usize = 12;
/// Number of offsets.
pub const OFFSETS: usize = 8;
/// Largest scale factor and rotation, rad; beyond that range or mounting are misconfigured.
const LARGEST: f32 = 0.1;
/// Largest offset of a marker, m: half the side of the paper's square.
const LARGEST_OFFSET: f64 = 0.04;
/// Sigmas from zero beyond which a constant's variance is opened by its square.
const UNEXPECTED: f32 = 3.0;

/// Numbers of one triangle of the covariance.
const TRIANGLE: usize = CONSTANTS * (CONSTANTS + 1) / 2;

/// One number for each constant.
pub type Constants = SVector<f64, CONSTANTS>;
/// The same in single precision, as they are stored: the history keeps one for each entry.
type Single = SVector<f32, CONSTANTS>;

/// Distance from zero that is expected, 1 sigma: of each constant of the IMU, and of all offsets.
type Expected = SVector<f32, { MARKERS + 1 }>;

/// Symmetric matrix, stored as its lower triangle, column by column.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Symmetric([f32; TRIANGLE]);

impl Default for Symmetric {
    fn default() -> Self {
        Self([0.0; TRIANGLE])
    }
}

impl Symmetric {
    /// Returns the lower triangle of a matrix.
    fn of(matrix: &SMatrix<f32, CONSTANTS, CONSTANTS>) -> Self {
        let mut triangle = Self::default();
        let lower = (0..CONSTANTS).flat_map(|j| (j..CONSTANTS).map(move |i| (i, j)));
        for (to, at) in triangle.0.iter_mut().zip(lower) {
            *to = matrix[at];
        }
        triangle
    }

    /// Returns the whole matrix.
    fn matrix(&self) -> SMatrix<f32, CONSTANTS, CONSTANTS> {
        let mut matrix = SMatrix::zeros();
        let lower = (0..CONSTANTS).flat_map(|j| (j..CONSTANTS).map(move |i| (i, j)));
        for (from, (i, j)) in self.0.iter().zip(lower) {
            matrix[(i, j)] = *from;
            matrix[(j, i)] = *from;
        }
        matrix
    }
}

/// Estimated constants with their covariance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Calibration {
    constants: Single,
    covariance: Symmetric,
    expected: Expected,
}

impl Calibration {
    /// Returns constants of zero with the configured standard deviations, of an IMU whose rotation
    /// against the platform is `volant_from_imu`. The markers are where the rig file has them until
    /// images contradict that ([`Calibration::open_layout`]).
    pub fn new(imu: &ImuConfig, volant_from_imu: &UnitQuaternion<f64>) -> Self {
        let sigmas = Single::from_fn(|i, _| match i {
            0..3 => imu.gyroscope_scale as f32,
            3..ROTATION => imu.accelerometer_scale as f32,
            ROTATION..MARKERS => imu.misalignment as f32,
            _ => 0.0,
        });
        // Gyroscope and accelerometer are turned together about the platform's vertical.
        let vertical = volant_from_imu.inverse() * Vector3::z();
        let mut turn = Single::zeros();
        for first in [ROTATION, ROTATION + 3] {
            let yaw = (vertical * imu.mounting_yaw).cast();
            turn.fixed_rows_mut::<3>(first).copy_from(&yaw);
        }
        let covariance =
            SMatrix::from_diagonal(&sigmas.component_mul(&sigmas)) + turn * turn.transpose();
        let expected = Expected::from_fn(|i, _| covariance[(i, i)].sqrt());
        Self { constants: Single::zeros(), covariance: Symmetric::of(&covariance), expected }
    }

    /// Returns constants that are known with a covariance.
    pub fn known(constants: Constants, covariance: &SMatrix<f64, CONSTANTS, CONSTANTS>) -> Self {
        let mut expected = Expected::zeros();
        for i in 0..CONSTANTS {
            let away = constants[i].abs() + covariance[(i, i)].max(0.0).sqrt();
            expected[of(i)] = expected[of(i)].max(away as f32);
        }
        let covariance = Symmetric::of(&covariance.map(|x| x as f32));
        Self { constants: constants.map(|x| x as f32), covariance, expected }
    }

    /// Returns the constants: scale factors of gyroscope and accelerometer, rotations of both, rad,
    /// IMU axes; offsets of the markers, m, volant axes.
    pub fn constants(&self) -> Constants {
        self.constants.map(f64::from)
    }

    /// Returns the covariance of the constants.
    pub fn covariance(&self) -> SMatrix<f64, CONSTANTS, CONSTANTS> {
        self.covariance.matrix().map(f64::from)
    }

    /// Returns the layout with the estimated places of the markers.
    pub fn layout(&self, layout: &MarkerLayout) -> MarkerLayout {
        let mut moved = layout.clone();
        for (i, center) in moved.centers.0.iter_mut().enumerate() {
            center.x += f64::from(self.constants[MARKERS + 2 * i]);
            center.y += f64::from(self.constants[MARKERS + 2 * i + 1]);
        }
        moved
    }

    /// Returns the covariance of the markers' offsets, m².
    pub fn offset_covariance(&self) -> SMatrix<f64, OFFSETS, OFFSETS> {
        self.covariance().fixed_view::<OFFSETS, OFFSETS>(MARKERS, MARKERS).into_owned()
    }

    /// Opens the variance of the markers' offsets by the square of `sigma`, m.
    pub fn open_layout(&mut self, sigma: f64) {
        let mut covariance = self.covariance.matrix();
        self.expected[MARKERS] = self.expected[MARKERS].max(sigma as f32);
        for i in MARKERS..CONSTANTS {
            covariance[(i, i)] += (sigma * sigma) as f32;
        }
        self.covariance = Symmetric::of(&covariance);
    }

    /// Returns whether every constant is finite and within its limit.
    pub fn within_limits(constants: &Constants) -> bool {
        (0..CONSTANTS).all(|i| constants[i].abs() as f32 <= limit(i))
    }

    /// Returns the motion that a reading measures, both without the biases.
    pub fn motion(&self, reading: &ImuReading) -> ImuReading {
        ImuReading {
            angular_velocity: reading.angular_velocity - self.error(0, &reading.angular_velocity),
            specific_force: reading.specific_force - self.error(1, &reading.specific_force),
        }
    }

    /// Returns the reading of a motion, both without the biases: the inverse of
    /// [`Calibration::motion`] to first order.
    pub fn reading(&self, motion: &ImuReading) -> ImuReading {
        ImuReading {
            angular_velocity: motion.angular_velocity + self.error(0, &motion.angular_velocity),
            specific_force: motion.specific_force + self.error(1, &motion.specific_force),
        }
    }

    /// `s ∘ m + ρ × m` of the gyroscope (`triad` 0) or the accelerometer (1).
    fn error(&self, triad: usize, m: &Vector3<f64>) -> Vector3<f64> {
        let three = |first: usize| self.constants.fixed_rows::<3>(first).map(f64::from);
        three(3 * triad).component_mul(m) + three(ROTATION + 3 * triad).cross(m)
    }

    /// Derivative of a triad's motion, turned by `rotation`, by the constants of that triad, with
    /// the first column of each part: scale factors and rotation.
    pub fn derivative(
        triad: usize,
        rotation: &Matrix3<f64>,
        m: &Vector3<f64>,
    ) -> [(usize, Matrix3<f64>); 2] {
        let by_scale = -(rotation * Matrix3::from_diagonal(m));
        [(3 * triad, by_scale), (ROTATION + 3 * triad, rotation * m.cross_matrix())]
    }

    /// Corrects the constants by an innovation, given `B` and `L⁻¹ r`, and returns by how much.
    pub fn correct<const M: usize>(
        &mut self,
        by_parameter: &SMatrix<f64, M, PARAMETERS>,
        whitened: &SVector<f64, M>,
    ) -> Constants {
        let mut step = Constants::zeros();
        let mut covariance = self.covariance.matrix();
        // The rows are independent and have unit variance.
        for (row, innovation) in by_parameter.row_iter().zip(whitened) {
            let b: Constants = row.fixed_columns::<CONSTANTS>(ESTIMATED).transpose();
            let gain = covariance * b.map(|x| x as f32);
            let spread = 1.0 + b.dot(&gain.map(f64::from));
            let residual = innovation - b.dot(&step);
            if !(spread >= 1.0 && residual.is_finite()) {
                continue;
            }
            step += gain.map(f64::from) * (residual / spread);
            let root = gain / (spread as f32).sqrt();
            covariance.ger(-1.0, &root, &root, 1.0);
        }
        let before = self.constants();
        for i in 0..CONSTANTS {
            let moved = (before[i] + step[i]) as f32;
            self.constants[i] = moved.clamp(-limit(i), limit(i));
            let away = self.constants[i].abs();
            if away > UNEXPECTED * self.expected[of(i)] {
                self.expected[of(i)] = away;
                covariance[(i, i)] += away * away;
            }
        }
        self.covariance = Symmetric::of(&covariance);
        self.constants() - before
    }
}

/// Returns the place of a constant in [`Expected`].
fn of(index: usize) -> usize {
    index.min(MARKERS)
}

/// Returns the largest magnitude of a constant.
fn limit(index: usize) -> f32 {
    if index < MARKERS { LARGEST } else { LARGEST_OFFSET as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config() -> ImuConfig {
        ImuConfig { gyroscope_scale: 0.003, accelerometer_scale: 0.002, ..ImuConfig::default() }
    }

    #[test]
    fn motion_and_reading_are_inverse_and_the_derivative_is_the_numerical_one() {
        let mut calibration = Calibration::new(&config(), &UnitQuaternion::identity());
        calibration.constants = Single::from_fn(|i, _| 0.001 * ((i * 7) % 5) as f32 - 0.002);
        let reading = ImuReading {
            specific_force: Vector3::new(0.5, -1.0, 9.6),
            angular_velocity: Vector3::new(1.0, -2.0, 0.5),
        };
        let motion = calibration.motion(&reading);
        let back = calibration.reading(&motion);
        assert!((back.specific_force - reading.specific_force).norm() < 1e-3);
        assert!((back.angular_velocity - reading.angular_velocity).norm() < 1e-4);
        let turn = *nalgebra::Rotation3::from_euler_angles(0.3, -0.2, 1.1).matrix();
        for triad in 0..2 {
            let part = |r: &ImuReading| [r.angular_velocity, r.specific_force][triad];
            for (first, by) in Calibration::derivative(triad, &turn, &part(&reading)) {
                for k in 0..3 {
                    let mut moved = calibration;
                    moved.constants[first + k] += 0.125;
                    let by_step =
                        f64::from(moved.constants[first + k]) - calibration.constants()[first + k];
                    let change = turn * (part(&moved.motion(&reading)) - part(&motion)) / by_step;
                    assert!((change - by.column(k)).norm() < 1e-6, "{triad} {first} {k}");
                }
            }
        }
    }

    #[test]
    fn an_imu_that_is_turned_as_a_whole_turns_both_triads_about_the_vertical() {
        let imu = ImuConfig { misalignment: 0.001, mounting_yaw: 0.005, ..config() };
        let volant_from_imu =
            UnitQuaternion::from_euler_angles(std::f64::consts::FRAC_PI_2, 0.0, 0.3);
        let calibration = Calibration::new(&imu, &volant_from_imu);
        let covariance = calibration.covariance();
        // The IMU's y axis is the vertical.
        let expected = [(0, 0, 1e-6), (1, 1, 26e-6), (1, 4, 25e-6), (4, 4, 26e-6), (1, 2, 0.0)];
        for (i, j, variance) in expected {
            let found = covariance[(ROTATION + i, ROTATION + j)];
            assert!((found - variance).abs() < 1e-9, "{i} {j}: {found}");
        }
    }

    #[test]
    fn a_constant_is_found_within_its_sigma_and_a_surprising_one_opens_its_variance() {
        for (truth, images) in [(0.004, 200), (-0.05, 1000)] {
            let mut calibration = Calibration::new(&config(), &UnitQuaternion::identity());
            for k in 0..images {
                let mut b = SMatrix::<f64, 2, PARAMETERS>::zeros();
                b[(0, ESTIMATED)] = 20.0 * (0.1 * f64::from(k)).sin();
                b[(1, ESTIMATED + 4)] = 20.0;
                let error = truth - calibration.constants()[0];
                // A deterministic stand-in for white noise of variance 1.
                let noise = 1.2 * (f64::from(k) * 7919.0 * 0.618).sin();
                let whitened = SVector::<f64, 2>::new(b[(0, ESTIMATED)] * error + noise, 0.0);
                calibration.correct(&b, &whitened);
            }
            let sigma = calibration.covariance()[(0, 0)].sqrt();
            let error = calibration.constants()[0] - truth;
            assert!(error.abs() < 3.0 * sigma && sigma < 0.006, "{truth}: {error}, {sigma}");
            assert_eq!(calibration.constants[4], 0.0);
        }
    }

    #[test]
    fn a_constant_is_limited_and_a_number_that_is_not_finite_is_ignored() {
        let mut calibration = Calibration::new(&config(), &UnitQuaternion::identity());
        let mut b = SMatrix::<f64, 1, PARAMETERS>::zeros();
        b[(0, ESTIMATED + 6)] = 1e6;
        for _ in 0..20 {
            calibration.correct(&b, &SVector::<f64, 1>::new(1e6));
        }
        assert_eq!(calibration.constants[6], LARGEST);
        let before = calibration;
        assert_eq!(calibration.correct(&b, &SVector::<f64, 1>::new(f64::NAN)), Constants::zeros());
        assert_eq!(calibration, before);
    }
}
