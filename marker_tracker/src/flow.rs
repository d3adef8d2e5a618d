//! Optical flow after Lucas and Kanade on a marker's soft binary image, from its gradient pixels alone.
//!
//! The colour signal is the binary image of the paper, only not yet rounded: 1 on the marker, 0 beside it. All that its flow
//! can be told from lies on the outline, so some 40 pixels there stand for the window (eq. 1).

use crate::{
    quad::Quad,
    signal::{Sampler, nearest},
};
use nalgebra::Vector2;

/// Pixels that are kept.
const MAX_POINTS: usize = 64;
/// Iterations; each is one step of Gauss and Newton.
const ITERATIONS: usize = 5;

/// A pixel on the outline, its signal and the signal's gradient.
#[derive(Clone, Copy, Debug, Default)]
struct Point {
    x: i32,
    y: i32,
    value: f32,
    gx: f32,
    gy: f32,
}

/// What a marker's outline looked like in the previous image.
#[derive(Clone, Debug)]
pub(crate) struct Outline {
    points: [Point; MAX_POINTS],
    count: usize,
    /// Σ g·gᵀ: xx, xy, yy.
    normal: [f32; 3],
}

impl Default for Outline {
    fn default() -> Self {
        Self { points: [Point::default(); MAX_POINTS], count: 0, normal: [0.0; 3] }
    }
}

impl Outline {
    /// Remembers pixels on each edge.
    pub fn remember(&mut self, sampler: &Sampler<'_>, quad: &Quad) {
        self.count = 0;
        self.normal = [0.0; 3];
        const PER_EDGE: i32 = 10;
        for i in 0..4 {
            let (p, q) = (quad.0[i], quad.0[(i + 1) % 4]);
            let d = q - p;
            let step = d / f64::from(PER_EDGE);
            let mut at = p + step * 0.5;
            // A straight edge's gradient is along its normal: one difference, along the axis that it is nearer to, tells it.
            let (dx, dy) = if d.x.abs() > d.y.abs() { (0, 1) } else { (1, 0) };
            let (gx, gy) = if dx == 1 { (1.0, -d.x / d.y) } else { (-d.y / d.x, 1.0) };
            for _ in 0..PER_EDGE {
                let (x, y) = (nearest(at.x), nearest(at.y));
                at += step;
                let (Some(value), Some(before), Some(after)) =
                    (sampler.at(x, y), sampler.at(x - dx, y - dy), sampler.at(x + dx, y + dy))
                else {
                    continue;
                };
                let half = (after - before) / 2.0;
                let (gx, gy) = (half * gx as f32, half * gy as f32);
                self.points[self.count] = Point { x, y, value, gx, gy };
                self.count += 1;
                self.normal[0] += gx * gx;
                self.normal[1] += gx * gy;
                self.normal[2] += gy * gy;
            }
        }
    }

    /// Remembers the pixels of a patch whose outline is not known, `reach` px around its centre, that have a gradient.
    pub fn remember_patch(&mut self, sampler: &Sampler<'_>, centre: Vector2<f64>, reach: f64) {
        self.count = 0;
        self.normal = [0.0; 3];
        const SIDE: i32 = 16;
        for i in 0..SIDE * SIDE {
            let at = |k: i32| (f64::from(k) / f64::from(SIDE - 1) - 0.5) * 2.0 * reach;
            let (x, y) = (nearest(centre.x + at(i % SIDE)), nearest(centre.y + at(i / SIDE)));
            let (Some(value), Some(l), Some(r), Some(u), Some(v)) = (
                sampler.at(x, y),
                sampler.at(x - 1, y),
                sampler.at(x + 1, y),
                sampler.at(x, y - 1),
                sampler.at(x, y + 1),
            ) else {
                continue;
            };
            let (gx, gy) = ((r - l) / 2.0, (v - u) / 2.0);
            if gx * gx + gy * gy > 0.02 && self.count < MAX_POINTS {
                self.points[self.count] = Point { x, y, value, gx, gy };
                self.count += 1;
                self.normal[0] += gx * gx;
                self.normal[1] += gx * gy;
                self.normal[2] += gy * gy;
            }
        }
    }

    /// Whether every remembered pixel has its very signal still.
    pub fn is_unchanged(&self, sampler: &Sampler<'_>) -> bool {
        self.points[..self.count].iter().all(|p| sampler.at(p.x, p.y) == Some(p.value))
    }

    /// Forgets.
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Displacement (px) from the remembered image to the one in `sampler`, sought from `start`; `None` where it cannot be
    /// told: too few pixels in the image, flow along one direction only, or no convergence.
    pub fn displacement(&self, sampler: &Sampler<'_>, start: Vector2<f64>) -> Option<Vector2<f64>> {
        let points = &self.points[..self.count];
        let mut d = start;
        for round in 0..ITERATIONS {
            // By whole pixels while it is far off: no interpolation is needed to come near.
            let (u, v) = (nearest(d.x), nearest(d.y));
            let whole = round == 0 && ((d.x - f64::from(u)).abs() < 0.1 && (d.y - f64::from(v)).abs() < 0.1);
            let at = if whole { Vector2::new(f64::from(u), f64::from(v)) } else { d };
            let (dx, dy) = (at.x as f32, at.y as f32);
            let (mut bx, mut by, mut seen, mut square) = (0f32, 0f32, 0usize, 0f32);
            for p in points {
                let now = if whole {
                    sampler.at(p.x + u, p.y + v)
                } else {
                    sampler.bilinear(p.x as f32 + dx, p.y as f32 + dy)
                };
                let Some(now) = now else { continue };
                let difference = now - p.value;
                seen += 1;
                square += difference * difference;
                bx += p.gx * difference;
                by += p.gy * difference;
            }
            if seen < 12 || seen * 4 < self.count * 3 {
                return None;
            }
            let [xx, xy, yy] = self.normal;
            let det = xx * yy - xy * xy;
            if det.is_nan() || det <= 1e-3 * (xx + yy) * (xx + yy) {
                return None;
            }
            let step =
                Vector2::new(f64::from((yy * bx - xy * by) / det), f64::from((xx * by - xy * bx) / det));
            // A step is believed as far as the gradient reaches.
            let length = step.norm();
            let step = if length > 2.0 { step * (2.0 / length) } else { step };
            d = at - step;
            if !d.x.is_finite() || !d.y.is_finite() || (d - start).norm() > 12.0 {
                return None;
            }
            if length < 0.2 || round + 1 == ITERATIONS {
                // What is left must be less than an edge that is off by a pixel and a half.
                return (length < 0.5 && square < 2.3 * (xx + yy)).then_some(d);
            }
        }
        None
    }
}
