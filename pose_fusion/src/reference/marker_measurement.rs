//! The published visual measurement in its literal form: the markers' coordinates reprojected to
//! the world plane (eq. 8). The paper leaves the height of that plane open; here it is that which
//! the pose gives the marker, so that four markers determine all six numbers of the pose.

use nalgebra::{Matrix3, Point3, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use rig_model::{MarkerColor, MarkerLayout, PerColor};

/// Line from the camera through a marker's pixel, in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SightLine {
    /// The camera's center, m.
    pub origin: Point3<f64>,
    /// Direction of view.
    pub direction: Vector3<f64>,
}

/// Returns the residual of eq. 8 (measured minus predicted \[x_i, y_i\], m) at the
/// pose x, y, z, roll, pitch, yaw (m, rad), and the derivative of the predicted coordinates by it;
/// 0 for a marker that is not used.
pub fn plane_residual(
    pose: &Vector6<f64>,
    layout: &MarkerLayout,
    lines: &PerColor<Option<SightLine>>,
) -> (SVector<f64, 8>, SMatrix<f64, 8, 6>) {
    let rotation = UnitQuaternion::from_euler_angles(pose[3], pose[4], pose[5]);
    let rates = world_rates(pose);
    let mut residual = SVector::<f64, 8>::zeros();
    let mut jacobian = SMatrix::<f64, 8, 6>::zeros();
    for color in MarkerColor::ALL {
        // A horizontal line meets no plane.
        let Some(line) = lines[color].filter(|l| l.direction.z.abs() > 1e-3 * l.direction.norm())
        else {
            continue;
        };
        let arm = rotation * layout.centers[color].coords;
        let marker = pose.fixed_rows::<3>(0) + arm;
        let slope = line.direction.xy() / line.direction.z;
        let reprojected = line.origin.coords.xy() + slope * (marker.z - line.origin.z);
        let mut place = SMatrix::<f64, 3, 6>::zeros();
        place.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        place.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-arm.cross_matrix() * rates));
        let row = 2 * color.index();
        residual.fixed_rows_mut::<2>(row).copy_from(&(reprojected - marker.xy()));
        // The plane moves with the marker's height.
        let rows = place.fixed_rows::<2>(0) - slope * place.row(2);
        jacobian.fixed_rows_mut::<2>(row).copy_from(&rows);
    }
    (residual, jacobian)
}

/// Matrix E of δθ = E δ(roll, pitch, yaw), with δθ about the world's axes.
pub fn world_rates(pose: &Vector6<f64>) -> Matrix3<f64> {
    let (sp, cp) = pose[4].sin_cos();
    let (sy, cy) = pose[5].sin_cos();
    Matrix3::new(cy * cp, -sy, 0.0, sy * cp, cy, 0.0, -sp, 0.0, 1.0)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub fn layout() -> MarkerLayout {
        let at = |x, y| Point3::new(x, y, 0.02);
        let centers = [at(0.15, 0.14), at(-0.15, 0.16), at(-0.16, -0.15), at(0.15, -0.14)];
        MarkerLayout { side: 0.076, centers: PerColor(centers) }
    }

    fn lines(pose: &Vector6<f64>) -> PerColor<Option<SightLine>> {
        let rotation = UnitQuaternion::from_euler_angles(pose[3], pose[4], pose[5]);
        let origin = Point3::new(0.1, 0.2, 2.9);
        PerColor::from_fn(|c| {
            let marker = pose.fixed_rows::<3>(0) + rotation * layout().centers[c].coords;
            Some(SightLine { origin, direction: (marker - origin.coords) * 0.7 })
        })
    }

    #[test]
    fn markers_on_their_lines_leave_no_residual_and_the_jacobian_is_the_difference_quotient() {
        let truth = Vector6::new(0.2, 0.1, 1.4, 0.1, -0.2, 0.7);
        let seen = lines(&truth);
        let (residual, jacobian) = plane_residual(&truth, &layout(), &seen);
        assert!(residual.norm() < 1e-12);
        assert!(jacobian.svd(false, false).singular_values.min() > 0.01, "observable");
        let pose = truth + Vector6::new(0.01, -0.02, 0.03, 0.02, 0.01, -0.03);
        let (here, jacobian) = plane_residual(&pose, &layout(), &seen);
        for i in 0..6 {
            let mut step = Vector6::zeros();
            step[i] = 1e-6;
            let (there, _) = plane_residual(&(pose + step), &layout(), &seen);
            let quotient = (here - there) / 1e-6;
            assert!((quotient - jacobian.column(i)).norm() < 1e-5, "column {i}");
        }
    }

    #[test]
    fn a_marker_without_a_line_is_left_out() {
        let truth = Vector6::new(0.2, 0.1, 1.4, 0.1, -0.2, 0.7);
        let mut seen = lines(&truth);
        seen.0[1] = None;
        if let Some(line) = &mut seen.0[2] {
            line.direction.z = 0.0;
        }
        let (residual, jacobian) = plane_residual(&(truth * 1.01), &layout(), &seen);
        assert!(residual.rows(2, 4).iter().all(|v| *v == 0.0));
        assert!(jacobian.rows(2, 4).iter().all(|v| *v == 0.0));
        assert!(residual.norm() > 1e-4);
    }
}
