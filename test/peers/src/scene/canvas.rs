//! A frame in linear light that layers are laid upon, and what a sensor makes of it.

use super::{
    geometry::clip_area,
    rng::{NoiseTable, Rng},
};
use nalgebra::Vector2;

/// Interleaved 8-bit RGB.
#[derive(Clone, Debug)]
pub struct Frame {
    pub width: usize,
    pub height: usize,
    /// `3 · width · height` bytes.
    pub rgb: Vec<u8>,
}

impl Frame {
    /// Luma of every pixel (ITU-R 601), for the methods that use gray images.
    pub fn gray(&self) -> Vec<u8> {
        self.rgb
            .chunks_exact(3)
            .map(|p| {
                ((299 * u32::from(p[0]) + 587 * u32::from(p[1]) + 114 * u32::from(p[2]) + 500)
                    / 1000) as u8
            })
            .collect()
    }
}

/// What the light and the sensor do to a scene.
#[derive(Clone, Copy, Debug)]
pub struct Light {
    /// Factor on everything.
    pub gain: f64,
    /// Further factor from one end of the frame to the other, along (cos, sin) of `direction`: 1 ∓
    /// `shading`.
    pub shading: f64,
    /// Direction of the shading, rad.
    pub direction: f64,
}

/// Standard deviation of the sensor's noise, gray levels.
const NOISE: f64 = 3.0;

/// Linear light, and the share of each pixel that the layer in work covers.
pub struct Canvas {
    pub width: usize,
    pub height: usize,
    /// Red, green, blue of every pixel, 0–255 and beyond.
    pub light: Vec<[f32; 3]>,
    layer: Vec<[f32; 4]>,
    touched: Vec<u32>,
    noise: NoiseTable,
}

impl Canvas {
    /// Black.
    pub fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            light: vec![[0.0; 3]; width * height],
            layer: vec![[0.0; 4]; width * height],
            touched: Vec::new(),
            noise: NoiseTable::new(),
        }
    }

    /// Adds a convex polygon to the layer in work; polygons of one layer must not overlap.
    pub fn add(&mut self, polygon: &[Vector2<f64>], color: [f32; 3]) {
        let (width, height) = (self.width, self.height);
        for_each_covered(polygon, width, height, |index, share| {
            let w = share as f32;
            let cell = &mut self.layer[index];
            if cell[3] == 0.0 {
                self.touched.push(index as u32);
            }
            for c in 0..3 {
                cell[c] += w * color[c];
            }
            cell[3] += w;
        });
    }

    /// Lays the layer in work over what is there.
    pub fn flatten(&mut self) {
        for index in self.touched.drain(..) {
            let cell = std::mem::take(&mut self.layer[index as usize]);
            let cover = cell[3].min(1.0);
            let pixel = &mut self.light[index as usize];
            for c in 0..3 {
                pixel[c] = pixel[c] * (1.0 - cover) + cell[c] * (cover / cell[3]);
            }
        }
    }

    /// Image of the sensor.
    pub fn expose(&self, light: &Light, rng: &mut Rng) -> Frame {
        let (w, h) = (self.width, self.height);
        let (sin, cos) = light.direction.sin_cos();
        let mut rgb = vec![0u8; 3 * w * h];
        for y in 0..h {
            let v = (y as f64 / h as f64 - 0.5) * 2.0 * sin;
            for x in 0..w {
                let u = (x as f64 / w as f64 - 0.5) * 2.0 * cos;
                let gain = light.gain * (1.0 + light.shading * (u + v));
                let noise = self.noise.four(rng);
                let pixel = self.light[y * w + x];
                for c in 0..3 {
                    let value = f64::from(pixel[c]) * gain + NOISE * f64::from(noise[c]);
                    rgb[3 * (y * w + x) + c] = (value + 0.5).clamp(0.0, 255.0) as u8;
                }
            }
        }
        Frame { width: w, height: h, rgb }
    }
}

/// Calls `f(index, share)` for each pixel that a convex polygon covers in part or in full.
fn for_each_covered(
    polygon: &[Vector2<f64>],
    width: usize,
    height: usize,
    mut f: impl FnMut(usize, f64),
) {
    let bound = |axis: usize, low: bool| {
        polygon.iter().map(|p| p[axis]).fold(if low { f64::MAX } else { f64::MIN }, |a, b| {
            if low { a.min(b) } else { a.max(b) }
        })
    };
    let x0 = (bound(0, true) - 0.5).ceil().max(0.0) as usize;
    let y0 = (bound(1, true) - 0.5).ceil().max(0.0) as usize;
    let x1 = (bound(0, false) + 0.5).floor().min(width as f64 - 1.0);
    let y1 = (bound(1, false) + 0.5).floor().min(height as f64 - 1.0);
    if x1 < 0.0 || y1 < 0.0 {
        return;
    }
    let (area, _) = super::geometry::polygon_centroid(polygon);
    let turn = area.signum();
    let edges: Vec<(f64, f64, f64)> = (0..polygon.len())
        .filter_map(|i| {
            let (p, q) = (polygon[i], polygon[(i + 1) % polygon.len()]);
            let along = q - p;
            let length = along.norm();
            // Distance of (x, y) to the inside of this edge: a·x + b·y + c.
            (length > 1e-9).then(|| {
                let (a, b) = (-along.y * turn / length, along.x * turn / length);
                (a, b, -(a * p.x + b * p.y))
            })
        })
        .collect();
    for y in y0..=(y1 as usize) {
        for x in x0..=(x1 as usize) {
            let inside = edges
                .iter()
                .map(|(a, b, c)| a * x as f64 + b * y as f64 + c)
                .fold(f64::MAX, f64::min);
            let share = if inside > 0.7072 {
                1.0
            } else if inside < -0.7072 {
                0.0
            } else {
                clip_area(polygon, x as f64, y as f64)
            };
            if share > 0.0 {
                f(y * width + x, share);
            }
        }
    }
}
