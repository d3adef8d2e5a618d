//! The camera's lens: from a point in front of it to a raw pixel and back.
//!
//! Models and the order of their coefficients are those of `sensor_msgs/CameraInfo`: `plumb_bob`
//! (k1, k2, p1, p2, k3), `rational_polynomial` (k1, k2, p1, p2, k3, k4, k5, k6) and `equidistant` (k1 … k4).

use nalgebra::{Matrix2, Matrix2x3, Point3, Vector2, Vector3};
use thiserror::Error;

/// Lens distortion, with its coefficients in the order of `CameraInfo.d`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// k1, k2, p1, p2, k3 (OpenCV's five).
    PlumbBob([f64; 5]),
    /// k1, k2, p1, p2, k3, k4, k5, k6 (OpenCV's eight).
    RationalPolynomial([f64; 8]),
    /// k1, k2, k3, k4 of Kannala and Brandt (OpenCV's fisheye).
    Equidistant([f64; 4]),
}

/// Why a `CameraInfo` cannot be used.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CameraModelError {
    /// A distortion model that is not known.
    #[error(
        "camera_info: distortion model `{model}` is not known; use plumb_bob, rational_polynomial or equidistant"
    )]
    UnknownModel {
        /// As it stood in the message.
        model: String,
    },
    /// Too few or too many coefficients.
    #[error("camera_info: distortion model `{model}` takes {expected} coefficients, but d has {found}")]
    CoefficientCount {
        /// The model's name.
        model: String,
        /// How many it takes.
        expected: usize,
        /// How many there were.
        found: usize,
    },
    /// A focal length, principal point, size or coefficient that cannot be.
    #[error(
        "camera_info: {what} is {value}, which cannot be; calibrate the camera or set its camera_info_url"
    )]
    Implausible {
        /// Which entry.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// The camera crops or bins, so k does not belong to the image as it is sent.
    #[error(
        "camera_info: binning {binning_x}x{binning_y} or a region of interest is set; send full images, or a camera_info without them"
    )]
    Cropped {
        /// `binning_x`.
        binning_x: u32,
        /// `binning_y`.
        binning_y: u32,
    },
}

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
    /// Largest undistorted radius (tan of the angle for the perspective models, the angle itself for equidistant)
    /// up to which the distortion is one to one.
    max_radius: f64,
}

impl CameraModel {
    /// From image size (px), focal lengths and principal point `[fx, fy, cx, cy]` (px) and distortion.
    ///
    /// # Errors
    /// [`CameraModelError::Implausible`] for a size of zero, a focal length that is not positive, or a NaN.
    pub fn new(
        width: u32,
        height: u32,
        [fx, fy, cx, cy]: [f64; 4],
        distortion: Distortion,
    ) -> Result<Self, CameraModelError> {
        let implausible = |what, value| Err(CameraModelError::Implausible { what, value });
        if width == 0 {
            return implausible("width", 0.0);
        }
        if height == 0 {
            return implausible("height", 0.0);
        }
        for (what, value) in [("k[0] (fx)", fx), ("k[4] (fy)", fy)] {
            if !(value.is_finite() && value > 0.0) {
                return implausible(what, value);
            }
        }
        for (what, value) in [("k[2] (cx)", cx), ("k[5] (cy)", cy)] {
            if !value.is_finite() {
                return implausible(what, value);
            }
        }
        let coefficients: &[f64] = match &distortion {
            Distortion::PlumbBob(d) => d,
            Distortion::RationalPolynomial(d) => d,
            Distortion::Equidistant(d) => d,
        };
        if let Some(&value) = coefficients.iter().find(|c| !c.is_finite()) {
            return implausible("an entry of d", value);
        }
        let mut model = Self { width, height, fx, fy, cx, cy, distortion, max_radius: f64::INFINITY };
        model.max_radius = model.find_max_radius();
        Ok(model)
    }

    /// From the fields of a `sensor_msgs/CameraInfo`: `k` row-major 3×3, `d` in the model's order. An empty `d` is a
    /// lens without distortion, an empty model name means `plumb_bob`.
    ///
    /// # Errors
    /// An unknown model, a wrong count of coefficients, or values that cannot be (an uncalibrated camera has k = 0).
    pub fn from_camera_info(
        width: u32,
        height: u32,
        model: &str,
        d: &[f64],
        k: &[f64; 9],
    ) -> Result<Self, CameraModelError> {
        fn coefficients<const N: usize>(model: &str, d: &[f64]) -> Result<[f64; N], CameraModelError> {
            if d.is_empty() {
                return Ok([0.0; N]);
            }
            d.try_into().map_err(|_| CameraModelError::CoefficientCount {
                model: model.to_owned(),
                expected: N,
                found: d.len(),
            })
        }
        let distortion = match model {
            // OpenCV's four-coefficient form is the five-coefficient one with k3 = 0.
            "plumb_bob" | "" if d.len() == 4 => Distortion::PlumbBob([d[0], d[1], d[2], d[3], 0.0]),
            "plumb_bob" | "" => Distortion::PlumbBob(coefficients("plumb_bob", d)?),
            "rational_polynomial" => Distortion::RationalPolynomial(coefficients(model, d)?),
            "equidistant" | "fisheye" => Distortion::Equidistant(coefficients(model, d)?),
            _ => return Err(CameraModelError::UnknownModel { model: model.to_owned() }),
        };
        Self::new(width, height, [k[0], k[4], k[2], k[5]], distortion)
    }

    /// The same lens for images of another size, scaled as a whole; `None` where the sides' ratio differs by more than 1 %
    /// (then something was cropped, and nobody knows what).
    pub fn resized(&self, width: u32, height: u32) -> Option<Self> {
        if (width, height) == (self.width, self.height) {
            return Some(self.clone());
        }
        let (x, y) = (f64::from(width) / f64::from(self.width), f64::from(height) / f64::from(self.height));
        if !(0.99..=1.01).contains(&(x / y)) {
            return None;
        }
        // The centre of the top left pixel is (0, 0), its corner (−½, −½).
        Some(Self {
            width,
            height,
            fx: self.fx * x,
            fy: self.fy * y,
            cx: (self.cx + 0.5) * x - 0.5,
            cy: (self.cy + 0.5) * y - 0.5,
            ..self.clone()
        })
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

    /// The lens distortion.
    pub fn distortion(&self) -> &Distortion {
        &self.distortion
    }

    /// Raw pixel of a point in the camera frame (m). `None` where the point is not in front of the camera or beyond
    /// the angle up to which the lens model is one to one.
    pub fn project(&self, point: &Point3<f64>) -> Option<Vector2<f64>> {
        if !self.is_in_front(point) {
            return None;
        }
        let z_inverse = 1.0 / point.z;
        let d = self.distort(&Vector2::new(point.x * z_inverse, point.y * z_inverse))?;
        Some(Vector2::new(self.fx * d.x + self.cx, self.fy * d.y + self.cy))
    }

    fn is_in_front(&self, point: &Point3<f64>) -> bool {
        point.z > 1e-6 && point.x.is_finite() && point.y.is_finite()
    }

    /// [`CameraModel::project`] with ∂pixel/∂point, px/m.
    #[inline]
    pub fn project_with_jacobian(&self, point: &Point3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        if !self.is_in_front(point) {
            return None;
        }
        let z_inverse = 1.0 / point.z;
        let n = Vector2::new(point.x * z_inverse, point.y * z_inverse);
        let (d, dd) = self.distort_with_jacobian(&n)?;
        // diag(fx, fy) · dd · (1 0 −n.x; 0 1 −n.y)/z, the zeros left out.
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

    /// Unit ray (camera frame) through a raw pixel: the inverse of [`CameraModel::project`], by Newton's method to
    /// 1e-12. `None` where the pixel is outside of what the lens model can reach.
    pub fn ray(&self, pixel: &Vector2<f64>) -> Option<Vector3<f64>> {
        self.undistort(pixel).map(|n| Vector3::new(n.x, n.y, 1.0).normalize())
    }

    /// Undistorted normalised coordinates (x/z, y/z) of a raw pixel; `None` as for [`CameraModel::ray`].
    pub fn undistort(&self, pixel: &Vector2<f64>) -> Option<Vector2<f64>> {
        let target = Vector2::new((pixel.x - self.cx) / self.fx, (pixel.y - self.cy) / self.fy);
        if !(target.x.is_finite() && target.y.is_finite()) {
            return None;
        }
        let mut n = match self.distortion {
            // Far out, the distorted radius of an equidistant lens is an angle, so start from its tangent.
            Distortion::Equidistant(_) => {
                let r = target.norm();
                if r > 1e-9 { target * (r.min(1.5).tan() / r) } else { target }
            }
            _ => target,
        };
        for _ in 0..30 {
            // A step that leaves the one-to-one range is halved until it is back in.
            let (d, dd) = self.distort_with_jacobian(&n)?;
            let residual = target - d;
            if residual.norm() < 1e-12 {
                return Some(n);
            }
            let mut step = dd.try_inverse()? * residual;
            while self.distort_with_jacobian(&(n + step)).is_none() {
                step *= 0.5;
                if step.norm() < 1e-14 {
                    return None;
                }
            }
            n += step;
        }
        let (d, _) = self.distort_with_jacobian(&n)?;
        ((target - d).norm() < 1e-9).then_some(n)
    }

    fn distort(&self, n: &Vector2<f64>) -> Option<Vector2<f64>> {
        let r2 = n.norm_squared();
        let (radial, p1, p2) = match &self.distortion {
            Distortion::PlumbBob([k1, k2, p1, p2, k3]) => (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), p1, p2),
            Distortion::RationalPolynomial([k1, k2, p1, p2, k3, k4, k5, k6]) => {
                let top = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                (top / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))), p1, p2)
            }
            Distortion::Equidistant(_) => return self.distort_with_jacobian(n).map(|(d, _)| d),
        };
        (r2 <= self.max_radius * self.max_radius).then(|| {
            Vector2::new(
                n.x * radial + 2.0 * p1 * n.x * n.y + p2 * (r2 + 2.0 * n.x * n.x),
                n.y * radial + p1 * (r2 + 2.0 * n.y * n.y) + 2.0 * p2 * n.x * n.y,
            )
        })
    }

    #[inline]
    fn distort_with_jacobian(&self, n: &Vector2<f64>) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let r2 = n.norm_squared();
        match &self.distortion {
            Distortion::PlumbBob([k1, k2, p1, p2, k3]) => {
                if r2 > self.max_radius * self.max_radius {
                    return None;
                }
                let radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                let by_r2 = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
                Some(radial_and_tangential(n, radial, by_r2, *p1, *p2))
            }
            Distortion::RationalPolynomial([k1, k2, p1, p2, k3, k4, k5, k6]) => {
                if r2 > self.max_radius * self.max_radius {
                    return None;
                }
                let top = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
                let bottom = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
                let d_top = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
                let d_bottom = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
                let radial = top / bottom;
                Some(radial_and_tangential(n, radial, (d_top - radial * d_bottom) / bottom, *p1, *p2))
            }
            Distortion::Equidistant(k) => {
                let r = r2.sqrt();
                if r < 1e-8 {
                    return Some((*n, Matrix2::identity()));
                }
                let theta = r.atan();
                if theta > self.max_radius {
                    return None;
                }
                let (theta_d, by_theta) = equidistant_angle(k, theta);
                let scale = theta_d / r;
                // d(theta_d/r)/dr · n·nᵀ/r + theta_d/r · I
                let by_r = (by_theta / (1.0 + r2) - scale) / r;
                Some((n * scale, Matrix2::identity() * scale + n * n.transpose() * (by_r / r)))
            }
        }
    }

    /// The first radius at which the distorted radius stops growing.
    fn find_max_radius(&self) -> f64 {
        let (growth, limit): (Box<dyn Fn(f64) -> f64>, f64) = match self.distortion {
            Distortion::PlumbBob([k1, k2, _, _, k3]) => (
                Box::new(move |r| {
                    let s = r * r;
                    1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * 7.0 * k3))
                }),
                10.0,
            ),
            Distortion::RationalPolynomial([k1, k2, _, _, k3, k4, k5, k6]) => (
                Box::new(move |r| {
                    let s = r * r;
                    let top = 1.0 + s * (k1 + s * (k2 + s * k3));
                    let bottom = 1.0 + s * (k4 + s * (k5 + s * k6));
                    let d_top = 2.0 * s * (k1 + s * (2.0 * k2 + s * 3.0 * k3));
                    let d_bottom = 2.0 * s * (k4 + s * (2.0 * k5 + s * 3.0 * k6));
                    if bottom <= 0.0 {
                        -1.0
                    } else {
                        top / bottom + (d_top * bottom - top * d_bottom) / (bottom * bottom)
                    }
                }),
                10.0,
            ),
            Distortion::Equidistant(k) => {
                (Box::new(move |theta| equidistant_angle(&k, theta).1), std::f64::consts::FRAC_PI_2)
            }
        };
        let steps = 10_000;
        (1..=steps)
            .map(|i| limit * f64::from(i) / f64::from(steps))
            .find(|&r| growth(r) <= 0.0)
            .unwrap_or(limit)
    }
}

#[inline]
fn radial_and_tangential(
    n: &Vector2<f64>,
    radial: f64,
    by_r2: f64,
    p1: f64,
    p2: f64,
) -> (Vector2<f64>, Matrix2<f64>) {
    let (x, y) = (n.x, n.y);
    let r2 = x * x + y * y;
    let d = Vector2::new(
        x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
        y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
    );
    let cross = 2.0 * x * y * by_r2 + 2.0 * p1 * x + 2.0 * p2 * y;
    let jacobian = Matrix2::new(
        radial + 2.0 * x * x * by_r2 + 2.0 * p1 * y + 6.0 * p2 * x,
        cross,
        cross,
        radial + 2.0 * y * y * by_r2 + 6.0 * p1 * y + 2.0 * p2 * x,
    );
    (d, jacobian)
}

/// Distorted angle and its derivative.
fn equidistant_angle([k1, k2, k3, k4]: &[f64; 4], theta: f64) -> (f64, f64) {
    let s = theta * theta;
    (
        theta * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4)))),
        1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4))),
    )
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
        fn a_pixel_s_ray_leads_back_to_the_pixel(u in 0.0..639.0, v in 0.0..479.0, depth in 0.1..10.0) {
            for camera in cameras() {
                let pixel = Vector2::new(u, v);
                let ray = camera.ray(&pixel).unwrap();
                let back = camera.project(&Point3::from(ray * depth)).unwrap();
                prop_assert!((back - pixel).norm() < 1e-8);
            }
        }

        #[test]
        fn the_jacobian_is_the_numerical_one(x in -0.5..0.5, y in -0.4..0.4, z in 0.8..3.0) {
            for camera in cameras() {
                let p = Point3::new(x, y, z);
                let (pixel, jacobian) = camera.project_with_jacobian(&p).unwrap();
                prop_assert!((camera.project(&p).unwrap() - pixel).norm() < 1e-10);
                for axis in 0..3 {
                    let mut step = Vector3::zeros();
                    step[axis] = 1e-6;
                    let numeric = (camera.project(&(p + step)).unwrap() - camera.project(&(p - step)).unwrap()) / 2e-6;
                    prop_assert!((numeric - jacobian.column(axis)).norm() < 1e-5 * (1.0 + numeric.norm()));
                }
            }
        }
    }

    #[test]
    fn what_is_behind_the_camera_or_beyond_the_lens_is_not_projected() {
        let strong = CameraModel::new(
            640,
            480,
            [600.0, 600.0, 320.0, 240.0],
            Distortion::PlumbBob([-0.3, 0.0, 0.0, 0.0, 0.0]),
        )
        .unwrap();
        assert_eq!(strong.project(&Point3::new(0.0, 0.0, -1.0)), None);
        assert_eq!(strong.project(&Point3::new(0.0, 0.0, 0.0)), None);
        // r + k1 r³ turns back at r = 1/sqrt(0.9) = 1.05: beyond that a point would fold into the image.
        assert!(strong.project(&Point3::new(1.0, 0.0, 1.0)).is_some());
        assert_eq!(strong.project(&Point3::new(1.2, 0.0, 1.0)), None);
        assert_eq!(strong.project(&Point3::new(f64::NAN, 0.0, 1.0)), None);
    }

    #[test]
    fn a_scaled_camera_sees_a_scaled_image() {
        for camera in cameras() {
            let half = camera.resized(320, 240).unwrap();
            let p = Point3::new(0.21, -0.13, 1.1);
            let (whole, half) = (camera.project(&p).unwrap(), half.project(&p).unwrap());
            assert!(((whole + Vector2::repeat(0.5)) / 2.0 - (half + Vector2::repeat(0.5))).norm() < 1e-9);
            assert!(camera.resized(640, 360).is_none());
        }
    }

    #[test]
    fn a_camera_info_that_cannot_be_is_named() {
        let k = [591.0, 0.0, 319.0, 0.0, 589.0, 235.0, 0.0, 0.0, 1.0];
        assert!(CameraModel::from_camera_info(640, 480, "plumb_bob", &[0.0; 5], &k).is_ok());
        assert!(matches!(
            CameraModel::from_camera_info(640, 480, "brown", &[0.0; 5], &k),
            Err(CameraModelError::UnknownModel { .. })
        ));
        assert!(matches!(
            CameraModel::from_camera_info(640, 480, "plumb_bob", &[0.0; 8], &k),
            Err(CameraModelError::CoefficientCount { expected: 5, found: 8, .. })
        ));
        let error = CameraModel::from_camera_info(640, 480, "plumb_bob", &[], &[0.0; 9]).unwrap_err();
        assert!(error.to_string().contains("fx"), "{error}");
    }
}
