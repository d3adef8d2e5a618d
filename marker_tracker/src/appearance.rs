//! A marker's appearance: its color and that of its surroundings, sampled from the image and
//! adapted as the light drifts, and its hue histogram.

use crate::{
    edge::Light,
    hue::HueHistogram,
    image::Pixels,
    quad::Quad,
    signal::{Discriminant, nearest, rgb_at},
};
use nalgebra::{Matrix3, Vector3};

/// Colors of one marker.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Appearance {
    /// Mean color inside, r, g, b of 0–255.
    pub marker: [f32; 3],
    /// Mean color in a band around the outline.
    pub surroundings: [f32; 3],
    /// Mean square of the differences from these two colors, where something else is seen.
    pub scatter: Matrix3<f32>,
    pub discriminant: Discriminant,
    pub hue: HueHistogram,
}

impl Appearance {
    /// Samples the inside of an outline (px) and a band around it; `None` where too few pixels are
    /// in the image or the two colors are the same.
    pub fn sample(image: &Pixels<'_>, quad: &Quad) -> Option<Self> {
        let Sampled { marker, surroundings, scatter, hue } = Sampled::from(image, quad)?;
        let discriminant = Discriminant::between(marker, surroundings, &scatter)?;
        Some(Self { marker, surroundings, scatter, discriminant, hue })
    }

    /// Light that differs from row to row; no light changes the ratio of the two brightnesses.
    pub fn light_by_row(&self) -> Light {
        let [marker, surroundings] =
            [self.marker, self.surroundings].map(|c| c.iter().sum::<f32>());
        Light::ByRow { brightness: surroundings / marker.max(1.0) }
    }

    /// Moves the colors by the share `gain` towards those inside and around an outline.
    pub fn adapt(&mut self, image: &Pixels<'_>, quad: &Quad, gain: f32) {
        let Some(Sampled { marker, surroundings, scatter, hue }) = Sampled::from(image, quad)
        else {
            return;
        };
        for c in 0..3 {
            self.marker[c] += gain * (marker[c] - self.marker[c]);
            self.surroundings[c] += gain * (surroundings[c] - self.surroundings[c]);
        }
        // More slowly: what passes beside the marker for a moment does not count.
        self.scatter += (scatter - self.scatter) * (gain * gain);
        self.hue.adapt(&hue, gain);
        if let Some(d) = Discriminant::between(self.marker, self.surroundings, &self.scatter) {
            self.discriminant = d;
        }
    }
}

/// Median colors inside of an outline and in a band around it, their scatter, and the hues inside.
struct Sampled {
    marker: [f32; 3],
    surroundings: [f32; 3],
    scatter: Matrix3<f32>,
    hue: HueHistogram,
}

impl Sampled {
    /// Samples per side of the grid inside, and on each ring around.
    const N: usize = 5;
    const RING: usize = 24;
    /// Distance (px) of the grid from the outline, and of the ring whose colors are the
    /// surroundings': beyond the edge's blur.
    const INSIDE: f64 = 2.5;
    const AROUND: f64 = 4.5;
    /// Distances of two more rings, px, on whatever else a band across an edge may contain: a
    /// border, a cable, the platform's rim.
    const NEAR: f64 = 1.5;
    const FAR: f64 = 6.5;
    /// Largest saturation of what counts there: a signal that does not show something colorful
    /// hardly shows some markers.
    const GRAY: f32 = 0.35;

    fn from(image: &Pixels<'_>, quad: &Quad) -> Option<Self> {
        let (area, center) = quad.area_and_centroid();
        let thickness = quad.thickness_of(area);
        let inner = ((thickness - 2.0 * Self::INSIDE) / thickness).clamp(0.3, 0.8);
        let (mut inside, mut hue) = (Samples::default(), HueHistogram::default());
        for p in quad.grid::<{ Self::N }>() {
            let p = center + (p - center) * inner;
            if let Some(rgb) = rgb_at(image, nearest(p.x), nearest(p.y)) {
                inside.add(rgb);
                hue.add(rgb);
            }
        }
        hue.normalize();
        let rings = [Self::AROUND, Self::NEAR, Self::FAR].map(|distance| {
            let outer = (thickness + 2.0 * distance) / thickness;
            let mut ring = Samples::default();
            for i in 0..Self::RING {
                let (edge, along) = (i / 6, (f64::from((i % 6) as u32) + 0.5) / 6.0);
                let (p, q) = (quad.0[edge], quad.0[(edge + 1) % 4]);
                let p = center + (p + (q - p) * along - center) * outer;
                if let Some(rgb) = rgb_at(image, nearest(p.x), nearest(p.y)) {
                    ring.add(rgb);
                }
            }
            ring
        });
        let (marker, surroundings) = (inside.middle()?, rings[0].middle()?);
        let edge = [marker, surroundings];
        let around = rings.each_ref().map(|ring| ring.scatter(surroundings, edge, Self::GRAY));
        let around = around.iter().sum::<Matrix3<f32>>() / rings.len() as f32;
        let scatter = inside.scatter(marker, edge, 1.0) + around;
        Some(Self { marker, surroundings, scatter, hue })
    }
}

/// Up to 25 pixels, channel by channel.
#[derive(Default)]
struct Samples {
    channels: [[u8; 25]; 3],
    count: usize,
}

impl Samples {
    /// Distance from the mixtures of marker and surroundings from which on a pixel shows something
    /// else, in gray values: texture and noise of paper and platform are smaller.
    const OTHER: f32 = 40.0;
    /// Brightness below which a pixel has no color, gray values.
    const DARK: f32 = 60.0;

    fn add(&mut self, rgb: [u8; 3]) {
        if self.count < 25 {
            for (channel, value) in self.channels.iter_mut().zip(rgb) {
                channel[self.count] = value;
            }
            self.count += 1;
        }
    }

    /// Mean of the middle half, channel by channel; `None` with fewer than eight samples.
    fn middle(&self) -> Option<[f32; 3]> {
        let n = self.count;
        (n >= 8).then(|| {
            self.channels.map(|mut channel| {
                let channel = &mut channel[..n];
                channel.sort_unstable();
                let middle = &channel[n / 4..n - n / 4];
                middle.iter().map(|v| f32::from(*v)).sum::<f32>() / middle.len() as f32
            })
        })
    }

    /// Mean square of the differences from a color, of the pixels that are no mixture of the two
    /// colors beside an edge, and whose saturation is at most this.
    fn scatter(
        &self,
        from: [f32; 3],
        [marker, surroundings]: [[f32; 3]; 2],
        saturation: f32,
    ) -> Matrix3<f32> {
        let from = Vector3::from(from);
        let across = (Vector3::from(marker) - Vector3::from(surroundings))
            .try_normalize(0.0)
            .unwrap_or_default();
        let mut sum = Matrix3::zeros();
        for i in 0..self.count {
            let rgb = Vector3::from(self.channels.map(|channel| f32::from(channel[i])));
            let off = rgb - from;
            let is_gray = rgb.max() - rgb.min() <= saturation * rgb.max().max(Self::DARK);
            if is_gray && (off - across * across.dot(&off)).norm() > Self::OTHER {
                sum += off * off.transpose();
            }
        }
        sum / self.count.max(1) as f32
    }
}
