//! Reference estimators: the published filter with its pose, and the pose from one image alone.

mod gyro_attitude;
pub mod marker_measurement;
pub mod paper;
pub mod published_pose;
pub mod single_image;

use nalgebra::{Isometry3, Matrix6, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};

/// Returns step K r and covariance (I − K H) P of a Kalman correction; `None` where the covariance
/// of the innovation is not positive definite.
fn correction<const N: usize>(
    covariance: &Matrix6<f64>,
    jacobian: &SMatrix<f64, N, 6>,
    noise: &SMatrix<f64, N, N>,
    residual: &SVector<f64, N>,
) -> Option<(Vector6<f64>, Matrix6<f64>)> {
    let innovation = jacobian * covariance * jacobian.transpose() + noise;
    let cholesky = innovation.cholesky()?;
    let cross = covariance * jacobian.transpose();
    let reduction = cross * cholesky.solve(&cross.transpose());
    let step = cross * cholesky.solve(residual);
    Some((step, covariance - (reduction + reduction.transpose()) * 0.5))
}

/// Returns x, y, z (m), roll, pitch and yaw (rad) of a pose.
fn vector(pose: &Isometry3<f64>) -> Vector6<f64> {
    let (t, e) = (pose.translation.vector, euler(&pose.rotation));
    Vector6::new(t.x, t.y, t.z, e.x, e.y, e.z)
}

/// Returns roll, pitch and yaw, rad.
fn euler(rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
    let (roll, pitch, yaw) = rotation.euler_angles();
    Vector3::new(roll, pitch, yaw)
}
