//! The platform's pose in the camera frame, as far as the tracker needs it: to predict the squares'
//! outlines and to decide whether patches of the right colors can be the markers.

mod refine;

pub(crate) use refine::{Geometry, PoseObservation, PosePrior, moved};

use crate::quad::Quad;
use nalgebra::{Isometry3, Point3, Vector2};
use rig_model::{CameraModel, MarkerColor, MarkerLayout};

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
    let mut corners = [Vector2::zeros(); 4];
    for (corner, point) in corners.iter_mut().zip(corners_of(layout, color, turn)) {
        *corner = camera.project(&(camera_from_volant * point))?;
    }
    Some(Quad(corners))
}
