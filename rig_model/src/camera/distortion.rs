//! Lens distortion: the models of `sensor_msgs/CameraInfo`, with derivatives.

use nalgebra::{Matrix2, Vector2};

/// Lens distortion with its coefficients in the order of `CameraInfo.d`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Distortion {
    /// k1, k2, p1, p2, k3 (OpenCV's five).
    PlumbBob([f64; 5]),
    /// k1, k2, p1, p2, k3, k4, k5, k6 (OpenCV's eight).
    RationalPolynomial([f64; 8]),
    /// k1, k2, k3, k4 (Kannala and Brandt 2006; OpenCV's fisheye).
    Equidistant([f64; 4]),
}

impl Distortion {
    /// Coefficients in the order of `CameraInfo.d`.
    pub fn coefficients(&self) -> &[f64] {
        match self {
            Self::PlumbBob(d) => d,
            Self::RationalPolynomial(d) => d,
            Self::Equidistant(d) => d,
        }
    }

    /// Distorts normalized coordinates (x/z, y/z), with the derivative ∂distorted/∂undistorted;
    /// `None` beyond `max_radius`.
    #[inline]
    pub(super) fn apply(
        &self,
        n: &Vector2<f64>,
        max_radius: f64,
    ) -> Option<(Vector2<f64>, Matrix2<f64>)> {
        let r2 = n.norm_squared();
        match self {
            Self::PlumbBob([_, _, p1, p2, ..]) | Self::RationalPolynomial([_, _, p1, p2, ..]) => {
                if r2 > max_radius * max_radius {
                    return None;
                }
                let (radial, by_r2) = self.radial(r2)?;
                Some(radial_and_tangential(n, radial, by_r2, *p1, *p2))
            }
            Self::Equidistant(k) => {
                let r = r2.sqrt();
                if r < 1e-8 {
                    return Some((*n, Matrix2::identity()));
                }
                let theta = r.atan();
                if theta > max_radius {
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

    /// Largest undistorted radius up to which the distortion is one to one.
    ///
    /// The radius is tan θ for the perspective models and θ, rad, for the equidistant one (θ: angle
    /// from the optical axis). The first zero of the derivative of the distorted radius, searched
    /// in steps of 1e-4 of the range.
    pub(super) fn max_radius(&self) -> f64 {
        let limit = match self {
            Self::Equidistant(_) => std::f64::consts::FRAC_PI_2,
            _ => 10.0,
        };
        let steps = 10_000;
        let grows = |r: f64| match self {
            Self::Equidistant(k) => equidistant_angle(k, r).1 > 0.0,
            _ => {
                let radial = self.radial(r * r);
                radial.is_some_and(|(radial, by_r2)| radial + 2.0 * r * r * by_r2 > 0.0)
            }
        };
        (1..=steps)
            .map(|i| limit * f64::from(i) / f64::from(steps))
            .find(|&r| !grows(r))
            .unwrap_or(limit)
    }

    /// Radial factor of a perspective model at the squared radius `r2`, and its derivative by `r2`.
    ///
    /// `None` where the denominator of the rational model is not positive.
    #[inline]
    fn radial(&self, r2: f64) -> Option<(f64, f64)> {
        let polynomial = |a: f64, b: f64, c: f64| {
            (1.0 + r2 * (a + r2 * (b + r2 * c)), a + r2 * (2.0 * b + r2 * 3.0 * c))
        };
        match *self {
            Self::PlumbBob([k1, k2, _, _, k3]) => Some(polynomial(k1, k2, k3)),
            Self::RationalPolynomial([k1, k2, _, _, k3, k4, k5, k6]) => {
                let (top, d_top) = polynomial(k1, k2, k3);
                let (bottom, d_bottom) = polynomial(k4, k5, k6);
                let radial = top / bottom;
                (bottom > 0.0).then_some((radial, (d_top - radial * d_bottom) / bottom))
            }
            Self::Equidistant(_) => None,
        }
    }
}

/// Radial and tangential (Brown–Conrady) distortion and its derivative; `by_r2` = ∂radial/∂r².
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

/// Distorted angle θ·(1 + k1·θ² + k2·θ⁴ + k3·θ⁶ + k4·θ⁸) and its derivative.
fn equidistant_angle([k1, k2, k3, k4]: &[f64; 4], theta: f64) -> (f64, f64) {
    let s = theta * theta;
    (
        theta * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4)))),
        1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4))),
    )
}
