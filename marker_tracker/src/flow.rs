//! Optical flow after Lucas and Kanade on a marker's soft binary image, from its gradient pixels alone.
//!
//! The colour signal is the binary image of the paper, only not yet rounded: 1 on the marker, 0 beside it. All that its flow
//! can be told from lies on the outline, so some 150 pixels there stand for the window (eq. 1).

use crate::{
    quad::Quad,
    signal::{Window, nearest},
};
use nalgebra::{Matrix2, Vector2};

/// Pixels that are kept.
const MAX_POINTS: usize = 160;
/// Iterations; each is one step of Gauss and Newton.
const ITERATIONS: usize = 4;

#[derive(Clone, Copy, Debug, Default)]
struct Point {
    x: f32,
    y: f32,
    value: f32,
    gx: f32,
    gy: f32,
}

/// What a marker's outline looked like in the previous image.
#[derive(Clone, Debug)]
pub(crate) struct Outline {
    points: [Point; MAX_POINTS],
    count: usize,
}

impl Default for Outline {
    fn default() -> Self {
        Self { points: [Point::default(); MAX_POINTS], count: 0 }
    }
}

impl Outline {
    /// Remembers the pixels on both sides of each edge.
    pub fn remember(&mut self, window: &Window, quad: &Quad) {
        self.count = 0;
        for i in 0..4 {
            let (p, q) = (quad.0[i], quad.0[(i + 1) % 4]);
            let d = q - p;
            // Along the axis on which the edge advances faster, a pixel on each side of the line.
            let k = usize::from(d.y.abs() > d.x.abs());
            let (from, to) = (nearest(p[k].min(q[k]) + 0.5), nearest(p[k].max(q[k]) - 0.5));
            let room = MAX_POINTS / 8;
            let stride = ((to - from + 1).max(1) as usize).div_ceil(room).max(1);
            for a in (from..=to).step_by(stride) {
                let b = p[1 - k] + (f64::from(a) - p[k]) * d[1 - k] / d[k];
                let below = nearest(b - 0.5);
                for b in [below, below + 1] {
                    let (x, y) = if k == 0 { (a, b) } else { (b, a) };
                    let (Some(value), Some(l), Some(r), Some(u), Some(v)) = (
                        window.at(x, y),
                        window.at(x - 1, y),
                        window.at(x + 1, y),
                        window.at(x, y - 1),
                        window.at(x, y + 1),
                    ) else {
                        continue;
                    };
                    if self.count < MAX_POINTS {
                        self.points[self.count] =
                            Point { x: x as f32, y: y as f32, value, gx: (r - l) / 2.0, gy: (v - u) / 2.0 };
                        self.count += 1;
                    }
                }
            }
        }
    }

    /// Forgets.
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Displacement (px) from the remembered image to the one in `window`, sought from `start`; `None` where it cannot be
    /// told: too few pixels in the window, flow along one direction only, or no convergence.
    pub fn displacement(&self, window: &Window, start: Vector2<f64>) -> Option<Vector2<f64>> {
        let points = &self.points[..self.count];
        let mut d = start.cast::<f32>();
        for round in 0..ITERATIONS {
            let (mut xx, mut xy, mut yy, mut bx, mut by) = (0f32, 0f32, 0f32, 0f32, 0f32);
            let (mut seen, mut square, mut power) = (0usize, 0f32, 0f32);
            for p in points {
                let Some(now) = window.bilinear(p.x + d.x, p.y + d.y) else { continue };
                let difference = now - p.value;
                seen += 1;
                square += difference * difference;
                power += p.gx * p.gx + p.gy * p.gy;
                xx += p.gx * p.gx;
                xy += p.gx * p.gy;
                yy += p.gy * p.gy;
                bx += p.gx * difference;
                by += p.gy * difference;
            }
            if seen < 12 || seen * 2 < self.count {
                return None;
            }
            let step = Matrix2::new(xx, xy, xy, yy).try_inverse()? * nalgebra::Vector2::new(bx, by);
            // A step is believed as far as the gradient reaches.
            let length = step.norm();
            let step = if length > 2.0 { step * (2.0 / length) } else { step };
            d -= step;
            if !d.x.is_finite() || !d.y.is_finite() || (d.cast::<f64>() - start).norm() > 12.0 {
                return None;
            }
            if length < 0.03 || round + 1 == ITERATIONS {
                // What is left must be less than an edge that is off by a pixel and a half.
                return (length < 0.5 && square < 2.3 * power).then(|| d.cast::<f64>());
            }
        }
        None
    }
}
