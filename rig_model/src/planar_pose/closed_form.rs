//! Infinitesimal plane-based pose estimation (Collins and Bartoli, IJCV 2014).

use super::MarkerPixels;
use crate::{
    camera::CameraModel,
    marker::{MarkerColor, MarkerLayout},
};
use nalgebra::{
    Isometry3, Matrix2, Matrix3, Rotation3, SMatrix, SVector, Translation3, UnitQuaternion,
    Vector2, Vector3,
};

/// Returns the two poses that have the same derivative of the plane-to-image map at the center of
/// the markers.
///
/// The homography (for three markers: the affine map) from the marker plane to normalized image
/// coordinates is solved linearly. Seen by a camera turned towards the center, its derivative is
/// the upper left 2×2 block of the rotation divided by the depth, which leaves two rotations.
/// `None` with fewer than three markers or a degenerate layout.
pub fn closed_form(
    layout: &MarkerLayout,
    camera: &CameraModel,
    pixels: &MarkerPixels,
) -> Option<[Isometry3<f64>; 2]> {
    let mut used: [Option<(Vector3<f64>, Vector2<f64>)>; 4] = [None; 4];
    let (mut count, mut center) = (0usize, Vector3::zeros());
    for color in MarkerColor::ALL {
        let Some((pixel, _)) = &pixels[color] else { continue };
        let point = layout.centers[color].coords;
        used[color.index()] = Some((point, camera.undistort(pixel)?));
        center += point;
        count += 1;
    }
    if count < 3 {
        return None;
    }
    center /= count as f64;
    // Linear equations for the map (a b c; d e f; g h 1); the affine map has g = h = 0.
    let mut rows = SMatrix::<f64, 8, 8>::zeros();
    let mut right = SVector::<f64, 8>::zeros();
    for (i, (point, image)) in used.iter().flatten().enumerate() {
        let (x, y) = (point.x - center.x, point.y - center.y);
        let perspective = if count == 4 { 1.0 } else { 0.0 };
        for (axis, value) in [image.x, image.y].into_iter().enumerate() {
            let row = 2 * i + axis;
            for (k, entry) in [x, y, 1.0].into_iter().enumerate() {
                rows[(row, 3 * axis + k)] = entry;
            }
            rows[(row, 6)] = -x * value * perspective;
            rows[(row, 7)] = -y * value * perspective;
            right[row] = value;
        }
    }
    if count == 3 {
        rows[(6, 6)] = 1.0;
        rows[(7, 7)] = 1.0;
    }
    let h = rows.lu().solve(&right)?;
    let v = Vector2::new(h[2], h[5]);
    let derivative = Matrix2::new(
        h[0] - h[6] * v.x,
        h[1] - h[7] * v.x, //
        h[3] - h[6] * v.y,
        h[4] - h[7] * v.y,
    );
    // Derivative as seen by a camera that is turned towards the center.
    let ray = Vector3::new(v.x, v.y, 1.0);
    let towards = Rotation3::rotation_between(&Vector3::z(), &ray)?;
    let t = towards.matrix();
    let b = Matrix2::new(
        t[(0, 0)] - v.x * t[(2, 0)],
        t[(0, 1)] - v.x * t[(2, 1)],
        t[(1, 0)] - v.y * t[(2, 0)],
        t[(1, 1)] - v.y * t[(2, 1)],
    );
    let a = b.try_inverse()? * derivative;
    let gamma = a.singular_values().max();
    if !(gamma > 1e-9 && gamma.is_finite()) {
        return None;
    }
    let block = a / gamma;
    let m = Matrix2::identity() - block.transpose() * block;
    let b1 = m[(0, 0)].max(0.0).sqrt();
    let b2 = m[(1, 1)].max(0.0).sqrt() * if m[(0, 1)] < 0.0 { -1.0 } else { 1.0 };
    let solution = |sign: f64| -> Option<Isometry3<f64>> {
        let first = Vector3::new(block[(0, 0)], block[(1, 0)], sign * b1).try_normalize(1e-9)?;
        let second = Vector3::new(block[(0, 1)], block[(1, 1)], sign * b2);
        let second = (second - first * first.dot(&second)).try_normalize(1e-9)?;
        let turn = Matrix3::from_columns(&[first, second, first.cross(&second)]);
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(t * turn));
        Some(Isometry3::from_parts(Translation3::from(ray / gamma - rotation * center), rotation))
    };
    Some([solution(1.0)?, solution(-1.0)?])
}
