//! From pixels to a colour signal: the projection of each pixel onto one direction of RGB space, over a window.

use crate::{
    image::{ImageView, PixelFormat},
    quad::Quad,
};

/// A direction in RGB space along which a marker differs most from its surroundings.
///
/// The signal `weights · (r, g, b)` is linear in the share of a pixel that the marker covers, as long as the sensor is,
/// so that its moments and edge integrals are unbiased under blur, chroma subsampling and demosaicing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Discriminant {
    /// Per channel r, g, b; `weights · (marker − surroundings) = 1` at the light in which it was learnt.
    pub weights: [f32; 3],
}

impl Discriminant {
    /// Between the mean colours of a marker and of what surrounds it; `None` where they are the same.
    ///
    /// The pixel noise is taken as equal in the channels. `luma_penalty` ≥ 0 adds a common-mode noise, in units of the
    /// channel noise's variance: shadows and dirt change brightness more than hue.
    pub fn between(marker: [f32; 3], surroundings: [f32; 3], luma_penalty: f32) -> Option<Self> {
        let d = [0, 1, 2].map(|i| marker[i] - surroundings[i]);
        // (I + λ·11ᵀ)⁻¹ d by Sherman–Morrison.
        let common = luma_penalty * (d[0] + d[1] + d[2]) / (1.0 + 3.0 * luma_penalty);
        let w = d.map(|x| x - common);
        let gain = w[0] * d[0] + w[1] * d[1] + w[2] * d[2];
        (gain.is_finite() && gain > 25.0).then(|| Self { weights: w.map(|x| x / gain) })
    }
}

/// The signal over a rectangle of the image.
#[derive(Clone, Debug, Default)]
pub(crate) struct Window {
    /// Left column in the image.
    pub x0: i32,
    /// Top row in the image.
    pub y0: i32,
    pub width: i32,
    pub height: i32,
    pub values: Vec<f32>,
}

impl Window {
    /// Fills it from the part of the image in and around `quad`, to `margin` px beyond its edges; NaN elsewhere in the
    /// rectangle.
    pub fn fill(&mut self, image: &ImageView<'_>, quad: &Quad, margin: f64, discriminant: &Discriminant) {
        let grown = quad.grown(margin);
        // Where the quad is long and thin, growing it in proportion would look far along its length.
        let ([a, b, c, d], [e, f, g, h]) = (grown.bounds(0.0), quad.bounds(2.0 * margin));
        let [x0, y0, x1, y1] = [a.max(e), b.max(f), c.min(g), d.min(h)];
        let (x0, y0) = (x0.clamp(0, image.width as i32), y0.clamp(0, image.height as i32));
        let (x1, y1) = (x1.clamp(x0, image.width as i32), y1.clamp(y0, image.height as i32));
        (self.x0, self.y0, self.width, self.height) = (x0, y0, x1 - x0, y1 - y0);
        let (w, h) = (self.width as usize, self.height as usize);
        self.values.clear();
        self.values.resize(w * h, f32::NAN);
        if w == 0 || h == 0 {
            return;
        }
        let mut weights = discriminant.weights;
        if image.format.blue_first() {
            weights.swap(0, 2);
        }
        let bytes = image.format.bytes_per_pixel();
        for (y, out) in (y0..).zip(self.values.chunks_exact_mut(w)) {
            let Some((from, to)) = grown.span(f64::from(y)) else { continue };
            let (from, to) = (from.clamp(x0, x1), to.clamp(x0, x1));
            let start = y as usize * image.step + from as usize * bytes;
            let (Some(source), Some(out)) = (
                image.data.get(start..start + (to - from) as usize * bytes),
                out.get_mut((from - x0) as usize..(to - x0) as usize),
            ) else {
                continue;
            };
            match image.format {
                PixelFormat::Rgb8 | PixelFormat::Bgr8 => project::<3>(source, out, weights),
                PixelFormat::Rgba8 | PixelFormat::Bgra8 => project::<4>(source, out, weights),
            }
        }
    }

    /// The values from one place to another on the same row or column, with the step from one to the next.
    #[inline(always)]
    pub fn between(&self, from: (i32, i32), to: (i32, i32)) -> Option<(&[f32], usize)> {
        let inside = |(x, y): (i32, i32)| {
            let (u, v) = (x - self.x0, y - self.y0);
            (u >= 0 && v >= 0 && u < self.width && v < self.height).then_some((v * self.width + u) as usize)
        };
        let (a, b) = (inside(from)?, inside(to)?);
        Some((self.values.get(a..=b)?, if from.1 == to.1 { 1 } else { self.width as usize }))
    }

    /// Value at an image position; `None` outside.
    #[inline(always)]
    pub fn at(&self, x: i32, y: i32) -> Option<f32> {
        let (u, v) = (x - self.x0, y - self.y0);
        if u < 0 || v < 0 || u >= self.width || v >= self.height {
            return None;
        }
        self.values.get((v * self.width + u) as usize).copied()
    }

    /// The values of a row from column `from` (included) to `to` (excluded); `None` where any is outside.
    #[inline(always)]
    pub fn row(&self, y: i32, from: i32, to: i32) -> Option<&[f32]> {
        let (v, a, b) = (y - self.y0, from - self.x0, to - self.x0);
        if v < 0 || v >= self.height || a < 0 || b > self.width || a >= b {
            return None;
        }
        let start = (v * self.width) as usize;
        self.values.get(start + a as usize..start + b as usize)
    }

    /// Bilinear value at an image position; `None` where a neighbour is missing.
    #[inline(always)]
    pub fn bilinear(&self, x: f32, y: f32) -> Option<f32> {
        // Where it can be looked up nothing is negative, and truncation is the floor.
        let (x, y) = (x - self.x0 as f32, y - self.y0 as f32);
        if !(x >= 0.0 && y >= 0.0) {
            return None;
        }
        let (u, v) = (x as i32, y as i32);
        if u + 1 >= self.width || v + 1 >= self.height {
            return None;
        }
        let i = (v * self.width + u) as usize;
        let j = i + self.width as usize;
        let (a, b) = (self.values.get(i..i + 2)?, self.values.get(j..j + 2)?);
        let (fx, fy) = (x - u as f32, y - v as f32);
        Some((a[0] * (1.0 - fx) + a[1] * fx) * (1.0 - fy) + (b[0] * (1.0 - fx) + b[1] * fx) * fy)
    }
}

fn project<const N: usize>(source: &[u8], out: &mut [f32], weights: [f32; 3]) {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("ssse3") {
        // SAFETY: the processor has SSSE3, as was just asked; the function itself is made of bounds-checked parts.
        #[allow(unsafe_code)]
        unsafe {
            project_ssse3::<N>(source, out, weights);
        }
        return;
    }
    project_plain::<N>(source, out, weights);
}

#[inline(always)]
fn project_plain<const N: usize>(source: &[u8], out: &mut [f32], [a, b, c]: [f32; 3]) {
    for (pixel, value) in source.chunks_exact(N).zip(out.iter_mut()) {
        *value = a * f32::from(pixel[0]) + b * f32::from(pixel[1]) + c * f32::from(pixel[2]);
    }
}

/// Four pixels at a time: each channel's bytes are shuffled into 32-bit lanes of their own.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "ssse3")]
#[allow(unsafe_code)]
fn project_ssse3<const N: usize>(source: &[u8], out: &mut [f32], weights: [f32; 3]) {
    use std::arch::x86_64::{
        __m128i, _mm_add_ps, _mm_cvtepi32_ps, _mm_loadu_si128, _mm_mul_ps, _mm_set1_ps, _mm_setr_epi8,
        _mm_shuffle_epi8, _mm_storeu_ps,
    };
    let n = N as i8;
    let mask = |c: i8| {
        let z = -1;
        _mm_setr_epi8(c, z, z, z, c + n, z, z, z, c + 2 * n, z, z, z, c + 3 * n, z, z, z)
    };
    let masks = [mask(0), mask(1), mask(2)];
    let w = weights.map(|w| _mm_set1_ps(w));
    let mut done = 0;
    for chunk in out.chunks_exact_mut(4) {
        let Some(bytes) = source.get(done * N..done * N + 16) else { break };
        // SAFETY: `bytes` has 16 bytes and `chunk` four floats; neither load nor store needs alignment.
        unsafe {
            let pixels = _mm_loadu_si128(bytes.as_ptr().cast::<__m128i>());
            let channel = |i: usize| _mm_mul_ps(w[i], _mm_cvtepi32_ps(_mm_shuffle_epi8(pixels, masks[i])));
            let value = _mm_add_ps(_mm_add_ps(channel(0), channel(1)), channel(2));
            _mm_storeu_ps(chunk.as_mut_ptr(), value);
        }
        done += 4;
    }
    if let (Some(source), Some(out)) = (source.get(done * N..), out.get_mut(done..)) {
        project_plain::<N>(source, out, weights);
    }
}

/// The nearest whole number, for places within ± half a million (without SSE4.1, `round` is a call).
#[inline(always)]
pub(crate) fn nearest(x: f64) -> i32 {
    const BASE: f64 = (1 << 20) as f64;
    (x + (BASE + 0.5)) as i32 - (1 << 20)
}

/// One pixel as r, g, b; `None` outside of the image.
#[inline(always)]
pub(crate) fn rgb_at(image: &ImageView<'_>, x: i32, y: i32) -> Option<[u8; 3]> {
    if x < 0 || y < 0 || x as usize >= image.width || y as usize >= image.height {
        return None;
    }
    let start = y as usize * image.step + x as usize * image.format.bytes_per_pixel();
    let p = image.data.get(start..start + 3)?;
    Some(if image.format.blue_first() { [p[2], p[1], p[0]] } else { [p[0], p[1], p[2]] })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_pixels_at_a_time_are_what_one_at_a_time_are() {
        let source: Vec<u8> = (0..4 * 61u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let weights = [0.31, -0.72, 0.05];
        for count in 0..61 {
            let (mut fast, mut plain) = (vec![0.0; count], vec![0.0; count]);
            project::<3>(&source[..3 * count], &mut fast, weights);
            project_plain::<3>(&source[..3 * count], &mut plain, weights);
            assert!(fast.iter().zip(&plain).all(|(a, b)| (a - b).abs() < 1e-4), "{count} of three");
            project::<4>(&source[..4 * count], &mut fast, weights);
            project_plain::<4>(&source[..4 * count], &mut plain, weights);
            assert!(fast.iter().zip(&plain).all(|(a, b)| (a - b).abs() < 1e-4), "{count} of four");
        }
    }

    #[test]
    fn the_nearest_whole_number_is_found_on_both_sides_of_zero() {
        for (x, wanted) in
            [(0.4, 0), (0.6, 1), (-0.4, 0), (-0.6, -1), (-7.2, -7), (639.49, 639), (-1000.7, -1001)]
        {
            assert_eq!(nearest(x), wanted);
        }
    }
}
