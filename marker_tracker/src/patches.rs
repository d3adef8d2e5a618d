//! Patches of the markers' colors without a layout, for color calibration.

use crate::{
    image::{ImageError, ImageView, Pixels},
    scan::{Blob, ScanConfig, Scanner},
};
use nalgebra::Vector2;
use rig_model::MarkerColor;

/// A patch of one of the markers' colors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Marker whose color it has.
    pub color: MarkerColor,
    /// Centroid of its pixels, px.
    pub centroid: Vector2<f64>,
    /// Area, px².
    pub area: f64,
    /// Mean color, r, g, b of 0–255.
    pub rgb: [f32; 3],
}

fn is_square(blob: &Blob) -> bool {
    !blob.cut
        && (0.75..1.25).contains(&blob.fill())
        && blob.elongation() < 2.0
        && blob.saturation() > 0.2
}

/// Finds the square-like patches of the markers' colors of at least `min_area` px² in an image, the
/// largest first.
///
/// # Errors
/// [`ImageError::Size`] where the image's fields contradict each other.
pub fn find_patches(image: &ImageView<'_>, min_area: f64) -> Result<Vec<Patch>, ImageError> {
    image.check()?;
    let (w, h) = (image.width as i32, image.height as i32);
    let stride = (image.width.max(image.height) / 640).clamp(1, 8);
    let config = ScanConfig {
        stride,
        grid: stride.clamp(4, 8),
        min_saturation: 0.15,
        min_layer: 16,
        min_area,
        max_area: f64::from(w) * f64::from(h) / 6.0,
    };
    let mut scanner = Scanner::default();
    scanner.scan(&Pixels::whole(*image, None), [0, 0, w, h], &config);
    let squares = scanner.blobs.iter().filter(|b| is_square(b));
    let mut patches: Vec<Patch> = squares
        .map(|b| Patch { color: b.color, centroid: b.centroid, area: b.area, rgb: b.rgb })
        .collect();
    patches.sort_by(|a, b| b.area.total_cmp(&a.area));
    Ok(patches)
}
