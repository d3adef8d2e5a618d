//! Optical flow after Lucas and Kanade on a marker's soft binary image, from its gradient pixels.
//!
//! The color signal is the binary image of the paper before rounding: 1 on the marker, 0 beside it.
//! All information about its flow lies on the outline, so 32 pixels there replace the window (eq.
//! 1).

use crate::{
    edge::eight,
    quad::Quad,
    signal::{Sampler, nearest},
};
use nalgebra::Vector2;
use wide::f32x8;

/// Largest number of pixels that are kept, on each edge and in all.
const PER_EDGE: usize = 8;
const POINTS: usize = 4 * PER_EDGE;
/// Gauss–Newton steps: at 2 px each they reach 10 px.
const ITERATIONS: usize = 5;
/// Largest correction of the start, px; beyond it, the features may match another edge.
const MAX_CORRECTION: f64 = 12.0;
/// Longest step, px: as far as the gradient of a blurred edge reaches.
const MAX_STEP: f64 = 2.0;
/// Length of a step, px, at which the iteration has converged, and that from which on it has not.
const CONVERGED: f64 = 0.6;
const DIVERGED: f64 = 1.2;
/// Largest Σ difference² over Σ gradient² of a match, px²: an edge that is 1.5 px off.
const MAX_RESIDUAL: f32 = 2.3;

/// Pixels on a marker's outline in the previous image, with their signal and its gradient.
#[derive(Clone, Debug, Default)]
pub(crate) struct FlowFeatures {
    x: [i32; POINTS],
    y: [i32; POINTS],
    value: [f32; POINTS],
    gx: [f32; POINTS],
    gy: [f32; POINTS],
    count: usize,
    /// Σ g·gᵀ: xx, xy, yy.
    normal: [f32; 3],
}

/// Σ g·difference along x and y, Σ difference², and the number of pixels that are in the image.
struct Differences {
    bx: f32,
    by: f32,
    square: f32,
    seen: usize,
}

impl FlowFeatures {
    fn add(&mut self, (x, y): (i32, i32), value: f32, gx: f32, gy: f32) {
        let i = self.count;
        (self.x[i], self.y[i]) = (x, y);
        (self.value[i], self.gx[i], self.gy[i]) = (value, gx, gy);
        self.count += 1;
        self.normal[0] += gx * gx;
        self.normal[1] += gx * gy;
        self.normal[2] += gy * gy;
    }

    /// Extracts eight pixels on each edge of an outline.
    pub fn extract(&mut self, sampler: &Sampler<'_>, quad: &Quad) {
        self.count = 0;
        self.normal = [0.0; 3];
        for i in 0..4 {
            let (p, q) = (quad.0[i], quad.0[(i + 1) % 4]);
            let d = q - p;
            let step = d / PER_EDGE as f64;
            let start = p + step * 0.5;
            // A straight edge's gradient is along its normal: one difference, along the axis nearer
            // to it, determines it.
            let (dx, dy) = if d.x.abs() > d.y.abs() { (0, 1) } else { (1, 0) };
            let (gx, gy) = if dx == 1 { (1.0, -d.x / d.y) } else { (-d.y / d.x, 1.0) };
            let mut places = [(0, 0); PER_EDGE];
            for (i, place) in places.iter_mut().enumerate() {
                let at = start + step * i as f64;
                *place = (nearest(at.x), nearest(at.y));
            }
            let inside = |&(x, y): &(i32, i32)| {
                x >= dx && y >= dy && x + dx < sampler.width && y + dy < sampler.height
            };
            let within = places.map(|p| inside(&p));
            let begin = |ahead: i32| {
                let of = |i: usize| {
                    let (x, y) = places[i];
                    if within[i] { sampler.begin(x + ahead * dx, y + ahead * dy) } else { 0 }
                };
                [of(0), of(1), of(2), of(3), of(4), of(5), of(6), of(7)]
            };
            let scale = f32x8::splat(sampler.scale);
            let signal = |ahead: i32| sampler.eight(&begin(ahead)) * scale;
            let half = (signal(1) - signal(-1)) * f32x8::splat(0.5);
            let (gx, gy) = (half * f32x8::splat(gx as f32), half * f32x8::splat(gy as f32));
            let (value, gx, gy) = (signal(0).to_array(), gx.to_array(), gy.to_array());
            for i in 0..PER_EDGE {
                if within[i] {
                    self.add(places[i], value[i], gx[i], gy[i]);
                }
            }
        }
    }

    /// Removes all pixels.
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Displacement (px) from the previous image to the one in `sampler`, searched from `start`;
    /// `None` with too few pixels in the image, gradients in one direction only, or without
    /// convergence.
    ///
    /// The images' difference is taken at whole pixels: an edge's blur is wider than the half pixel
    /// by which that is off, so that no interpolation is needed, and a step that returns to an
    /// earlier place adds nothing.
    pub fn displacement(&self, sampler: &Sampler<'_>, start: Vector2<f64>) -> Option<Vector2<f64>> {
        let [xx, xy, yy] = self.normal;
        let det = xx * yy - xy * xy;
        if det.is_nan() || det <= 1e-3 * (xx + yy) * (xx + yy) {
            return None;
        }
        let mut d = start;
        let mut places = [None; ITERATIONS];
        for round in 0..ITERATIONS {
            let (u, v) = (nearest(d.x), nearest(d.y));
            let Differences { bx, by, square, seen } = self.differences(sampler, u, v);
            if seen < 12 || seen * 4 < self.count * 3 {
                return None;
            }
            let step = Vector2::new(
                f64::from((yy * bx - xy * by) / det),
                f64::from((xx * by - xy * bx) / det),
            );
            let length = step.norm();
            let step = if length > MAX_STEP { step * (MAX_STEP / length) } else { step };
            d = Vector2::new(f64::from(u), f64::from(v)) - step;
            if !d.x.is_finite() || !d.y.is_finite() || (d - start).norm() > MAX_CORRECTION {
                return None;
            }
            places[round] = Some((u, v));
            if length < CONVERGED || places[..=round].contains(&Some((nearest(d.x), nearest(d.y))))
            {
                let matched = length < DIVERGED && square < MAX_RESIDUAL * (xx + yy);
                return matched.then_some(d);
            }
        }
        None
    }

    /// Differences of the images for a displacement by whole pixels.
    fn differences(&self, sampler: &Sampler<'_>, u: i32, v: i32) -> Differences {
        let (mut bx, mut by, mut square) = (f32x8::ZERO, f32x8::ZERO, f32x8::ZERO);
        let mut seen = 0;
        let scale = f32x8::splat(sampler.scale);
        for group in (0..self.count).step_by(8) {
            let (mut begin, mut there) = ([0; 8], [0.0; 8]);
            for (k, i) in (group..self.count.min(group + 8)).enumerate() {
                let (x, y) = (self.x[i].wrapping_add(u), self.y[i].wrapping_add(v));
                if (0..sampler.width).contains(&x) && (0..sampler.height).contains(&y) {
                    (begin[k], there[k]) = (sampler.begin(x, y), 1.0);
                    seen += 1;
                }
            }
            let of = |column: &[f32; POINTS]| eight(column, group);
            let difference = (sampler.eight(&begin) * scale - of(&self.value)) * f32x8::from(there);
            square += difference * difference;
            bx += of(&self.gx) * difference;
            by += of(&self.gy) * difference;
        }
        Differences { bx: bx.reduce_add(), by: by.reduce_add(), square: square.reduce_add(), seen }
    }
}
