//! Refinement of the platform's pose.
//!
//! [`rig_model::planar_pose`] estimates a pose from three or four centroids. The tracker needs
//! more: a prior, with which one centroid suffices, and the squares' corners, which constrain the
//! tilt that fewer than four centroids leave open.

use crate::{geometry::corners_of, quad::Quad};
use nalgebra::{
    Isometry3, Matrix2, Matrix2x3, Matrix2x6, Matrix6, Point3, Vector2, Vector3, Vector6,
};
use rig_model::{CameraModel, MarkerColor, MarkerLayout, planar_pose::moved};

/// A marker that a pose has to explain.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PoseObservation {
    pub color: MarkerColor,
    /// Centroid, px.
    pub pixel: Vector2<f64>,
    /// Standard deviation of the centroid, px.
    pub sigma: f64,
    /// The measured outline (px) and the square's turn in its plane (rad): the squares' size and
    /// shape constrain the tilt that three or fewer centroids leave open.
    pub outline: Option<(Quad, f64)>,
}

impl PoseObservation {
    /// Standard deviation of a whole marker's centroid, px: the RMS on the recorded bags is 0.06 px
    /// at most (`tests/bags`), and the layout adds as much.
    pub const SIGMA: f64 = 0.1;
    /// A slot without an observation.
    pub const NONE: Self = Self {
        color: MarkerColor::Red,
        pixel: Vector2::new(0.0, 0.0),
        sigma: Self::SIGMA,
        outline: None,
    };
}

/// Standard deviation of a corner, px: five times a centroid's, so that centroids decide where they
/// can.
const CORNER_SIGMA: f64 = 0.5;

/// A prior of the pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PosePrior {
    pub camera_from_volant: Isometry3<f64>,
    /// Standard deviation of each coordinate, m.
    pub position_sigma: f64,
    /// Standard deviation of the rotation about each axis, rad.
    pub rotation_sigma: f64,
}

/// A pose with its covariance.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PoseEstimate {
    pub camera_from_volant: Isometry3<f64>,
    /// Of (position, rotation about the camera's axes); m², m·rad, rad².
    pub covariance: Matrix6<f64>,
}

/// What a pose is estimated with: the markers' layout (volant frame) and the camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Geometry<'a> {
    pub layout: &'a MarkerLayout,
    pub camera: &'a CameraModel,
}

impl Geometry<'_> {
    /// Refines a pose (`camera_from_volant`) by Levenberg–Marquardt on the reprojected centroids
    /// and corners, from `start`, in at most `iterations` steps.
    ///
    /// Returns the pose, the RMS of the centroids' residuals, px, and the Gauss–Newton matrix, the
    /// inverse of the pose's covariance. With a prior any number of observations suffices; without
    /// one, three. `None` where a marker leaves the camera model's range.
    pub fn refine(
        &self,
        observations: &[PoseObservation],
        start: &Isometry3<f64>,
        prior: Option<&PosePrior>,
        iterations: usize,
    ) -> Option<(Isometry3<f64>, f64, Matrix6<f64>)> {
        let mut pose = *start;
        let mut now = self.evaluate(observations, &pose, prior)?;
        let mut damping = 1e-6;
        for _ in 0..iterations {
            let mut damped = now.normal;
            for i in 0..6 {
                damped[(i, i)] *= 1.0 + damping;
                damped[(i, i)] += 1e-9;
            }
            let step = damped.cholesky()?.solve(&now.gradient);
            // Predicted decrease of the cost.
            let gain = step.dot(&now.gradient);
            if gain < 1e-4 * now.cost.min(1.0) {
                break;
            }
            let candidate = moved(&pose, &step);
            // A step this short ends at the minimum of its quadratic; another would gain nothing.
            let last = gain < 1e-2;
            match self.evaluate(observations, &candidate, prior) {
                Some(new) if new.cost <= now.cost * (1.0 + 1e-9) => {
                    (pose, now) = (candidate, new);
                    if last {
                        break;
                    }
                    damping = (damping * 0.1).max(1e-9);
                }
                _ => {
                    damping = (damping * 100.0).max(1e-4);
                    if damping > 1e6 {
                        break;
                    }
                }
            }
        }
        Some((pose, (now.square / (observations.len().max(1) as f64)).sqrt(), now.normal))
    }

    /// Predicts a marker's centroid (px) and its covariance (px²).
    pub fn predict_centroid(
        &self,
        color: MarkerColor,
        pose: &PoseEstimate,
    ) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let PoseEstimate { camera_from_volant, covariance } = pose;
        let predicted = self.layout.projected_centroid(color, self.camera, camera_from_volant)?;
        let arm = camera_from_volant.rotation * self.layout.centers[color].coords;
        let j = by_pose(&predicted.jacobian_by_center, &arm);
        Some((predicted.pixel, j * covariance * j.transpose()))
    }

    /// The normal equations at `pose`; `None` where a marker leaves the camera model's range.
    fn evaluate(
        &self,
        observations: &[PoseObservation],
        pose: &Isometry3<f64>,
        prior: Option<&PosePrior>,
    ) -> Option<Normal> {
        let (mut cost, mut normal, mut gradient, mut square) =
            (0.0, Matrix6::zeros(), Vector6::zeros(), 0.0);
        for o in observations {
            let predicted = self.layout.projected_centroid(o.color, self.camera, pose)?;
            let arm = pose.rotation * self.layout.centers[o.color].coords;
            let j = by_pose(&predicted.jacobian_by_center, &arm);
            let w = o.sigma.powi(-2);
            let residual = o.pixel - predicted.pixel;
            square += residual.norm_squared();
            cost += w * residual.norm_squared();
            normal += j.transpose() * j * w;
            gradient += j.transpose() * residual * w;
            if let Some((outline, turn)) = &o.outline {
                let w = CORNER_SIGMA.powi(-2);
                for (point, corner) in
                    corners_of(self.layout, o.color, *turn).iter().zip(&outline.0)
                {
                    let arm = pose.rotation * point.coords;
                    let (pixel, by_point) = self
                        .camera
                        .project_with_jacobian(&Point3::from(arm + pose.translation.vector))?;
                    let j = by_pose(&by_point, &arm);
                    let residual = corner - pixel;
                    cost += w * residual.norm_squared();
                    normal += j.transpose() * j * w;
                    gradient += j.transpose() * residual * w;
                }
            }
        }
        if let Some(p) = prior {
            let dt = p.camera_from_volant.translation.vector - pose.translation.vector;
            let dr = (p.camera_from_volant.rotation * pose.rotation.inverse()).scaled_axis();
            let (wt, wr) = (p.position_sigma.powi(-2), p.rotation_sigma.powi(-2));
            cost += wt * dt.norm_squared() + wr * dr.norm_squared();
            for i in 0..3 {
                normal[(i, i)] += wt;
                normal[(3 + i, 3 + i)] += wr;
                gradient[i] += wt * dt[i];
                gradient[3 + i] += wr * dr[i];
            }
        }
        cost.is_finite().then_some(Normal { cost, normal, gradient, square })
    }
}

/// Derivative of a pixel by (translation, rotation vector about the camera's axes) of a pose, from
/// that by the point (camera frame) at the end of `arm`.
fn by_pose(by_point: &Matrix2x3<f64>, arm: &Vector3<f64>) -> Matrix2x6<f64> {
    let mut j = Matrix2x6::zeros();
    j.fixed_columns_mut::<3>(0).copy_from(by_point);
    j.fixed_columns_mut::<3>(3).copy_from(&(by_point * (-arm.cross_matrix())));
    j
}

/// Weighted cost, its normal equations, and the sum of the centroids' squared residuals (px²).
struct Normal {
    cost: f64,
    normal: Matrix6<f64>,
    gradient: Vector6<f64>,
    square: f64,
}
