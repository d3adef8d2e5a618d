//! Pose from the homography of the marker plane (Zhang 2000; paper, section II-E).

use super::MarkerPixels;
use crate::{
    camera::CameraModel,
    marker::{MarkerColor, MarkerLayout},
};
use nalgebra::{Isometry3, Matrix3, Rotation3, SMatrix, Translation3, UnitQuaternion, Vector3};

/// Smallest ratio of the homography's second smallest to its largest singular value: below it the
/// markers are nearly collinear. Four corners of a square have 0.05.
const RANK: f64 = 1e-6;

/// Returns `camera_from_volant` from the homography H of the marker plane to normalized image
/// coordinates.
///
/// H is the right singular vector of the smallest singular value of the eight linear equations
/// (direct linear transform). With its columns h₁, h₂, h₃ at the scale where |h₁| + |h₂| = 2, the
/// rotation is the one nearest to (h₁, h₂, h₁ × h₂) by singular value decomposition, and h₃ is the
/// position of the markers' center. `None` without all four markers, with nearly collinear ones, or
/// with a pixel outside of the lens model.
pub fn from_homography(
    layout: &MarkerLayout,
    camera: &CameraModel,
    pixels: &MarkerPixels,
) -> Option<Isometry3<f64>> {
    let mean = layout.centers.0.iter().map(|c| c.coords).sum::<Vector3<f64>>() / 4.0;
    let size = layout.centers.0.iter().map(|c| (c.coords - mean).norm()).fold(0.0, f64::max);
    let mut rows = SMatrix::<f64, 9, 9>::zeros();
    for color in MarkerColor::ALL {
        let image = camera.undistort(&pixels[color]?.0)?;
        let place = (layout.centers[color].coords - mean) / size;
        let plane = Vector3::new(place.x, place.y, 1.0).transpose();
        for (axis, value) in [image.x, image.y].into_iter().enumerate() {
            let row = 2 * color.index() + axis;
            rows.fixed_view_mut::<1, 3>(row, 3 * axis).copy_from(&plane);
            rows.fixed_view_mut::<1, 3>(row, 6).copy_from(&(plane * -value));
        }
    }
    if rows.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let svd = rows.svd(false, true);
    if svd.singular_values[7] < RANK * svd.singular_values[0] {
        return None;
    }
    let null = svd.v_t?.row(8).transpose();
    let h = Matrix3::from_row_slice(null.as_slice());
    // The markers are before the camera.
    let h = h * (2.0 * h[(2, 2)].signum() / (h.column(0).norm() + h.column(1).norm()));
    let (h1, h2) = (h.column(0).into_owned(), h.column(1).into_owned());
    let svd = Matrix3::from_columns(&[h1, h2, h1.cross(&h2)]).svd(true, true);
    let rotation =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(svd.u? * svd.v_t?));
    let center = h.column(2) * size;
    let pose = Isometry3::from_parts(Translation3::from(center - rotation * mean), rotation);
    pose.translation.vector.iter().all(|v| v.is_finite()).then_some(pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        marker::PerColor,
        planar_pose::tests::{pose, rig},
    };
    use nalgebra::{Matrix2, Point3, Vector2};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn exact_centers_of_coplanar_markers_give_the_exact_pose(
            x in -0.2..0.2, y in -0.15..0.15, z in 0.7..3.0,
            tilt in 0.0..0.9, direction in -3.1..3.1, yaw in -3.1..3.1,
        ) {
            let at = |x, y| Point3::new(x, y, 0.02);
            let centers = [at(0.15, 0.14), at(-0.15, 0.16), at(-0.16, -0.15), at(0.15, -0.14)];
            let layout = MarkerLayout { side: 0.0, centers: PerColor(centers) };
            let (_, camera) = rig();
            let truth = pose(x, y, z, tilt, direction, yaw);
            let mut pixels = PerColor::from_fn(|c| {
                let place = layout.projected_centroid(c, &camera, &truth)?;
                Some((place.pixel, Matrix2::identity()))
            });
            prop_assume!(pixels.0.iter().all(Option::is_some));
            let found = from_homography(&layout, &camera, &pixels).unwrap();
            let error = truth.inverse() * found;
            prop_assert!(error.translation.vector.norm() < 1e-6, "{error}");
            prop_assert!(error.rotation.angle() < 1e-6, "{error}");
            pixels.0[2] = None;
            prop_assert!(from_homography(&layout, &camera, &pixels).is_none());
        }
    }

    #[test]
    fn collinear_markers_have_no_pose() {
        let layout = MarkerLayout {
            side: 0.0,
            centers: PerColor([0.0, 0.1, 0.2, 0.3].map(|x| Point3::new(x, 0.0, 0.0))),
        };
        let (_, camera) = rig();
        let pixels = PerColor::from_fn(|c| {
            Some((Vector2::new(100.0 * c.index() as f64, 240.0), Matrix2::identity()))
        });
        assert!(from_homography(&layout, &camera, &pixels).is_none());
    }
}
