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

    pub fn of(&self, rgb: [f32; 3]) -> f32 {
        self.weights[0] * rgb[0] + self.weights[1] * rgb[1] + self.weights[2] * rgb[2]
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
        let (xf, yf) = (x.floor(), y.floor());
        let (u, v) = (xf as i32 - self.x0, yf as i32 - self.y0);
        if u < 0 || v < 0 || u + 1 >= self.width || v + 1 >= self.height {
            return None;
        }
        let i = (v * self.width + u) as usize;
        let j = i + self.width as usize;
        let (a, b) = (self.values.get(i..i + 2)?, self.values.get(j..j + 2)?);
        let (fx, fy) = (x - xf, y - yf);
        Some((a[0] * (1.0 - fx) + a[1] * fx) * (1.0 - fy) + (b[0] * (1.0 - fx) + b[1] * fx) * fy)
    }
}

#[inline(always)]
fn project<const N: usize>(source: &[u8], out: &mut [f32], [a, b, c]: [f32; 3]) {
    for (pixel, value) in source.chunks_exact(N).zip(out.iter_mut()) {
        *value = a * f32::from(pixel[0]) + b * f32::from(pixel[1]) + c * f32::from(pixel[2]);
    }
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
