//! A marker's appearance: its color and that of its surroundings, sampled from the image and
//! adapted as the light drifts, and its hue histogram.

use crate::{
    edge::Light,
    hue::HueHistogram,
    image::Pixels,
    quad::Quad,
    signal::{Discriminant, nearest, rgb_at},
};

/// Colors of one marker.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Appearance {
    /// Mean color inside, r, g, b of 0–255.
    pub marker: [f32; 3],
    /// Mean color in a band around the outline.
    pub surroundings: [f32; 3],
    pub discriminant: Discriminant,
    pub hue: HueHistogram,
}

impl Appearance {
    /// Samples the inside of an outline (px) and a band around it; `None` where too few pixels are
    /// in the image or the two colors are the same.
    pub fn sample(image: &Pixels<'_>, quad: &Quad) -> Option<Self> {
        let Sampled { marker, surroundings, hue } = Sampled::from(image, quad)?;
        let discriminant = Discriminant::between(marker, surroundings)?;
        Some(Self { marker, surroundings, discriminant, hue })
    }

    /// Light that differs from row to row; no light changes the ratio of the two brightnesses.
    pub fn light_by_row(&self) -> Light {
        let [marker, surroundings] =
            [self.marker, self.surroundings].map(|c| c.iter().sum::<f32>());
        Light::ByRow { brightness: surroundings / marker.max(1.0) }
    }

    /// Moves the colors by the share `gain` towards those inside and around an outline.
    pub fn adapt(&mut self, image: &Pixels<'_>, quad: &Quad, gain: f32) {
        let Some(Sampled { marker, surroundings, hue }) = Sampled::from(image, quad) else {
            return;
        };
        for c in 0..3 {
            self.marker[c] += gain * (marker[c] - self.marker[c]);
            self.surroundings[c] += gain * (surroundings[c] - self.surroundings[c]);
        }
        self.hue.adapt(&hue, gain);
        if let Some(d) = Discriminant::between(self.marker, self.surroundings) {
            self.discriminant = d;
        }
    }
}

/// Median colors inside and in a band around an outline, and the hues inside.
struct Sampled {
    marker: [f32; 3],
    surroundings: [f32; 3],
    hue: HueHistogram,
}

impl Sampled {
    /// Samples per side of the grid inside; 24 samples lie in the band around.
    const N: usize = 5;
    /// Distance (px) of the grid from the outline, and of the band: beyond the edge's blur.
    const INSIDE: f64 = 2.5;
    const AROUND: f64 = 4.5;

    fn from(image: &Pixels<'_>, quad: &Quad) -> Option<Self> {
        let (area, center) = quad.area_and_centroid();
        let thickness = quad.thickness_of(area);
        let inner = ((thickness - 2.0 * Self::INSIDE) / thickness).clamp(0.3, 0.8);
        let outer = (thickness + 2.0 * Self::AROUND) / thickness;
        let (mut inside, mut outside) = (Samples::default(), Samples::default());
        let mut hue = HueHistogram::default();
        for p in quad.grid::<{ Self::N }>() {
            let p = center + (p - center) * inner;
            if let Some(rgb) = rgb_at(image, nearest(p.x), nearest(p.y)) {
                inside.add(rgb);
                hue.add(rgb);
            }
        }
        for i in 0..24 {
            let (edge, along) = (i / 6, (f64::from(i % 6) + 0.5) / 6.0);
            let (p, q) = (quad.0[edge as usize], quad.0[(edge as usize + 1) % 4]);
            let p = center + (p + (q - p) * along - center) * outer;
            if let Some(rgb) = rgb_at(image, nearest(p.x), nearest(p.y)) {
                outside.add(rgb);
            }
        }
        hue.normalize();
        Some(Self { marker: inside.middle()?, surroundings: outside.middle()?, hue })
    }
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

    /// Mean of the middle half, channel by channel; `None` with fewer than eight samples.
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
