//! The floor: a softly mottled ground with things lying about.

use super::{canvas::Canvas, rng::Rng};
use nalgebra::Vector2;

/// An object of one color on the floor.
#[derive(Clone, Debug)]
pub struct Thing {
    /// Convex outline, px.
    pub outline: Vec<Vector2<f64>>,
    pub color: [f32; 3],
}

impl Thing {
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

    pub fn moved(&self, by: Vector2<f64>) -> Self {
        Self { outline: self.outline.iter().map(|p| p + by).collect(), color: self.color }
    }
}

/// Ground that reaches beyond the frame.
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
            self.ground.add(&thing.moved(shift).outline, thing.color);
            self.ground.flatten();
        }
    }

    pub fn copy_to(&self, canvas: &mut Canvas) {
        let stride = self.ground.width;
        for (y, row) in canvas.light.chunks_exact_mut(canvas.width).enumerate() {
            let from = (y + self.margin) * stride + self.margin;
            row.copy_from_slice(&self.ground.light[from..from + row.len()]);
        }
    }
}
