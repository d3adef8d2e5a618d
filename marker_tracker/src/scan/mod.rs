//! Search for patches of the markers' colors.

mod palette;
mod scanner;
mod tint;

pub(crate) use palette::Palette;
pub(crate) use scanner::{CELL, Scanner};
pub(crate) use tint::ScanConfig;

use nalgebra::{Matrix2, Vector2};
use rig_model::MarkerColor;

/// A patch of one marker's color.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Blob {
    pub color: MarkerColor,
    /// px.
    pub centroid: Vector2<f64>,
    /// px² of the full image.
    pub area: f64,
    /// Second central moments, px².
    pub spread: Matrix2<f64>,
    /// Mean color, r, g, b of 0–255.
    pub rgb: [f32; 3],
    /// Whether it touches the scanned rectangle's border.
    pub cut: bool,
}

impl Blob {
    /// Area over that of the parallelogram with the same second moments: 1 for a parallelogram,
    /// 1.05 for an ellipse, less with holes, arms or a bent outline.
    pub fn fill(&self) -> f64 {
        self.area / (12.0 * self.spread.determinant().max(1e-6).sqrt())
    }

    /// Saturation, 0 to 1.
    pub fn saturation(&self) -> f32 {
        let max = self.rgb.iter().fold(1.0f32, |m, v| m.max(*v));
        let min = self.rgb.iter().fold(max, |m, v| m.min(*v));
        (max - min) / max
    }

    /// Ratio of the principal extents, ≥ 1.
    pub fn elongation(&self) -> f64 {
        let (t, d) = (self.spread.trace(), self.spread.determinant());
        let root = (t * t / 4.0 - d).max(0.0).sqrt();
        ((t / 2.0 + root) / (t / 2.0 - root).max(1e-3)).sqrt()
    }
}
