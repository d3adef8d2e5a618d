//! The platform's pose in the camera frame, as far as the tracker needs it: to predict the squares'
//! outlines and to decide whether patches of the right colors can be the markers.

mod refine;

pub(crate) use refine::{Geometry, PoseEstimate, PoseObservation, PosePrior};

use crate::quad::Quad;
use nalgebra::{Isometry3, Matrix2, Point3};
use rig_model::{CameraModel, MarkerColor, MarkerLayout};

/// Covariance of two independent coordinates with standard deviation `sigma`, px².
pub(crate) fn isotropic(sigma: f64) -> Matrix2<f64> {
    Matrix2::identity() * (sigma * sigma)
}

/// Corners (volant frame, m) of a square that is turned by `turn` (rad) in its plane.
fn corners_of(layout: &MarkerLayout, color: MarkerColor, turn: f64) -> [Point3<f64>; 4] {
    let h = layout.side / 2.0;
    let (s, c) = turn.sin_cos();
    let center = layout.centers[color];
    [(-h, -h), (h, -h), (h, h), (-h, h)]
        .map(|(u, v)| Point3::new(center.x + c * u - s * v, center.y + s * u + c * v, center.z))
}

/// Outline (px) of a square that is turned by `turn` (rad) in its plane, seen from
/// `camera_from_volant`; `None` outside of the camera model's range.
pub(crate) fn project_square(
    layout: &MarkerLayout,
    color: MarkerColor,
    turn: f64,
    camera: &CameraModel,
    camera_from_volant: &Isometry3<f64>,
) -> Option<Quad> {
    let corners = corners_of(layout, color, turn);
    let [a, b, c, d] = corners.map(|corner| camera.project(&(camera_from_volant * corner)));
    Some(Quad([a?, b?, c?, d?]))
}
