//! The floor: a softly mottled ground with things lying about, and things that move.

use super::{canvas::Canvas, rng::Rng};
use nalgebra::Vector2;

/// An object of one color on the floor or in front of the platform.
#[derive(Clone, Debug)]
pub struct Thing {
    /// Convex outline, px.
    pub outline: Vec<Vector2<f64>>,
    /// Its color.
    pub color: [f32; 3],
}

impl Thing {
    /// A rectangle around `center`, turned by `angle`.
    pub fn rectangle(
        center: Vector2<f64>,
        size: Vector2<f64>,
        angle: f64,
        color: [f32; 3],
    ) -> Self {
        let turn = nalgebra::Rotation2::new(angle);
        let outline = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
            .map(|(x, y)| center + turn * Vector2::new(x * size.x, y * size.y))
            .to_vec();
        Self { outline, color }
    }

    /// The same, elsewhere.
    pub fn moved(&self, by: Vector2<f64>) -> Self {
        Self { outline: self.outline.iter().map(|p| p + by).collect(), color: self.color }
    }
}

/// Ground that reaches beyond the frame, so that the camera can move over it.
pub struct Floor {
    ground: Canvas,
    margin: usize,
}

impl Floor {
    /// Mottled ground of `margin` px more on each side, without things.
    pub fn new(width: usize, height: usize, margin: usize, base: [f32; 3], rng: &mut Rng) -> Self {
        let mut ground = Canvas::new(width + 2 * margin, height + 2 * margin);
        let waves: Vec<[f64; 4]> = (0..14)
            .map(|_| {
                [
                    rng.within(-0.06, 0.06),
                    rng.within(-0.06, 0.06),
                    rng.within(0.0, 6.3),
                    rng.within(0.005, 0.02),
                ]
            })
            .collect();
        for y in 0..ground.height {
            for x in 0..ground.width {
                let mottle: f64 = waves
                    .iter()
                    .map(|w| w[3] * (w[0] * x as f64 + w[1] * y as f64 + w[2]).sin())
                    .sum();
                let grain = rng.within(-0.02, 0.02);
                ground.light[y * (width + 2 * margin) + x] =
                    base.map(|b| b * (1.0 + mottle + grain) as f32);
            }
        }
        Self { ground, margin }
    }

    /// Lays things on the ground, in frame coordinates.
    pub fn strew(&mut self, things: &[Thing]) {
        let shift = Vector2::repeat(self.margin as f64);
        for thing in things {
            self.ground.add(&thing.moved(shift).outline, thing.color, 1.0);
            self.ground.flatten();
        }
    }

    /// Copies the ground to a canvas, displaced by `by` px (bilinear between pixels).
    pub fn copy_to(&self, canvas: &mut Canvas, by: Vector2<f64>) {
        let limit = self.margin as f64 - 1.0;
        let shift = Vector2::new(by.x.clamp(-limit, limit), by.y.clamp(-limit, limit));
        let origin = Vector2::repeat(self.margin as f64) - shift;
        let (ix, iy) = (origin.x.floor() as usize, origin.y.floor() as usize);
        let (fx, fy) = ((origin.x - ix as f64) as f32, (origin.y - iy as f64) as f32);
        let stride = self.ground.width;
        for y in 0..canvas.height {
            for x in 0..canvas.width {
                let at = (y + iy) * stride + x + ix;
                let g = &self.ground.light;
                let pixel = &mut canvas.light[y * canvas.width + x];
                if fx == 0.0 && fy == 0.0 {
                    *pixel = g[at];
                    continue;
                }
                for (c, value) in pixel.iter_mut().enumerate() {
                    *value = (g[at][c] * (1.0 - fx) + g[at + 1][c] * fx) * (1.0 - fy)
                        + (g[at + stride][c] * (1.0 - fx) + g[at + stride + 1][c] * fx) * fy;
                }
            }
        }
    }
}
