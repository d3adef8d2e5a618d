//! Quadrangles in the image.

use crate::{image::ImageView, signal::nearest};
use nalgebra::Vector2;

/// Four corners in order around a square's image, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Quad(pub [Vector2<f64>; 4]);

impl Quad {
    /// The quadrangle moved by `by` (px).
    pub fn shifted(&self, by: Vector2<f64>) -> Self {
        Self(self.0.map(|c| c + by))
    }

    /// Signed area (px²; positive where the corners turn from x to y) and area centroid (px).
    pub fn area_and_centroid(&self) -> (f64, Vector2<f64>) {
        let origin = self.0[0];
        let (mut area, mut moment) = (0.0, Vector2::zeros());
        for i in 0..4 {
            let (a, b) = (self.0[i] - origin, self.0[(i + 1) % 4] - origin);
            let cross = a.perp(&b);
            area += cross;
            moment += (a + b) * cross;
        }
        if area.abs() < 1e-9 {
            return (0.0, self.0.iter().sum::<Vector2<f64>>() / 4.0);
        }
        (area / 2.0, origin + moment / (3.0 * area))
    }

    /// N × N points from corner to corner (bilinear), column by column.
    pub fn grid<const N: usize>(&self) -> impl Iterator<Item = Vector2<f64>> {
        let at = |i: usize| i as f64 / (N - 1) as f64;
        (0..N * N).map(move |k| {
            let (u, v) = (at(k / N), at(k % N));
            self.0[0] * (1.0 - u) * (1.0 - v)
                + self.0[1] * u * (1.0 - v)
                + self.0[2] * u * v
                + self.0[3] * (1.0 - u) * v
        })
    }

    /// Bounds within the image: left, top, right, bottom (the last two excluded), px.
    pub fn window(&self, image: &ImageView<'_>, margin: f64) -> [i32; 4] {
        let (w, h) = (image.width as i32, image.height as i32);
        let [x0, y0, x1, y1] = self.bounds(margin);
        let (x0, y0) = (x0.clamp(0, w), y0.clamp(0, h));
        [x0, y0, x1.clamp(x0, w), y1.clamp(y0, h)]
    }

    /// Bounding box with a margin: left, top, right, bottom (the last two excluded), px.
    pub fn bounds(&self, margin: f64) -> [i32; 4] {
        let min = self.0.iter().fold(Vector2::repeat(f64::INFINITY), |m, c| m.inf(c));
        let max = self.0.iter().fold(Vector2::repeat(f64::NEG_INFINITY), |m, c| m.sup(c));
        [
            (min.x - margin).floor() as i32,
            (min.y - margin).floor() as i32,
            (max.x + margin).ceil() as i32 + 1,
            (max.y + margin).ceil() as i32 + 1,
        ]
    }

    /// The sides, each from a corner to the next, px.
    fn sides(&self) -> [Vector2<f64>; 4] {
        std::array::from_fn(|i| self.0[(i + 1) % 4] - self.0[i])
    }

    /// Angles of the sides of another quadrangle from the same sides of this one, rad.
    pub fn turns_to(&self, other: &Self) -> [f64; 4] {
        let (from, to) = (self.sides(), other.sides());
        std::array::from_fn(|i| from[i].perp(&to[i]).atan2(from[i].dot(&to[i])))
    }

    /// Distances between the middles of opposite edges, across them, px.
    pub fn widths(&self) -> [f64; 2] {
        let sides = self.sides();
        let middle = |k: usize| (self.0[k % 4] + self.0[(k + 1) % 4]) / 2.0;
        [0, 1].map(|i| {
            let edge = sides[i] - sides[i + 2];
            (middle(i + 2) - middle(i)).perp(&edge).abs() / edge.norm().max(1e-9)
        })
    }

    /// Thickness (px): the area over the longest side.
    pub fn thickness_of(&self, area: f64) -> f64 {
        let longest = self.sides().iter().map(|side| side.norm()).fold(0.0, f64::max);
        if longest > 0.0 { area.abs() / longest } else { 0.0 }
    }

    /// Whole columns inside on row `y`, from (included) to (excluded); `None` where there is none.
    pub fn span(&self, y: f64) -> Option<(i32, i32)> {
        let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
        for i in 0..4 {
            let (p, q) = (self.0[i], self.0[(i + 1) % 4]);
            if p.y.min(q.y) <= y && y < p.y.max(q.y) {
                let slope = (q.x - p.x) / (q.y - p.y);
                let x = p.x - slope * p.y + slope * y;
                from = from.min(x);
                to = to.max(x);
            }
        }
        // A row above or below crosses no side (and infinity rounds to an arbitrary number).
        if !(-524_288.0 < from && from < to && to < 524_288.0) {
            return None;
        }
        let (from, to) = (nearest(from + 0.5), nearest(to - 0.5) + 1);
        (from < to).then_some((from, to))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_span_holds_the_whole_columns_inside() {
        let quad = |corners: [(f64, f64); 4]| Quad(corners.map(|(x, y)| Vector2::new(x, y)));
        let level = quad([(10.2, 5.5), (30.7, 5.5), (30.7, 20.5), (10.2, 20.5)]);
        for y in -3..30 {
            let inside = (6..=20).contains(&y);
            assert_eq!(level.span(f64::from(y)), inside.then_some((11, 31)), "{y}");
        }
        let tip = quad([(10.25, 0.0), (20.25, 10.0), (10.25, 20.0), (0.25, 10.0)]);
        assert_eq!(tip.span(10.0), Some((1, 21)));
        assert_eq!(tip.span(3.0), Some((8, 14)));
        for beside in [-1.0, 20.5, 400.0] {
            assert_eq!(tip.span(beside), None, "{beside}");
        }
    }
}
