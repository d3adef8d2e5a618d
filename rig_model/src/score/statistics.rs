//! Errors of single poses, and what a series of them amounts to.

use crate::wrap_angle;
use nalgebra::{Isometry3, Matrix3, Matrix6, Vector3, Vector6};
use serde::Serialize;
use std::fmt;

/// Root mean square and largest absolute value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Spread {
    /// Root of the mean of the squares.
    pub rmse: f64,
    /// Largest absolute value.
    pub max: f64,
}

/// Collects numbers into a [`Spread`].
#[derive(Clone, Copy, Debug, Default)]
pub struct SpreadSum {
    squares: f64,
    max: f64,
    count: u64,
}

impl SpreadSum {
    /// Adds a number.
    pub fn add(&mut self, value: f64) {
        self.squares += value * value;
        self.max = self.max.max(value.abs());
        self.count += 1;
    }

    /// Number of numbers.
    pub const fn count(&self) -> u64 {
        self.count
    }

    /// Root of the mean of the squares; NaN without numbers.
    pub fn rmse(&self) -> f64 {
        (self.squares / self.count as f64).sqrt()
    }

    /// Largest absolute value; zero without numbers.
    pub const fn max(&self) -> f64 {
        self.max
    }

    /// The result, multiplied; NaN without numbers.
    pub fn spread(&self, scale: f64) -> Spread {
        let max = if self.count == 0 { f64::NAN } else { self.max };
        Spread { rmse: self.rmse() * scale, max: max * scale }
    }
}

/// The error of one pose against the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseError {
    /// Estimate minus truth, in the world, m.
    pub position: Vector3<f64>,
    /// The turn from the truth to the estimate, about fixed world axes, rad.
    pub rotation: Vector3<f64>,
    /// Estimate minus truth of roll, pitch and yaw (about x, then y, then z of the world), rad.
    pub roll_pitch_yaw: Vector3<f64>,
}

impl PoseError {
    /// Of an estimate.
    pub fn new(estimate: &Isometry3<f64>, truth: &Isometry3<f64>) -> Self {
        let angles = |pose: &Isometry3<f64>| {
            let (roll, pitch, yaw) = pose.rotation.euler_angles();
            Vector3::new(roll, pitch, yaw)
        };
        Self {
            position: estimate.translation.vector - truth.translation.vector,
            rotation: (estimate.rotation * truth.rotation.inverse()).scaled_axis(),
            roll_pitch_yaw: (angles(estimate) - angles(truth)).map(wrap_angle),
        }
    }

    /// Position and rotation in one vector, the order of a pose's covariance.
    pub fn stacked(&self) -> Vector6<f64> {
        Vector6::from_iterator(self.position.iter().chain(self.rotation.iter()).copied())
    }
}

/// Normalized estimation errors squared, e' P⁻¹ e (by Cholesky), of the position, the rotation and
/// the pose: 3, 3 and 6 on average for a filter that knows how good it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nees {
    /// Of the position.
    pub position: f64,
    /// Of the rotation.
    pub rotation: f64,
    /// Of both together.
    pub pose: f64,
}

impl Nees {
    /// `None` where the covariance is not positive definite. Its order is position, rotation about
    /// fixed world axes.
    pub fn new(error: &PoseError, covariance: &Matrix6<f64>) -> Option<Self> {
        let c = (covariance + covariance.transpose()) * 0.5;
        let three =
            |block: Matrix3<f64>, e: &Vector3<f64>| Some(e.dot(&block.cholesky()?.solve(e)));
        let e = error.stacked();
        let nees = Self {
            position: three(c.fixed_view::<3, 3>(0, 0).into_owned(), &error.position)?,
            rotation: three(c.fixed_view::<3, 3>(3, 3).into_owned(), &error.rotation)?,
            pose: e.dot(&c.cholesky()?.solve(&e)),
        };
        [nees.position, nees.rotation, nees.pose].iter().all(|x| x.is_finite()).then_some(nees)
    }

    /// NEES of position and rotation; infinite where the covariance is not positive definite.
    pub fn pair(error: &PoseError, covariance: &Matrix6<f64>) -> [f64; 2] {
        Self::new(error, covariance).map_or([f64::INFINITY; 2], |n| [n.position, n.rotation])
    }
}

/// Errors of a series of poses.
#[derive(Clone, Copy, Debug, Default)]
pub struct Score {
    /// Position error, m.
    pub position: SpreadSum,
    /// Length of the rotation vector, rad.
    pub rotation: SpreadSum,
    nees: [f64; 3],
    with_covariance: u64,
}

impl Score {
    /// Adds a pose and its covariance (position, rotation about fixed world axes), and returns its
    /// error.
    pub fn add(
        &mut self,
        estimate: &Isometry3<f64>,
        covariance: &Matrix6<f64>,
        truth: &Isometry3<f64>,
    ) -> PoseError {
        let error = PoseError::new(estimate, truth);
        self.position.add(error.position.norm());
        self.rotation.add(error.rotation.norm());
        if let Some(nees) = Nees::new(&error, covariance) {
            let new = [nees.position, nees.rotation, nees.pose];
            self.nees.iter_mut().zip(new).for_each(|(sum, new)| *sum += new);
            self.with_covariance += 1;
        }
        error
    }

    /// Number of poses.
    pub const fn count(&self) -> u64 {
        self.position.count()
    }

    /// Number of poses whose covariance is not positive definite.
    pub const fn without_covariance(&self) -> u64 {
        self.count() - self.with_covariance
    }

    /// RMSE of the position, mm; NaN without poses.
    pub fn position_rmse(&self) -> f64 {
        self.position.rmse() * 1e3
    }

    /// Largest error of the position, mm.
    pub fn position_max(&self) -> f64 {
        self.position.max() * 1e3
    }

    /// RMSE of the rotation vector, degrees; NaN without poses.
    pub fn rotation_rmse(&self) -> f64 {
        self.rotation.rmse().to_degrees()
    }

    /// Largest length of the rotation vector, degrees.
    pub fn rotation_max(&self) -> f64 {
        self.rotation.max().to_degrees()
    }

    /// Mean NEES of the poses with a positive definite covariance; `None` without any.
    pub fn mean_nees(&self) -> Option<Nees> {
        let [position, rotation, pose] = self.nees.map(|sum| sum / self.with_covariance as f64);
        (self.with_covariance > 0).then_some(Nees { position, rotation, pose })
    }

    /// Mean NEES of position and rotation; infinite where a covariance is not positive definite,
    /// NaN without poses.
    pub fn nees(&self) -> (f64, f64) {
        match self.mean_nees() {
            Some(nees) if self.without_covariance() == 0 => (nees.position, nees.rotation),
            _ if self.count() == 0 => (f64::NAN, f64::NAN),
            _ => (f64::INFINITY, f64::INFINITY),
        }
    }
}

impl fmt::Display for Score {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (position, rotation) = self.nees();
        write!(
            f,
            "{:5} poses  {:7.3} mm (max {:7.2})  {:6.4}° (max {:6.3})  \
             NEES {position:5.2} {rotation:5.2}",
            self.count(),
            self.position_rmse(),
            self.position_max(),
            self.rotation_rmse(),
            self.rotation_max(),
        )
    }
}

/// A pose and its covariance seen from the other end: `a_from_b` with a covariance about the axes
/// of a becomes `b_from_a` with one about the axes of b. With `R_true = Exp(δ) R` and `p_true = p +
/// ε` the inverse has, to first order, `δ' = −Rᵀ δ` and `ε' = −Rᵀ ε − Rᵀ [p]× δ`.
pub fn inverse(pose: &Isometry3<f64>, covariance: &Matrix6<f64>) -> (Isometry3<f64>, Matrix6<f64>) {
    let inverse = pose.inverse();
    let rt: Matrix3<f64> = *inverse.rotation.to_rotation_matrix().matrix();
    let mut jacobian = Matrix6::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&-rt);
    jacobian
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&(-rt * pose.translation.vector.cross_matrix()));
    jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&-rt);
    (inverse, jacobian * covariance * jacobian.transpose())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    #[test]
    fn errors_are_in_the_world_whatever_the_heading() {
        let truth = Isometry3::new(Vector3::new(1.0, 2.0, 3.0), Vector3::new(0.0, 0.0, 3.1));
        let mut estimate = truth;
        estimate.translation.vector.x += 0.001;
        estimate.rotation =
            UnitQuaternion::from_scaled_axis(Vector3::new(0.01, 0.0, 0.1)) * truth.rotation;
        let error = PoseError::new(&estimate, &truth);
        assert!((error.position - Vector3::new(0.001, 0.0, 0.0)).norm() < 1e-15);
        assert!((error.rotation - Vector3::new(0.01, 0.0, 0.1)).norm() < 1e-12);
        // Across the seam at ±180°.
        assert!((error.roll_pitch_yaw.z - 0.1).abs() < 1e-3, "{}", error.roll_pitch_yaw);
    }

    #[test]
    fn nees_is_the_squared_error_over_its_variance() {
        let error = PoseError {
            position: Vector3::new(0.002, 0.0, 0.0),
            rotation: Vector3::new(0.0, 0.03, 0.0),
            roll_pitch_yaw: Vector3::zeros(),
        };
        let mut covariance = Matrix6::identity() * 1e-6;
        covariance[(4, 4)] = 1e-4;
        let nees = Nees::new(&error, &covariance).unwrap();
        assert!((nees.position - 4.0).abs() < 1e-9 && (nees.rotation - 9.0).abs() < 1e-9);
        assert!((nees.pose - 13.0).abs() < 1e-9);
        assert_eq!(Nees::new(&error, &Matrix6::zeros()), None);
        assert_eq!(Nees::new(&error, &Matrix6::repeat(f64::NAN)), None);
    }

    /// The covariance of an inverse is that of the inverted errors, found here by finite steps.
    #[test]
    fn the_inverse_carries_its_covariance() {
        let pose = Isometry3::new(Vector3::new(0.4, -1.2, 1.7), Vector3::new(0.3, -0.2, 1.5));
        let step = 1e-6;
        for axis in 0..6 {
            let mut e = Vector6::zeros();
            e[axis] = step;
            let mut truth = pose;
            truth.translation.vector += e.fixed_rows::<3>(0);
            truth.rotation =
                UnitQuaternion::from_scaled_axis(e.fixed_rows::<3>(3).into_owned()) * pose.rotation;
            let (inverse, covariance) = inverse(&pose, &(e * e.transpose()));
            let d = PoseError::new(&truth.inverse(), &inverse).stacked();
            assert!((covariance - d * d.transpose()).norm() < 1e-4 * step * step, "axis {axis}");
        }
    }

    #[test]
    fn a_spread_of_nothing_is_no_number() {
        let nothing = SpreadSum::default().spread(1.0);
        assert!(nothing.rmse.is_nan() && nothing.max.is_nan());
        let mut sum = SpreadSum::default();
        sum.add(3.0);
        sum.add(-4.0);
        assert_eq!(sum.spread(10.0), Spread { rmse: 12.5f64.sqrt() * 10.0, max: 40.0 });
    }
}
