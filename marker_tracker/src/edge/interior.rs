//! The signal's level inside of a square: a plane, robust against what crosses the square.

use crate::{
    quad::Quad,
    signal::{Sampler, nearest},
};
use nalgebra::{Matrix3, Vector2, Vector3};
use wide::f32x8;

/// Maximum number of lines that are read and of pixels of each: in a thorough measurement, and in a
/// quick one, which relies on the gradient of the previous images.
const LINES: i32 = 40;
const PER_LINE: i32 = 48;
const QUICK: (i32, i32) = (12, 16);
/// Weight of the previous images' gradient relative to this image's pixels: shading drifts slowly,
/// and noise of the gradient shifts opposite edges the same way. A time constant of 4 images.
const PRIOR_WEIGHT: f64 = 3.0;
/// Bounds of the gate for a pixel's distance from the level, in units of the contrast. Within them
/// the gate is 4.5 standard deviations (all pixels of an even square, normal: 7e-6) or 4 of the
/// middle half of the pixels.
const GATE: (f64, f64) = (0.08, 0.3);

/// Signal level of the interior.
pub(crate) struct Interior {
    center: Vector2<f64>,
    /// At the center.
    pub level: f64,
    /// Per px.
    pub gradient: Vector2<f64>,
    /// Share of the pixels that have the level.
    pub filled: f64,
    /// Standard deviation of a pixel about the plane.
    pub sigma: f64,
    /// Variance, in units of a pixel's, of the gradient times half the side.
    pub reach: f64,
    /// Mean light, in units of that in which the colors were adapted.
    pub light: f64,
}

/// Number of pixels and sums of a plane's normal equations, about a center and a reference level s:
/// n, x, y, xx, xy, yy, s, xs, ys, ss.
type Sums = [f64; 10];

/// One line of the interior: its first pixel, and number and distance (px) of the pixels.
#[derive(Clone, Copy, Default)]
struct Line {
    x: i32,
    y: i32,
    count: i32,
    hop: i32,
}

impl Interior {
    /// The level at a place, px.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        self.level + self.gradient.x * (x - self.center.x) + self.gradient.y * (y - self.center.y)
    }

    /// The interior after each row was normalized to the light at its place: level 1 and flat.
    pub fn relit(&self) -> Self {
        let scale = self.level.abs().max(0.1);
        let (gradient, sigma) = (Vector2::zeros(), (self.sigma / scale).min(0.1));
        Self { level: 1.0, gradient, filled: 1.0, sigma, ..*self }
    }

    /// Fits the plane to the pixels that are `half_width` px away from the edges (to fewer of them
    /// if `quick`) and to the gradient of the previous images. `None` with fewer than 8 pixels.
    pub fn measure(
        sampler: &Sampler<'_>,
        quad: &Quad,
        half_width: f64,
        quick: bool,
        before: Option<Vector2<f64>>,
    ) -> Option<Self> {
        let (area, center) = quad.area_and_centroid();
        let side = quad.thickness_of(area);
        let shrink = ((side - 2.0 * half_width - 1.0) / side).clamp(0.25, 0.9);
        let shrunken = Quad(quad.0.map(|c| center + (c - center) * shrink));
        let [_, top, _, bottom] = shrunken.bounds(0.0);
        let (most, per_line) = if quick { QUICK } else { (LINES, PER_LINE) };
        let stride = ((bottom - top + most - 1) / most).max(1);
        let mut lines = [Line::default(); LINES as usize + 1];
        let mut count = 0;
        let mut y = top + stride / 2;
        while y < bottom && count < lines.len() {
            if let Some((from, to)) = shrunken.span(f64::from(y)) {
                let (from, to) = (from.max(0), to.min(sampler.width));
                let hop = ((to - from + per_line - 1) / per_line).max(1);
                let n = (to - from + hop - 1) / hop;
                if n > 0 && y >= 0 && y < sampler.height {
                    lines[count] = Line { x: from, y, count: n, hop };
                    count += 1;
                }
            }
            y += stride;
        }
        let lines = &lines[..count];
        let middle = (nearest(center.x), nearest(center.y));
        // Differences from any pixel inside are small numbers.
        let &Line { x, y, .. } = lines.get(lines.len() / 2)?;
        let mut offset = sampler.at(x, y)?;
        let (mut sums, [low, high], light) = gated(sampler, lines, middle, offset, f32::INFINITY);
        let [all, .., s, _, _, ss] = sums;
        if all < 8.0 {
            return None;
        }
        let mean = s / all;
        let spread = (ss / all - mean * mean).max(0.0).sqrt();
        let gate = (4.5 * spread).clamp(GATE.0, GATE.1);
        if high - mean > gate || mean - low > gate {
            // Something crosses it.
            let (median, spread) = middle_half(sampler, lines)?;
            let gate = (4.0 * spread).clamp(GATE.0, GATE.1) as f32;
            offset = median as f32;
            (sums, ..) = gated(sampler, lines, middle, offset, gate);
        }
        let [n, x, y, xx, xy, yy, s, xs, ys, ss] = sums;
        if n < 8.0 {
            return None;
        }
        // A weak prior of a flat level keeps small squares stable; the previous gradient is a
        // strong one.
        let (pull, target) = match before {
            Some(gradient) => (PRIOR_WEIGHT, gradient),
            None => (0.0, Vector2::zeros()),
        };
        let weak = if before.is_some() { 0.0 } else { 10.0 * n.min(20.0) };
        let spread = (xx - x * x / n, yy - y * y / n);
        let extra = (weak + pull * spread.0, weak + pull * spread.1);
        let normal = Matrix3::new(n, x, y, x, xx + extra.0, xy, y, xy, yy + extra.1);
        let plain = Vector3::new(s, xs, ys);
        let right = plain + Vector3::new(0.0, extra.0 * target.x, extra.1 * target.y);
        let solution = normal.cholesky()?.solve(&right);
        // Σ (s − plane)² without the priors.
        let square = ss - 2.0 * solution.dot(&plain) + solution.dot(&(normal * solution))
            - extra.0 * solution.y * solution.y
            - extra.1 * solution.z * solution.z;
        let variance = (square / (n - 3.0)).max(1e-8);
        Some(Self {
            center: Vector2::new(f64::from(middle.0), f64::from(middle.1)),
            level: f64::from(offset) + solution.x,
            gradient: Vector2::new(solution.y, solution.z),
            filled: n / all,
            sigma: variance.sqrt(),
            // Of the gradient's part in the level at an edge's middle; with a prior it is averaged
            // over time with the gain 1/(1 + weight).
            reach: 3.0
                / (n * shrink * shrink)
                / if before.is_some() { 2.0 * PRIOR_WEIGHT + 1.0 } else { 1.0 },
            light: light / all,
        })
    }
}

/// Sums over the pixels less than `gate` off `reference` of their difference from it; the lowest
/// and highest difference of all pixels, and the sum of the light on them.
fn gated(
    sampler: &Sampler<'_>,
    lines: &[Line],
    (cx, cy): (i32, i32),
    reference: f32,
    gate: f32,
) -> (Sums, [f64; 2], f64) {
    let numbers = f32x8::from([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    let (scale, reference) = (f32x8::splat(sampler.scale), f32x8::splat(reference));
    let gate = f32x8::splat(gate);
    let (mut low, mut high) = (f32x8::splat(f32::INFINITY), f32x8::splat(f32::NEG_INFINITY));
    let (mut sums, mut light) = ([f32x8::ZERO; 10], f32x8::ZERO);
    for &Line { x, y, count, hop } in lines {
        let far = sampler.hop(0) * hop as u32;
        let first = sampler.begin(x, y);
        let last = first + (count - 1) as u32 * far;
        sampler.read([x, y], [x + (count - 1) * hop, y]);
        let mut begin: [u32; 8] = std::array::from_fn(|i| first + i as u32 * far);
        let (y, hop) = (f32x8::splat((y - cy) as f32), f32x8::splat(hop as f32));
        let mut place = numbers * hop + f32x8::splat((x - cx) as f32);
        let mut group = 0;
        while group < count {
            // The last pixel stands in for missing ones, so that the extremes are real.
            let (signal, lights) = sampler.eight_with_light(&begin.map(|b| b.min(last)));
            let value = signal * scale - reference;
            (low, high) = (low.fast_min(value), high.fast_max(value));
            let there = (numbers + f32x8::splat(group as f32)).simd_lt(f32x8::splat(count as f32));
            light += lights & there;
            let member = there & value.abs().simd_lt(gate);
            let (s, x, y) = (value & member, place & member, y & member);
            let terms = [member & f32x8::ONE, x, y, x * x, x * y, y * y, s, x * s, y * s, s * s];
            for (sum, term) in sums.iter_mut().zip(terms) {
                *sum += term;
            }
            place += hop * f32x8::splat(8.0);
            begin = begin.map(|b| b + 8 * far);
            group += 8;
        }
    }
    let [n, x, y, xx, xy, yy, s, xs, ys, ss] = sums;
    // Sums of whole numbers are exact in each lane, but not in all together.
    let whole = |v: f32x8| v.to_array().iter().map(|v| f64::from(*v)).sum::<f64>();
    let [n, x, y, xx, xy, yy] = [n, x, y, xx, xy, yy].map(whole);
    let [s, xs, ys, ss] = [s, xs, ys, ss].map(|v| f64::from(v.reduce_add()));
    let low = low.to_array().iter().fold(f32::INFINITY, |m, v| m.min(*v));
    let high = high.to_array().iter().fold(f32::NEG_INFINITY, |m, v| m.max(*v));
    let sums = [n, x, y, xx, xy, yy, s, xs, ys, ss];
    (sums, [low, high].map(f64::from), f64::from(light.reduce_add()))
}

/// The median and the standard deviation according to the middle half of the values (for a normal
/// distribution the quartiles are 1.35 σ apart).
fn middle_half(sampler: &Sampler<'_>, lines: &[Line]) -> Option<(f64, f64)> {
    let mut values = [0i32; 256];
    let mut count = 0;
    for &Line { x, y, count: n, hop } in lines {
        for j in (0..n).filter(|j| (j + y) % 4 == 0) {
            let Some(slot) = values.get_mut(count) else { break };
            *slot = sampler.units(sampler.begin(x + j * hop, y));
            count += 1;
        }
    }
    let values = values.get_mut(..count).filter(|v| v.len() >= 8)?;
    values.sort_unstable();
    let scale = f64::from(sampler.scale);
    let at = |i: usize| f64::from(values[i]) * scale;
    Some((at(count / 2), (at(count * 3 / 4) - at(count / 4)) / 1.35))
}
