//! Sides of a predicted outline.

use crate::quad::Quad;
use nalgebra::Vector2;

/// A side of a predicted outline.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Side {
    /// Its middle, px.
    pub middle: Vector2<f64>,
    /// Unit vector along it.
    pub tangent: Vector2<f64>,
    /// Outward unit normal.
    pub normal: Vector2<f64>,
    /// Its length, px.
    pub length: f64,
    /// Distance of the middle from the outline's centroid along the normal, px.
    pub distance: f64,
}

impl Side {
    /// All four sides of an outline whose centroid is `center` (px).
    pub fn of(quad: &Quad, center: Vector2<f64>) -> [Self; 4] {
        std::array::from_fn(|i| {
            let (p, q) = (quad.0[i], quad.0[(i + 1) % 4]);
            let length = (q - p).norm();
            let tangent = (q - p) / length;
            let middle = (p + q) / 2.0;
            let normal = Vector2::new(tangent.y, -tangent.x);
            let distance = normal.dot(&(middle - center));
            let normal = if distance < 0.0 { -normal } else { normal };
            Self { middle, tangent, normal, length, distance: distance.abs() }
        })
    }
}
