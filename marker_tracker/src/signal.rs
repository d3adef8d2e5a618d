//! The color signal: the projection of a pixel onto one direction of RGB space.

use crate::{
    form::Form,
    image::{Coverage, Pixels},
};
use nalgebra::{Matrix3, Vector2, Vector3};
use wide::{f32x8, u32x8};

/// A direction in RGB space along which a marker differs most from its surroundings, and what else
/// is there (borders, cables, the platform's rim, highlights) least.
///
/// With a linear sensor the signal `weights · (r, g, b)` is linear in the share of a pixel that the
/// marker covers, so that its moments and edge integrals are unbiased under blur, chroma
/// subsampling and demosaicing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Discriminant {
    /// Per channel r, g, b; `weights · (marker − surroundings) = 1` in the light of the samples.
    pub weights: [f32; 3],
    /// Per channel r, g, b: the light on a pixel in units of that of the samples, `light · marker =
    /// light · surroundings = 1`, whatever share of it the marker covers; `None` where paper and
    /// surroundings differ too little in chromaticity, or one of them is too dark.
    pub light: Option<[f32; 3]>,
    /// Whether a channel in which the two differ is saturated: it no longer measures the light, and
    /// an edge's blur is cut off in it.
    pub saturated: bool,
}

impl Discriminant {
    /// Level from which on a channel may be saturated: 255 less 10 %, because the colors are
    /// adapted with a delay of some images.
    const SATURATED: f32 = 228.0;
    /// Smallest squared distance of the two colors: 5 gray values, a few times a camera's noise.
    const MIN_DISTANCE2: f32 = 25.0;
    /// Variance of each channel's noise, of texture and of what JPEG adds: 3 gray values.
    const NOISE2: f32 = 9.0;
    /// Least sine of the angle between the two colors that separates light from paper: 3°, with
    /// which a pixel's noise of 1 % shifts the marker's share of it by 0.2.
    const MIN_SINE2: f32 = 0.05 * 0.05;

    /// Between the mean colors (r, g, b of 0–255) of a marker and of its surroundings (Fisher's
    /// linear discriminant); `None` where the colors are the same. `scatter`: mean
    /// square of the differences from them where something else is seen, beside equal noise in the
    /// channels.
    pub fn between(
        marker: [f32; 3],
        surroundings: [f32; 3],
        scatter: &Matrix3<f32>,
    ) -> Option<Self> {
        let d = [0, 1, 2].map(|i| marker[i] - surroundings[i]);
        let gain = d.iter().map(|d| d * d).sum::<f32>();
        if !(gain.is_finite() && gain > Self::MIN_DISTANCE2) {
            return None;
        }
        let d3 = Vector3::from(d);
        let noise = Matrix3::identity() * Self::NOISE2;
        let direction = (noise + scatter).cholesky()?.solve(&d3);
        let weights: [f32; 3] = (direction / direction.dot(&d3)).into();
        let saturated = (0..3).any(|i| {
            (weights[i] * d[i]).abs() > 0.05 && marker[i].max(surroundings[i]) > Self::SATURATED
        });
        Some(Self { weights, light: Self::light(marker, d, gain), saturated })
    }

    /// The shortest form that has the value 1 on both colors: the part of `marker` across the
    /// difference `d` of the colors, whose square is `gain`.
    fn light(marker: [f32; 3], d: [f32; 3], gain: f32) -> Option<[f32; 3]> {
        let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let along = dot(marker, d) / gain;
        let across = [0, 1, 2].map(|i| marker[i] - along * d[i]);
        let square = dot(across, across);
        let surroundings = [0, 1, 2].map(|i| marker[i] - d[i]);
        let product = dot(marker, marker) * dot(surroundings, surroundings);
        (square > Self::MIN_DISTANCE2 && square * gain > Self::MIN_SINE2 * product)
            .then(|| across.map(|v| v / square))
    }

    /// Signal of a color.
    pub fn project(&self, color: [f32; 3]) -> f32 {
        self.weights.iter().zip(&color).map(|(w, c)| w * c).sum()
    }
}

/// An image through one marker's discriminant: the color signal of any pixel, computed on demand.
///
/// Nothing is copied: a marker's outline needs about a thousand pixels, most of them once.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sampler<'a> {
    data: &'a [u8],
    step: usize,
    bytes: usize,
    /// Of the image, px.
    pub width: i32,
    pub height: i32,
    signal: Form,
    /// As in [`Discriminant`].
    light: Option<Form>,
    /// Whether the signal is divided by the light.
    in_any_light: bool,
    /// Signal per unit of what [`Sampler::eight`] and [`Sampler::units`] return.
    pub scale: f32,
    /// As in [`Discriminant`].
    pub saturated: bool,
    /// What is decoded of the image, where that is not all.
    coverage: Option<&'a Coverage>,
}

impl<'a> Sampler<'a> {
    /// Units of a signal of 1 that is divided by the light.
    const UNITS: f32 = 4096.0;
    /// Least light that a signal is divided by, in units of that of the samples: a pixel of less is
    /// noise.
    const MIN_LIGHT: f32 = 0.03;

    /// Prepares the integer weights.
    pub fn new(image: &'a Pixels<'_>, discriminant: &Discriminant) -> Self {
        let blue_first = image.format.blue_first();
        let signal = Form::new(discriminant.weights, blue_first);
        Self {
            data: image.data,
            step: image.step,
            bytes: image.format.bytes_per_pixel(),
            width: image.width as i32,
            height: image.height as i32,
            scale: signal.scale,
            signal,
            light: discriminant.light.map(|weights| Form::new(weights, blue_first)),
            in_any_light: false,
            saturated: discriminant.saturated,
            coverage: image.coverage.as_ref(),
        }
    }

    /// The same image with the signal of each pixel divided by the light on it: a light that
    /// changes from pixel to pixel leaves no edge in it. Noisier, because the light is. `None`
    /// where nothing measures the light.
    pub fn in_any_light(&self) -> Option<Self> {
        self.light?;
        Some(Self { in_any_light: true, scale: 1.0 / Self::UNITS, ..*self })
    }

    /// What one unit of the signals' sums, divided by one of the light's, is in units of the scale.
    #[inline(always)]
    fn ratio(&self, light: &Form) -> f32 {
        Self::UNITS * self.signal.scale / light.scale
    }

    /// Signal of the pixel with this first byte, in units of the scale; 0 outside of the image.
    #[inline(always)]
    pub fn units(&self, begin: u32) -> i32 {
        let [a, b, c, _] = self.word(begin).to_le_bytes();
        let signal = self.signal.of(a, b, c);
        match &self.light {
            Some(light) if self.in_any_light => {
                let least = Self::MIN_LIGHT / light.scale;
                (signal as f32 * self.ratio(light) / (light.of(a, b, c) as f32).max(least)) as i32
            }
            _ => signal,
        }
    }

    /// Light on the pixel with this first byte, in units of that of the samples; 1 where nothing
    /// measures it.
    pub fn light(&self, begin: u32) -> f32 {
        let [a, b, c, _] = self.word(begin).to_le_bytes();
        self.light.as_ref().map_or(1.0, |light| light.of(a, b, c) as f32 * light.scale)
    }

    /// Signal at a pixel; `None` outside of the image.
    #[inline(always)]
    pub fn at(&self, x: i32, y: i32) -> Option<f32> {
        let is_inside = (0..self.width).contains(&x) && (0..self.height).contains(&y);
        is_inside.then(|| self.one(self.begin(x, y)))
    }

    /// Records that a line's pixels from (`x0`, `y0`) to (`x1`, `y1`) are read.
    #[inline(always)]
    pub fn read(&self, [x0, y0]: [i32; 2], [x1, y1]: [i32; 2]) {
        if let Some(coverage) = self.coverage {
            coverage.read([x0.min(x1), y0.min(y1)], [x0.max(x1), y0.max(y1)]);
        }
    }

    /// Index of the first byte of a pixel, which is read. (No image has 4 GiB; of one that had,
    /// other pixels would be read.)
    #[inline(always)]
    pub fn begin(&self, x: i32, y: i32) -> u32 {
        self.read([x, y], [x, y]);
        (y as usize * self.step + x as usize * self.bytes) as u32
    }

    /// Bytes from a pixel to the next along x (`axis` 0) or y (`axis` 1).
    #[inline(always)]
    pub fn hop(&self, axis: usize) -> u32 {
        (if axis == 0 { self.bytes } else { self.step }) as u32
    }

    /// Four bytes from a pixel's first on; the last belongs to the next pixel, or is 0.
    #[inline(always)]
    fn word(&self, begin: u32) -> u32 {
        let begin = begin as usize;
        match self.data.get(begin..begin + 4) {
            Some(&[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]),
            _ => self.last_word(begin),
        }
    }

    #[cold]
    fn last_word(&self, begin: usize) -> u32 {
        match self.data.get(begin..begin + 3) {
            Some(&[a, b, c]) => u32::from_le_bytes([a, b, c, 0]),
            _ => 0,
        }
    }

    /// The same image by its brightness (mean of the channels).
    pub fn brightness(&self) -> Self {
        let signal = Form::new([1.0 / 3.0; 3], false);
        Self { signal, scale: signal.scale, ..*self }
    }

    /// Signal of the pixel with this first byte; 0 outside of the image.
    #[inline(always)]
    pub fn one(&self, begin: u32) -> f32 {
        self.units(begin) as f32 * self.scale
    }

    /// Signals of eight pixels from their first bytes, in units of the scale.
    #[inline(always)]
    pub fn eight(&self, begin: &[u32; 8]) -> f32x8 {
        self.eight_with_light(begin).0
    }

    /// The same, and the light on these pixels; 1 where nothing measures it.
    #[inline(always)]
    pub fn eight_with_light(&self, begin: &[u32; 8]) -> (f32x8, f32x8) {
        let words = self.words(begin);
        let signal = self.signal.eight(words);
        let Some(form) = &self.light else { return (signal, f32x8::ONE) };
        let light = form.eight(words);
        let signal = if self.in_any_light {
            let least = f32x8::splat(Self::MIN_LIGHT / form.scale);
            signal * f32x8::splat(self.ratio(form)) / light.fast_max(least)
        } else {
            signal
        };
        (signal, light * f32x8::splat(form.scale))
    }

    #[inline(always)]
    fn words(&self, begin: &[u32; 8]) -> u32x8 {
        // Written out: a map over the array is compiled to a call per pixel.
        let [a, b, c, d, e, f, g, h] = *begin;
        u32x8::new([
            self.word(a),
            self.word(b),
            self.word(c),
            self.word(d),
            self.word(e),
            self.word(f),
            self.word(g),
            self.word(h),
        ])
    }
}

/// Rounds to the nearest integer, for values within ± 2³¹ (an arbitrary number for others and NaN).
///
/// Adding 1.5·2⁵² leaves the rounded integer in the mantissa's low bits.
#[inline(always)]
pub(crate) fn nearest(x: f64) -> i32 {
    const SHIFT: f64 = 6_755_399_441_055_744.0;
    (x + SHIFT).to_bits() as i32
}

/// One pixel as r, g, b; `None` outside of the image.
#[inline(always)]
pub(crate) fn rgb_at(image: &Pixels<'_>, x: i32, y: i32) -> Option<[u8; 3]> {
    if x < 0 || y < 0 || x as usize >= image.width || y as usize >= image.height {
        return None;
    }
    if let Some(coverage) = &image.coverage {
        coverage.read([x, y], [x, y]);
    }
    let start = y as usize * image.step + x as usize * image.format.bytes_per_pixel();
    let p = image.data.get(start..start + 3)?;
    Some(if image.format.blue_first() { [p[2], p[1], p[0]] } else { [p[0], p[1], p[2]] })
}

/// Mean color (r, g, b of 0–255) of the square of side 2·`radius` + 1 about a place (px); `None`
/// outside of the image.
pub(crate) fn mean_rgb(image: &Pixels<'_>, at: Vector2<f64>, radius: i32) -> Option<[f64; 3]> {
    let (cx, cy) = (at.x.round() as i32, at.y.round() as i32);
    let (mut sum, mut n) = ([0.0; 3], 0.0);
    for y in cy.saturating_sub(radius)..=cy.saturating_add(radius) {
        for x in cx.saturating_sub(radius)..=cx.saturating_add(radius) {
            if let Some(rgb) = rgb_at(image, x, y) {
                for (s, v) in sum.iter_mut().zip(rgb) {
                    *s += f64::from(v);
                }
                n += 1.0;
            }
        }
    }
    (n > 0.0).then(|| sum.map(|s| s / n))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{ImageView, PixelFormat};
    use rig_model::Stamp;

    #[test]
    fn eight_pixels_and_single_ones_agree() {
        let data: Vec<u8> =
            (0..20 * 60u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        let discriminant =
            Discriminant { weights: [0.31, -0.72, 0.05], light: None, saturated: false };
        let (stamp, format) = (Stamp::from_nanos(0), PixelFormat::Bgra8);
        let view = ImageView { stamp, width: 14, height: 20, step: 60, format, data: &data };
        let view = Pixels::whole(view, None);
        let sampler = Sampler::new(&view, &discriminant);
        for (x, y) in [(0, 0), (5, 7), (13, 19)] {
            let rgb = rgb_at(&view, x, y).unwrap().map(f32::from);
            let wanted: f32 = rgb.iter().zip(discriminant.weights).map(|(p, w)| p * w).sum();
            let tolerance = 255.0 * 3.0 * 0.72 / 2048.0;
            assert!((sampler.at(x, y).unwrap() - wanted).abs() < tolerance);
        }
        for (axis, step) in [(0, (1, 0)), (1, (0, 1))] {
            let begin = std::array::from_fn(|j| sampler.begin(3, 4) + j as u32 * sampler.hop(axis));
            for (j, value) in (0..).zip(sampler.eight(&begin).to_array()) {
                assert_eq!(value, sampler.units(begin[j as usize]) as f32);
                let at = sampler.at(3 + step.0 * j, 4 + step.1 * j).unwrap();
                assert_eq!(value * sampler.scale, at);
            }
        }
        // The last pixel has no byte after it.
        let last = sampler.eight(&[sampler.begin(13, 19); 8]).to_array();
        assert_eq!(last[7] * sampler.scale, sampler.at(13, 19).unwrap());
        assert!(sampler.at(14, 0).is_none() && sampler.at(0, -1).is_none());
    }

    #[test]
    fn rounding_works_on_both_sides_of_zero() {
        for (x, wanted) in
            [(0.4, 0), (0.6, 1), (-0.4, 0), (-0.6, -1), (-7.2, -7), (639.49, 639), (-1000.7, -1001)]
        {
            assert_eq!(nearest(x), wanted);
        }
    }
}
