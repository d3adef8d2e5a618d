//! What a row of errors amounts to.

use nalgebra::{Isometry3, Matrix3, Matrix6, Vector3, Vector6};
use serde::Serialize;

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

    /// The result, multiplied; zeros without numbers.
    pub fn spread(&self, scale: f64) -> Spread {
        let mean = if self.count == 0 { 0.0 } else { self.squares / self.count as f64 };
        Spread { rmse: mean.sqrt() * scale, max: self.max * scale }
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
        let turn = |x: f64| x - std::f64::consts::TAU * (x / std::f64::consts::TAU).round();
        Self {
            position: estimate.translation.vector - truth.translation.vector,
            rotation: (estimate.rotation * truth.rotation.inverse()).scaled_axis(),
            roll_pitch_yaw: (angles(estimate) - angles(truth)).map(turn),
        }
    }
}

/// Normalised estimation errors squared, e' P⁻¹ e (by Cholesky), of the position, the rotation and the pose: 3, 3 and 6
/// on average for a filter that knows how good it is.
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
    /// `None` where the covariance is not positive definite. Its order is position, rotation about fixed world axes.
    pub fn new(error: &PoseError, covariance: &Matrix6<f64>) -> Option<Self> {
        let c = (covariance + covariance.transpose()) * 0.5;
        let three = |block: Matrix3<f64>, e: &Vector3<f64>| Some(e.dot(&block.cholesky()?.solve(e)));
        let e = Vector6::from_iterator(error.position.iter().chain(error.rotation.iter()).copied());
        let nees = Self {
            position: three(c.fixed_view::<3, 3>(0, 0).into_owned(), &error.position)?,
            rotation: three(c.fixed_view::<3, 3>(3, 3).into_owned(), &error.rotation)?,
            pose: e.dot(&c.cholesky()?.solve(&e)),
        };
        [nees.position, nees.rotation, nees.pose].iter().all(|x| x.is_finite()).then_some(nees)
    }
}

/// A pose and its covariance seen from the other end: `a_from_b` with a covariance about the axes of a becomes
/// `b_from_a` with one about the axes of b. With `R_true = Exp(δ) R` and `p_true = p + ε` the inverse has, to first
/// order, `δ' = −Rᵀ δ` and `ε' = −Rᵀ ε − Rᵀ [p]× δ`.
pub fn inverse(pose: &Isometry3<f64>, covariance: &Matrix6<f64>) -> (Isometry3<f64>, Matrix6<f64>) {
    let inverse = pose.inverse();
    let rt: Matrix3<f64> = *inverse.rotation.to_rotation_matrix().matrix();
    let mut jacobian = Matrix6::zeros();
    jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&-rt);
    jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-rt * pose.translation.vector.cross_matrix()));
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
        estimate.rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.01, 0.0, 0.1)) * truth.rotation;
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
            let difference = PoseError::new(&truth.inverse(), &inverse);
            let d =
                Vector6::from_iterator(difference.position.iter().chain(difference.rotation.iter()).copied());
            assert!((covariance - d * d.transpose()).norm() < 1e-4 * step * step, "axis {axis}");
        }
    }

    #[test]
    fn a_spread_of_nothing_is_zero() {
        assert_eq!(SpreadSum::default().spread(1.0), Spread::default());
        let mut sum = SpreadSum::default();
        sum.add(3.0);
        sum.add(-4.0);
        assert_eq!(sum.spread(10.0), Spread { rmse: 12.5f64.sqrt() * 10.0, max: 40.0 });
    }
}
