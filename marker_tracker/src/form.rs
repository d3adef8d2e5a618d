//! Linear forms of a pixel's channels.

use wide::{f32x8, i16x16, u32x8};

/// A linear form of the three channels with integer weights, so that sums are exact.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Form {
    /// In the order of the channels in memory.
    weights: [i32; 3],
    /// The same in pairs of 16 bits: first and third channel, and the second alone.
    outer: i16x16,
    middle: i16x16,
    /// Value per unit of the weighted sum.
    pub scale: f32,
}

impl Form {
    /// Largest weight: a sum of three channels stays below 2²⁰ and is exact in 32-bit floats.
    const WEIGHT: f32 = 1024.0;

    /// From weights per channel r, g, b.
    #[inline(always)]
    pub fn new(mut weights: [f32; 3], blue_first: bool) -> Self {
        if blue_first {
            weights.swap(0, 2);
        }
        let largest = weights.iter().fold(1e-12f32, |m, w| m.max(w.abs()));
        let weights = weights.map(|w| (w * (Self::WEIGHT / largest)).round() as i32);
        let pairs = |low: i32, high: i32| {
            i16x16::new(std::array::from_fn(|i| if i % 2 == 0 { low } else { high } as i16))
        };
        Self {
            weights,
            outer: pairs(weights[0], weights[2]),
            middle: pairs(weights[1], 0),
            scale: largest / Self::WEIGHT,
        }
    }

    /// Weighted sum of a pixel.
    #[inline(always)]
    pub fn of(&self, a: u8, b: u8, c: u8) -> i32 {
        let w = self.weights;
        w[0] * i32::from(a) + w[1] * i32::from(b) + w[2] * i32::from(c)
    }

    /// Weighted sums of eight pixels from their bytes.
    #[inline(always)]
    pub fn eight(&self, words: u32x8) -> f32x8 {
        let outer: i16x16 = bytemuck::cast(words & u32x8::splat(0x00ff_00ff));
        let middle: i16x16 = bytemuck::cast((words >> 8) & u32x8::splat(0xff));
        (outer.dot(self.outer) + middle.dot(self.middle)).round_float()
    }
}
