//! The four colored squares: layout on the platform and projection into the image.

use crate::camera::CameraModel;
use nalgebra::{Isometry3, Matrix2x3, Point3, Vector2, Vector3};
use std::{
    fmt,
    ops::{Index, IndexMut},
};

/// Color of a marker, which identifies it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum MarkerColor {
    /// Red, 0.
    Red = 0,
    /// Green, 1.
    Green = 1,
    /// Blue, 2.
    Blue = 2,
    /// Yellow, 3.
    Yellow = 3,
}

impl MarkerColor {
    /// All four in the order of `MarkerObservations`.
    pub const ALL: [MarkerColor; 4] =
        [MarkerColor::Red, MarkerColor::Green, MarkerColor::Blue, MarkerColor::Yellow];

    /// Lowercase name, as in the rig file.
    pub const fn name(self) -> &'static str {
        match self {
            MarkerColor::Red => "red",
            MarkerColor::Green => "green",
            MarkerColor::Blue => "blue",
            MarkerColor::Yellow => "yellow",
        }
    }

    /// Index in [`MarkerColor::ALL`].
    pub const fn index(self) -> usize {
        self as usize
    }
}

impl fmt::Display for MarkerColor {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// One value per marker.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PerColor<T>(pub [T; 4]);

impl<T> PerColor<T> {
    /// Calls `f` for each color in the order of [`MarkerColor::ALL`].
    pub fn from_fn(mut f: impl FnMut(MarkerColor) -> T) -> Self {
        Self(MarkerColor::ALL.map(&mut f))
    }

    /// Iterates over colors and values.
    pub fn iter(&self) -> impl Iterator<Item = (MarkerColor, &T)> {
        MarkerColor::ALL.into_iter().zip(self.0.iter())
    }
}

impl<T> Index<MarkerColor> for PerColor<T> {
    type Output = T;
    fn index(&self, color: MarkerColor) -> &T {
        &self.0[color.index()]
    }
}

impl<T> IndexMut<MarkerColor> for PerColor<T> {
    fn index_mut(&mut self, color: MarkerColor) -> &mut T {
        &mut self.0[color.index()]
    }
}

/// Layout of the markers on the platform.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerLayout {
    /// Side of each square, m.
    pub side: f64,
    /// Centers in the volant frame, m.
    ///
    /// Each square lies in a plane of constant z of that frame; its rotation within the plane is
    /// unknown.
    pub centers: PerColor<Point3<f64>>,
}

/// Centroid of a projected square, with its derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProjectedCentroid {
    /// Area centroid of the image, raw (distorted) px.
    pub pixel: Vector2<f64>,
    /// ∂pixel/∂(center in the camera frame), px/m, at constant orientation: the mean over the
    /// square.
    ///
    /// Neglects the change of the area weights, which is of the order of the centroid shift.
    pub jacobian_by_center: Matrix2x3<f64>,
    /// ∂pixel/∂(rotation about the square's center), px/rad, as a rotation vector in the camera
    /// frame.
    ///
    /// Derivative of the centroid's shift −4h²/(3z)·∂π/∂p·(e_z − n·n_z), which is of second order
    /// in the half side h; n is the normal of the square.
    pub jacobian_by_turn: Matrix2x3<f64>,
    /// Area of the image, px², to second order in the side.
    pub area: f64,
}

impl MarkerLayout {
    /// Projects the square `color` and returns the area centroid of its image.
    ///
    /// The near part of a tilted square appears larger, so that the centroid differs from the image
    /// of the center by about 4·f·h²·sinθ·cosθ/(3·z²) px (h: half the side). The integral
    /// ∫ π(u)·|∂π/∂u| du / ∫ |∂π/∂u| du over the square is computed with 2×2 Gauss–Legendre points,
    /// which are exact for cubic integrands and include lens distortion. The second moments of a
    /// square are equal in all directions; to that order the result does not depend on the rotation
    /// within the plane.
    ///
    /// `None` if one of the four points is behind the camera or outside the lens model's range.
    #[inline]
    pub fn projected_centroid(
        &self,
        color: MarkerColor,
        camera: &CameraModel,
        camera_from_volant: &Isometry3<f64>,
    ) -> Option<ProjectedCentroid> {
        let offset = self.side / 2.0 / 3f64.sqrt();
        let center = self.centers[color];
        let u = camera_from_volant.rotation * Vector3::x();
        let v = camera_from_volant.rotation * Vector3::y();
        let center_camera = camera_from_volant * center;
        let (mut weight, mut pixel, mut jacobian) = (0.0, Vector2::zeros(), Matrix2x3::zeros());
        for (su, sv) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            let point = center_camera + u * (su * offset) + v * (sv * offset);
            let (p, dp) = camera.project_with_jacobian(&point)?;
            let (pu, pv) = (dp * u, dp * v);
            let density = (pu.x * pv.y - pu.y * pv.x).abs();
            weight += density;
            pixel += p * density;
            jacobian += dp * density;
        }
        (weight > 0.0 && weight.is_finite()).then(|| {
            let jacobian_by_center = jacobian / weight;
            let n = u.cross(&v);
            let n_cross = n.cross_matrix();
            let shift = self.side * self.side / (3.0 * center_camera.z);
            ProjectedCentroid {
                pixel: pixel / weight,
                jacobian_by_center,
                jacobian_by_turn: jacobian_by_center
                    * ((n_cross * n.z + n * n_cross.row(2)) * -shift),
                area: weight / 4.0 * self.side * self.side,
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Distortion;
    use nalgebra::{Rotation3, Translation3, UnitQuaternion, Vector3};

    fn camera() -> CameraModel {
        let lens = Distortion::PlumbBob([-0.23, 0.08, 7e-4, -4e-4, -0.006]);
        CameraModel::new(640, 480, [590.0, 590.0, 319.5, 239.5], lens).unwrap()
    }

    /// A square of 76 mm in the origin, and its pose in the camera frame.
    fn square(x: f64, y: f64, z: f64, tilt: f64) -> (MarkerLayout, Isometry3<f64>) {
        let rotation = UnitQuaternion::from_euler_angles(std::f64::consts::PI - tilt, 0.1, 0.4);
        let layout = MarkerLayout { side: 0.076, centers: PerColor([Point3::origin(); 4]) };
        (layout, Isometry3::from_parts(Translation3::new(x, y, z), rotation))
    }

    /// Centroid and area from 400×400 cells of the square.
    fn centroid_by_cells(
        camera: &CameraModel,
        pose: &Isometry3<f64>,
        side: f64,
        turn: f64,
    ) -> (Vector2<f64>, f64) {
        let n = 400;
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), turn);
        let (mut w, mut s) = (0.0, Vector2::zeros());
        for i in 0..n {
            for j in 0..n {
                let cell = |k: usize| ((k as f64 + 0.5) / n as f64 - 0.5) * side;
                let p = pose * Point3::from(turn * Vector3::new(cell(i), cell(j), 0.0));
                let (pixel, d) = camera.project_with_jacobian(&p).unwrap();
                let (a, b) =
                    (d * (pose.rotation * Vector3::x()), d * (pose.rotation * Vector3::y()));
                let area = (a.x * b.y - a.y * b.x).abs();
                w += area;
                s += pixel * area;
            }
        }
        (s / w, w / (n * n) as f64 * side * side)
    }

    #[test]
    fn four_gauss_points_give_the_centroid_for_any_rotation_within_the_plane() {
        let camera = camera();
        for (tilt, turn) in [(0.0, 0.2), (0.35, 0.0), (0.35, 0.7), (0.8, 0.4), (1.0, 1.2)] {
            let (layout, pose) = square(0.2, -0.15, 1.0, tilt);
            let (truth, area) = centroid_by_cells(&camera, &pose, layout.side, turn);
            let ours = layout.projected_centroid(MarkerColor::Red, &camera, &pose).unwrap();
            let error = (ours.pixel - truth).norm();
            assert!(error < 2e-3, "{tilt} {turn}: {error}");
            assert!((ours.area / area - 1.0).abs() < 2e-3);
        }
    }

    #[test]
    fn derivatives_equal_numerical_ones() {
        let camera = camera();
        for tilt in [0.0, 0.2, 0.6] {
            let (layout, pose) = square(0.15, -0.1, 1.1, tilt);
            let at = |pose: &Isometry3<f64>| {
                layout.projected_centroid(MarkerColor::Red, &camera, pose).unwrap()
            };
            let ours = at(&pose);
            let h = 1e-5;
            for axis in 0..3 {
                let mut step = Vector3::zeros();
                step[axis] = h;
                let shifted = |s: f64| at(&(Translation3::from(step * s) * pose)).pixel;
                let by_center = (shifted(1.0) - shifted(-1.0)) / (2.0 * h);
                assert!((by_center - ours.jacobian_by_center.column(axis)).norm() < 2.0, "{axis}");
                let turned = |s: f64| {
                    let turn = UnitQuaternion::from_scaled_axis(step * s);
                    at(&Isometry3::from_parts(pose.translation, turn * pose.rotation)).pixel
                };
                let by_turn = (turned(1.0) - turned(-1.0)) / (2.0 * h);
                let error = (by_turn - ours.jacobian_by_turn.column(axis)).norm();
                assert!(error < 0.1, "{tilt} {axis}: {by_turn} {}", ours.jacobian_by_turn);
            }
        }
    }
}
