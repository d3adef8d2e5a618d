//! What a marker looks like: its colour and its surroundings', learnt from the image and kept up to date while the light
//! drifts, and its hue histogram.

use crate::{
    image::ImageView,
    quad::Quad,
    signal::{Discriminant, nearest, rgb_at},
};
use nalgebra::Vector2;

/// Colours of one marker.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Appearance {
    pub marker: [f32; 3],
    pub surroundings: [f32; 3],
    pub discriminant: Discriminant,
    pub hue: HueHistogram,
}

impl Appearance {
    /// Learnt from the inside of an outline and from a band around it.
    pub fn learn(image: &ImageView<'_>, quad: &Quad) -> Option<Self> {
        let (marker, surroundings, hue) = sample(image, quad)?;
        let discriminant = Discriminant::between(marker, surroundings)?;
        Some(Self { marker, surroundings, discriminant, hue })
    }

    /// Follows a drift of the light by a share `gain` of what is seen now.
    pub fn follow(&mut self, image: &ImageView<'_>, quad: &Quad, gain: f32) {
        let Some((marker, surroundings, hue)) = sample(image, quad) else { return };
        for c in 0..3 {
            self.marker[c] += gain * (marker[c] - self.marker[c]);
            self.surroundings[c] += gain * (surroundings[c] - self.surroundings[c]);
        }
        self.hue.follow(&hue, gain);
        if let Some(d) = Discriminant::between(self.marker, self.surroundings) {
            self.discriminant = d;
        }
    }
}

/// Median colour inside, median colour in a band around, and the hues inside.
fn sample(image: &ImageView<'_>, quad: &Quad) -> Option<([f32; 3], [f32; 3], HueHistogram)> {
    const N: usize = 5;
    let (area, centre) = quad.area_and_centroid();
    let thickness = quad.thickness_of(area);
    let inner = ((thickness - 5.0) / thickness).clamp(0.3, 0.8);
    let outer = (thickness + 9.0) / thickness;
    let (mut inside, mut outside) = (Samples::default(), Samples::default());
    let mut hue = HueHistogram::default();
    for i in 0..N {
        for j in 0..N {
            let (u, v) = (i as f64 / (N - 1) as f64, j as f64 / (N - 1) as f64);
            let p = bilinear(quad, u, v);
            let p = centre + (p - centre) * inner;
            if let Some(rgb) = rgb_at(image, nearest(p.x), nearest(p.y)) {
                inside.add(rgb);
                hue.add(rgb);
            }
        }
    }
    for i in 0..24 {
        let (edge, along) = (i / 6, (f64::from(i % 6) + 0.5) / 6.0);
        let (p, q) = (quad.0[edge as usize], quad.0[(edge as usize + 1) % 4]);
        let p = centre + (p + (q - p) * along - centre) * outer;
        if let Some(rgb) = rgb_at(image, nearest(p.x), nearest(p.y)) {
            outside.add(rgb);
        }
    }
    hue.normalise();
    Some((inside.middle()?, outside.middle()?, hue))
}

/// Up to 25 pixels, channel by channel.
#[derive(Default)]
struct Samples {
    channels: [[u8; 25]; 3],
    count: usize,
}

impl Samples {
    fn add(&mut self, rgb: [u8; 3]) {
        if self.count < 25 {
            for (channel, value) in self.channels.iter_mut().zip(rgb) {
                channel[self.count] = value;
            }
            self.count += 1;
        }
    }

    /// Per channel the mean of the middle half; `None` of less than eight.
    fn middle(&mut self) -> Option<[f32; 3]> {
        let n = self.count;
        (n >= 8).then(|| {
            self.channels.each_mut().map(|channel| {
                let channel = &mut channel[..n];
                channel.sort_unstable();
                let middle = &channel[n / 4..n - n / 4];
                middle.iter().map(|v| f32::from(*v)).sum::<f32>() / middle.len() as f32
            })
        })
    }
}

fn bilinear(quad: &Quad, u: f64, v: f64) -> Vector2<f64> {
    quad.0[0] * (1.0 - u) * (1.0 - v)
        + quad.0[1] * u * (1.0 - v)
        + quad.0[2] * u * v
        + quad.0[3] * (1.0 - u) * v
}

/// Histogram of the hue (H of HSV), 32 bins over the circle, weighted by saturation.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct HueHistogram {
    bins: [f32; HueHistogram::BINS],
}

impl HueHistogram {
    pub const BINS: usize = 32;

    pub fn add(&mut self, rgb: [u8; 3]) {
        if let Some((hue, saturation)) = hue(rgb) {
            // Shared between the two nearest bins, so that a drift of a degree does not jump.
            let place = hue * (Self::BINS as f32 / 360.0) - 0.5;
            // `place` is above −1.
            let low = (place + 1.0) as i32 - 1;
            let part = place - low as f32;
            let i = low.rem_euclid(Self::BINS as i32) as usize;
            self.bins[i] += saturation * (1.0 - part);
            self.bins[(i + 1) % Self::BINS] += saturation * part;
        }
    }

    /// The bins, the first from 0°.
    pub fn bins(&self) -> &[f32] {
        &self.bins
    }

    pub fn normalise(&mut self) {
        let sum: f32 = self.bins.iter().sum();
        if sum > 0.0 {
            for b in &mut self.bins {
                *b /= sum;
            }
        }
    }

    pub fn follow(&mut self, other: &Self, gain: f32) {
        for (b, o) in self.bins.iter_mut().zip(&other.bins) {
            *b += gain * (o - *b);
        }
    }

    /// Bhattacharyya's coefficient of two normalised histograms, each smoothed over its neighbours: 1 for the same.
    pub fn likeness(&self, other: &Self) -> f32 {
        let n = Self::BINS;
        let smooth = |h: &Self, i: usize| {
            0.25 * h.bins[(i + n - 1) % n] + 0.5 * h.bins[i] + 0.25 * h.bins[(i + 1) % n]
        };
        (0..n).map(|i| (smooth(self, i) * smooth(other, i)).sqrt()).sum()
    }

    /// Of the inside of an outline.
    pub fn of(image: &ImageView<'_>, quad: &Quad) -> Option<Self> {
        const N: usize = 4;
        let (_, centre) = quad.area_and_centroid();
        let mut hue = Self::default();
        let mut n = 0;
        for i in 0..N {
            for j in 0..N {
                let p = bilinear(quad, i as f64 / (N - 1) as f64, j as f64 / (N - 1) as f64);
                let p = centre + (p - centre) * 0.7;
                if let Some(rgb) = rgb_at(image, nearest(p.x), nearest(p.y)) {
                    hue.add(rgb);
                    n += 1;
                }
            }
        }
        hue.normalise();
        (n > N).then_some(hue)
    }
}

/// Hue in degrees and saturation of a pixel; `None` for grey.
fn hue([r, g, b]: [u8; 3]) -> Option<(f32, f32)> {
    let (r, g, b) = (f32::from(r), f32::from(g), f32::from(b));
    let max = r.max(g).max(b);
    let delta = max - r.min(g).min(b);
    if delta < 1.0 {
        return None;
    }
    let sextant = if max == r {
        (g - b) / delta
    } else if max == g {
        2.0 + (b - r) / delta
    } else {
        4.0 + (r - g) / delta
    };
    let degrees = sextant * 60.0;
    Some((if degrees < 0.0 { degrees + 360.0 } else { degrees }, delta / max))
}
