//! Start values for the refinement of a pose, from the centroids of patches.

use crate::geometry::refine::PoseObservation;
use nalgebra::{
    Isometry3, Matrix3, Rotation3, SMatrix, Translation3, UnitQuaternion, Vector2, Vector3,
};
use rig_model::{CameraModel, MarkerColor, MarkerLayout, PerColor};

/// Starts from four centroids (px): the pose from the homography between the marker plane and the
/// undistorted image. `None` where the four are no image of the layout seen from in front.
pub(crate) fn pose_from_four(
    layout: &MarkerLayout,
    camera: &CameraModel,
    pixels: &PerColor<Vector2<f64>>,
) -> Option<Isometry3<f64>> {
    let mean_z = MarkerColor::ALL.map(|c| layout.centers[c].z).iter().sum::<f64>() / 4.0;
    let mut a = SMatrix::<f64, 8, 8>::zeros();
    let mut b = SMatrix::<f64, 8, 1>::zeros();
    for (i, color) in MarkerColor::ALL.into_iter().enumerate() {
        let n = camera.undistort(&pixels[color])?;
        let (x, y) = (layout.centers[color].x, layout.centers[color].y);
        let rows = [
            [x, y, 1.0, 0.0, 0.0, 0.0, -n.x * x, -n.x * y],
            [0.0, 0.0, 0.0, x, y, 1.0, -n.y * x, -n.y * y],
        ];
        for (r, row) in rows.iter().enumerate() {
            for (c, v) in row.iter().enumerate() {
                a[(2 * i + r, c)] = *v;
            }
        }
        b[2 * i] = n.x;
        b[2 * i + 1] = n.y;
    }
    let h = a.lu().solve(&b)?;
    let (mut h1, mut h2, mut t) = (
        Vector3::new(h[0], h[3], h[6]),
        Vector3::new(h[1], h[4], h[7]),
        Vector3::new(h[2], h[5], 1.0),
    );
    let scale = (h1.norm() * h2.norm()).sqrt();
    if !(scale.is_finite() && scale > 1e-9) {
        return None;
    }
    // The plane's two axes have equal lengths and are perpendicular, up to the patches' noise: a
    // deviation of 60 %, or 30°, is none.
    let ratio = h1.norm() / h2.norm();
    if !(0.6..1.67).contains(&ratio) || (h1.dot(&h2) / (scale * scale)).abs() > 0.5 {
        return None;
    }
    h1 /= scale;
    h2 /= scale;
    t /= scale;
    let h3 = h1.cross(&h2);
    let svd = Matrix3::from_columns(&[h1, h2, h3]).svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    if rotation.determinant() < 0.0 {
        return None;
    }
    let rotation =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    // The platform's origin is mean_z below the markers' plane.
    let origin = t - rotation * Vector3::new(0.0, 0.0, mean_z);
    // Seen from in front: the platform's z axis points at the camera.
    let up = rotation * Vector3::z();
    (up.dot(&t) < 0.0 && t.z > 0.0)
        .then(|| Isometry3::from_parts(Translation3::from(origin), rotation))
}

/// Starts from three centroids: the pose under parallel projection in its two mirror forms.
pub(crate) fn poses_from_three(
    layout: &MarkerLayout,
    camera: &CameraModel,
    observations: &[PoseObservation; 3],
) -> Option<[Isometry3<f64>; 2]> {
    let n: [Vector2<f64>; 3] = [
        camera.undistort(&observations[0].pixel)?,
        camera.undistort(&observations[1].pixel)?,
        camera.undistort(&observations[2].pixel)?,
    ];
    let p = observations.map(|s| layout.centers[s.color]);
    // Affine map of the plane: n = t + A·(x, y).
    let (e, f) = (p[1] - p[0], p[2] - p[0]);
    let det = e.x * f.y - e.y * f.x;
    if det.abs() < 1e-9 {
        return None;
    }
    let (u, v) = (n[1] - n[0], n[2] - n[0]);
    let ax = (u * f.y - v * e.y) / det;
    let ay = (v * e.x - u * f.x) / det;
    // Columns of s·R[0..2, 0..2]: lengths and angle are completed by the third components c, d with
    // |.| = s, orthogonal.
    let (aa, bb, ab) = (ax.norm_squared(), ay.norm_squared(), ax.dot(&ay));
    // s² = aa + c² = bb + d², c·d = −ab.
    let diff = aa - bb;
    let c2 = ((diff * diff + 4.0 * ab * ab).sqrt() - diff) / 2.0;
    let c = c2.max(0.0).sqrt();
    let s2 = aa + c2.max(0.0);
    let d_abs = (s2 - bb).max(0.0).sqrt();
    let d = if ab > 0.0 { -d_abs } else { d_abs };
    let s = s2.sqrt();
    if s.is_nan() || s <= 1e-9 {
        return None;
    }
    let make = |sign: f64| {
        let r1 = Vector3::new(ax.x, ax.y, sign * c) / s;
        let r2 = Vector3::new(ay.x, ay.y, sign * d) / s;
        let m = Matrix3::from_columns(&[r1, r2, r1.cross(&r2)]);
        let svd = m.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * v_t));
        let z = 1.0 / s;
        let origin = n[0] - ax * p[0].x - ay * p[0].y;
        let at = Vector3::new(origin.x * z, origin.y * z, z);
        let pose = Isometry3::from_parts(
            Translation3::from(at - rotation * Vector3::new(0.0, 0.0, p[0].z)),
            rotation,
        );
        ((rotation * Vector3::z()).dot(&at) < 0.0).then_some(pose)
    };
    match (make(1.0), make(-1.0)) {
        (Some(a), Some(b)) => Some([a, b]),
        (Some(a), None) | (None, Some(a)) => Some([a, a]),
        _ => None,
    }
}

#[cfg(test)]
#[path = "starts_tests.rs"]
mod tests;
