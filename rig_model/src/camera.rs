//! Camera model: projection of points in the camera frame to raw pixels, and its inverse.
//!
//! Models and the order of their coefficients are those of `sensor_msgs/CameraInfo`: `plumb_bob`
//! (k1, k2, p1, p2, k3), `rational_polynomial` (k1, k2, p1, p2, k3, k4, k5, k6) and `equidistant`
//! (k1 … k4).

mod distortion;

pub use distortion::Distortion;

use nalgebra::{Matrix2x3, Point3, Vector2, Vector3};
use thiserror::Error;

/// Invalid `CameraInfo`: which entry is unknown, of another length or invalid, and what to do.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("camera_info: {0}")]
pub struct CameraModelError(pub String);

/// Intrinsic parameters of a camera.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraModel {
    width: u32,
    height: u32,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    distortion: Distortion,
    /// See [`Distortion::max_radius`].
    max_radius: f64,
}

impl CameraModel {
    /// Creates a model from image size (px), `[fx, fy, cx, cy]` (px) and distortion.
    ///
    /// # Errors
    /// [`CameraModelError`] for a size of zero, a focal length ≤ 0, or a non-finite value.
    pub fn new(
        width: u32,
        height: u32,
        [fx, fy, cx, cy]: [f64; 4],
        distortion: Distortion,
    ) -> Result<Self, CameraModelError> {
        let positive = [
            ("width", f64::from(width)),
            ("height", f64::from(height)),
            ("k[0] (fx)", fx),
            ("k[4] (fy)", fy),
        ];
        let finite = [("k[2] (cx)", cx), ("k[5] (cy)", cy)]
            .into_iter()
            .chain(distortion.coefficients().iter().map(|d| ("an entry of d", *d)));
        let invalid =
            positive.into_iter().filter(|(_, value)| !(value.is_finite() && *value > 0.0));
        let invalid = invalid.chain(finite.filter(|(_, value)| !value.is_finite())).next();
        if let Some((what, value)) = invalid {
            return Err(CameraModelError(format!(
                "{what} is {value}, which is invalid; calibrate the camera or set its \
                 camera_info_url"
            )));
        }
        let max_radius = distortion.max_radius();
        Ok(Self { width, height, fx, fy, cx, cy, distortion, max_radius })
    }

    /// Creates a model from the fields of a `sensor_msgs/CameraInfo`.
    ///
    /// `k` is the row-major 3×3 camera matrix, px; `d` has the order of the model. An empty `d`
    /// means no distortion, an empty `model` means `plumb_bob`.
    ///
    /// # Errors
    /// [`CameraModelError`] for an unknown model, a wrong number of coefficients, or invalid values
    /// (an uncalibrated camera has k = 0).
    pub fn from_camera_info(
        width: u32,
        height: u32,
        model: &str,
        d: &[f64],
        k: &[f64; 9],
    ) -> Result<Self, CameraModelError> {
        fn coefficients<const N: usize>(
            model: &str,
            d: &[f64],
        ) -> Result<[f64; N], CameraModelError> {
            if d.is_empty() {
                return Ok([0.0; N]);
            }
            d.try_into().map_err(|_| {
                CameraModelError(format!(
                    "d has {} coefficients; the distortion model `{model}` has {N}",
                    d.len()
                ))
            })
        }
        let distortion = match model {
            // OpenCV's form with four coefficients has k3 = 0.
            "plumb_bob" | "" if d.len() == 4 => Distortion::PlumbBob([d[0], d[1], d[2], d[3], 0.0]),
            "plumb_bob" | "" => Distortion::PlumbBob(coefficients("plumb_bob", d)?),
            "rational_polynomial" => Distortion::RationalPolynomial(coefficients(model, d)?),
            "equidistant" | "fisheye" => Distortion::Equidistant(coefficients(model, d)?),
            _ => {
                return Err(CameraModelError(format!(
                    "distortion model `{model}` is unknown; use plumb_bob, rational_polynomial or \
                     equidistant"
                )));
            }
        };
        Self::new(width, height, [k[0], k[4], k[2], k[5]], distortion)
    }

    /// Image size (width, height), px.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// Focal lengths (fx, fy), px.
    pub fn focal_lengths(&self) -> Vector2<f64> {
        Vector2::new(self.fx, self.fy)
    }

    /// Principal point (cx, cy), px.
    pub fn principal_point(&self) -> Vector2<f64> {
        Vector2::new(self.cx, self.cy)
    }

    /// Lens distortion.
    pub fn distortion(&self) -> &Distortion {
        &self.distortion
    }

    /// Projects a point in the camera frame (m) to a raw (distorted) pixel.
    ///
    /// `None` if the point is not in front of the camera, or beyond the angle up to which the lens
    /// model is one to one.
    pub fn project(&self, point: &Point3<f64>) -> Option<Vector2<f64>> {
        self.project_with_jacobian(point).map(|(pixel, _)| pixel)
    }

    /// [`CameraModel::project`] with ∂pixel/∂point (2×3), px/m.
    #[inline]
    pub fn project_with_jacobian(
        &self,
        point: &Point3<f64>,
    ) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        if !(point.z > 1e-6 && point.x.is_finite() && point.y.is_finite()) {
            return None;
        }
        let z_inverse = 1.0 / point.z;
        let n = Vector2::new(point.x * z_inverse, point.y * z_inverse);
        let (d, dd) = self.distortion.apply(&n, self.max_radius)?;
        // diag(fx, fy) · dd · (1 0 −n.x; 0 1 −n.y)/z
        let (a, b) = (self.fx * dd.m11, self.fx * dd.m12);
        let (c, d_y) = (self.fy * dd.m21, self.fy * dd.m22);
        let (towards_x, towards_y) = (-n.x * z_inverse, -n.y * z_inverse);
        let by_point = Matrix2x3::new(
            a * z_inverse,
            b * z_inverse,
            a * towards_x + b * towards_y, //
            c * z_inverse,
            d_y * z_inverse,
            c * towards_x + d_y * towards_y,
        );
        Some((Vector2::new(self.fx * d.x + self.cx, self.fy * d.y + self.cy), by_point))
    }

    /// Returns the unit ray (camera frame) through a raw pixel: the inverse of
    /// [`CameraModel::project`].
    ///
    /// `None` if the pixel is outside the range of the lens model.
    pub fn ray(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        self.undistort(pixel).map(|n| Vector3::new(n.x, n.y, 1.0).normalize())
    }

    /// Returns the undistorted normalized coordinates (x/z, y/z) of a raw pixel.
    ///
    /// Newton's method, to a residual of 1e-12. `None` as for [`CameraModel::ray`].
    pub fn undistort(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        let target = Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy);
        if !(target.x.is_finite() && target.y.is_finite()) {
            return None;
        }
        let mut n = match self.distortion {
            // The distorted radius of an equidistant lens is close to the angle: start from its
            // tangent.
            Distortion::Equidistant(_) => {
                let r = target.norm();
                if r > 1e-9 { target * (r.min(1.5).tan() / r) } else { target }
            }
            _ => target,
        };
        let distort = |n: &Vector2<f64>| self.distortion.apply(n, self.max_radius);
        for _ in 0..30 {
            let (d, dd) = distort(&n)?;
            let residual = target - d;
            if residual.norm() < 1e-12 {
                return Some(n);
            }
            // A step that leaves the one-to-one range is halved.
            let mut step = dd.try_inverse()? * residual;
            while distort(&(n + step)).is_none() {
                step *= 0.5;
                if step.norm() < 1e-14 {
                    return None;
                }
            }
            n += step;
        }
        let (d, _) = distort(&n)?;
        ((target - d).norm() < 1e-9).then_some(n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn cameras() -> Vec<CameraModel> {
        [
            Distortion::PlumbBob([0.0; 5]),
            Distortion::PlumbBob([-0.23, 0.082, 7e-4, -4e-4, -0.006]),
            Distortion::RationalPolynomial([0.3, 0.02, 1e-3, -5e-4, 0.003, 0.6, 0.05, 0.002]),
            Distortion::Equidistant([-0.01, 0.02, -0.005, 0.001]),
        ]
        .into_iter()
        .map(|d| CameraModel::new(640, 480, [591.0, 589.0, 319.3, 235.2], d).unwrap())
        .collect()
    }

    proptest! {
        #[test]
        fn ray_and_projection_are_inverse(u in 0.0..639.0, v in 0.0..479.0, depth in 0.1..10.0) {
            for camera in cameras() {
                let pixel = Vector2::new(u, v);
                let ray = camera.ray(&pixel).unwrap();
                let back = camera.project(&Point3::from(ray * depth)).unwrap();
                prop_assert!((back - pixel).norm() < 1e-8);
            }
        }

        #[test]
        fn the_jacobian_equals_the_numerical_one(x in -0.5..0.5, y in -0.4..0.4, z in 0.8..3.0) {
            for camera in cameras() {
                let p = Point3::new(x, y, z);
                let (_, jacobian) = camera.project_with_jacobian(&p).unwrap();
                for axis in 0..3 {
                    let mut step = Vector3::zeros();
                    step[axis] = 1e-6;
                    let at = |p: Point3<f64>| camera.project(&p).unwrap();
                    let numeric = (at(p + step) - at(p - step)) / 2e-6;
                    let error = (numeric - jacobian.column(axis)).norm();
                    prop_assert!(error < 1e-5 * (1.0 + numeric.norm()));
                }
            }
        }
    }

    #[test]
    fn points_behind_the_camera_or_beyond_the_lens_range_are_not_projected() {
        let lens = Distortion::PlumbBob([-0.3, 0.0, 0.0, 0.0, 0.0]);
        let strong = CameraModel::new(640, 480, [600.0, 600.0, 320.0, 240.0], lens).unwrap();
        assert_eq!(strong.project(&Point3::new(0.0, 0.0, -1.0)), None);
        assert_eq!(strong.project(&Point3::new(0.0, 0.0, 0.0)), None);
        // r + k1 r³ has its maximum at r = 1/sqrt(0.9) = 1.05; points beyond would fold into the
        // image.
        assert!(strong.project(&Point3::new(1.0, 0.0, 1.0)).is_some());
        assert_eq!(strong.project(&Point3::new(1.2, 0.0, 1.0)), None);
        assert_eq!(strong.project(&Point3::new(f64::NAN, 0.0, 1.0)), None);
    }

    #[test]
    fn errors_name_the_invalid_entry_of_camera_info() {
        let k = [591.0, 0.0, 319.0, 0.0, 589.0, 235.0, 0.0, 0.0, 1.0];
        assert!(CameraModel::from_camera_info(640, 480, "plumb_bob", &[0.0; 5], &k).is_ok());
        let error = |model, d: &[f64], k| {
            CameraModel::from_camera_info(640, 480, model, d, k).unwrap_err().to_string()
        };
        assert!(error("brown", &[0.0; 5], &k).contains("model `brown` is unknown"));
        assert!(error("plumb_bob", &[0.0; 8], &k).contains("8 coefficients; the distortion model"));
        assert!(error("plumb_bob", &[], &[0.0; 9]).contains("k[0] (fx) is 0"));
    }
}
