//! Which pixels are colored enough to be a marker's.

use wide::{f32x4, i32x4, u8x16, u32x4};

/// What a pixel and a patch must have.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScanConfig {
    /// Every `stride`-th row and column is read.
    pub stride: usize,
    /// Distance along a row of the places that are tested for color first, px.
    pub grid: usize,
    /// Least saturation, 0 to 1.
    pub min_saturation: f32,
    /// Least layer difference, 0–255.
    pub min_layer: i32,
    /// Smallest and largest area of a patch, px².
    pub min_area: f64,
    pub max_area: f64,
}

/// Integer thresholds of what counts as colored.
#[derive(Clone, Copy)]
pub(super) struct Tint {
    layer: i32,
    /// Saturation of 256.
    saturation: i32,
}

impl Tint {
    pub fn new(config: &ScanConfig) -> Self {
        Self { layer: config.min_layer, saturation: (config.min_saturation * 256.0) as i32 }
    }

    /// Whether a pixel's channels differ enough; most of an image fails this test.
    #[inline(always)]
    pub fn is_colored(&self, [a, b, c]: [u8; 3]) -> bool {
        let (max, min) = (a.max(b).max(c), a.min(b).min(c));
        self.is_layer(i32::from(max - min), i32::from(max))
    }

    /// Which of four pixels are colored, one bit each; their fourth bytes are ignored.
    #[inline(always)]
    pub fn are_colored(&self, pixels: [u32; 4]) -> u32 {
        let a = u32x4::new(pixels);
        // Each word's lowest byte is compared with the two above it.
        let [a, b, c]: [u8x16; 3] =
            [bytemuck::cast(a), bytemuck::cast(a >> 8), bytemuck::cast(a >> 16)];
        let number = |bytes: u8x16| {
            let lowest: i32x4 =
                bytemuck::cast(bytemuck::cast::<u8x16, u32x4>(bytes) & u32x4::splat(0xff));
            lowest.round_float()
        };
        let (max, min) = (number(a.max(b).max(c)), number(a.min(b).min(c)));
        let layer = max - min;
        let saturated =
            (layer * f32x4::splat(256.0)).simd_ge(max * f32x4::splat(self.saturation as f32));
        (layer.simd_ge(f32x4::splat(self.layer as f32)) & saturated).to_bitmask()
    }

    #[inline(always)]
    pub fn is_layer(&self, layer: i32, max: i32) -> bool {
        (layer >= self.layer) & (layer * 256 >= self.saturation * max)
    }
}
