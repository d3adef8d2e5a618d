//! Search for patches of the markers' colors.

mod palette;
mod scanner;

pub(crate) use palette::Palette;
pub(crate) use scanner::{CELL, Scanner};

use nalgebra::{Matrix2, Vector2};
use rig_model::MarkerColor;

/// What a pixel and a patch must have.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScanConfig {
    /// Every `stride`-th row and column is read.
    pub stride: usize,
    /// Distance along a row of the places that are tested for color first, px.
    pub grid: usize,
    /// Least saturation, of 256.
    pub min_saturation: i32,
    /// Least layer difference, 0–255.
    pub min_layer: i32,
    /// Smallest and largest area of a patch, px².
    pub min_area: f64,
    pub max_area: f64,
}

impl ScanConfig {
    /// Whether a pixel's channels differ enough; most of an image fails this test.
    #[inline(always)]
    fn is_colored(&self, [a, b, c]: [u8; 3]) -> bool {
        let (max, min) = (a.max(b).max(c), a.min(b).min(c));
        self.is_layer(i32::from(max - min), i32::from(max))
    }

    #[inline(always)]
    fn is_layer(&self, layer: i32, max: i32) -> bool {
        (layer >= self.min_layer) & (layer * 256 >= self.min_saturation * max)
    }
}

/// A patch of one marker's color.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Marker whose color it has.
    pub color: MarkerColor,
    /// Centroid of its pixels, px.
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

impl Patch {
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
