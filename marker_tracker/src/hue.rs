//! Hue histograms, the paper's second criterion.

use crate::{
    image::Pixels,
    quad::Quad,
    signal::{nearest, rgb_at},
};

/// Histogram of the hue (H of HSV) over the circle, weighted by saturation.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct HueHistogram {
    /// The first from 0°.
    pub bins: [f32; HueHistogram::BINS],
}

impl HueHistogram {
    pub const BINS: usize = 32;
    /// Lowest Bhattacharyya coefficient of two histograms of the same paper. Tuned; guarded by
    /// `either_criterion_switched_off_changes_the_result` (another red, 320° instead of 359°, must
    /// fall below) and `tests/bags` (no whole marker may).
    const MIN_LIKENESS: f32 = 0.6;

    /// Histogram of the inside of an outline (px), from 16 pixels; `None` with fewer than 5 of them
    /// in the image.
    pub fn of(image: &Pixels<'_>, quad: &Quad) -> Option<Self> {
        const N: usize = 4;
        let (_, center) = quad.area_and_centroid();
        let mut hue = Self::default();
        let mut n = 0;
        for p in quad.grid::<N>() {
            let p = center + (p - center) * 0.7;
            if let Some(rgb) = rgb_at(image, nearest(p.x), nearest(p.y)) {
                hue.add(rgb);
                n += 1;
            }
        }
        hue.normalize();
        (n > N).then_some(hue)
    }

    /// Adds a pixel, shared between the two nearest bins, so that a drift of a degree causes no
    /// jump.
    pub fn add(&mut self, rgb: [u8; 3]) {
        if let Some((hue, saturation)) = hue(rgb) {
            let place = hue * (Self::BINS as f32 / 360.0) - 0.5;
            // Rounds down: `place` is above −1.
            let low = (place + 1.0) as i32 - 1;
            let part = place - low as f32;
            let i = low.rem_euclid(Self::BINS as i32) as usize;
            self.bins[i] += saturation * (1.0 - part);
            self.bins[(i + 1) % Self::BINS] += saturation * part;
        }
    }

    /// Scales the bins to a sum of 1.
    pub fn normalize(&mut self) {
        let sum: f32 = self.bins.iter().sum();
        if sum > 0.0 {
            for b in &mut self.bins {
                *b /= sum;
            }
        }
    }

    /// Moves the bins by the share `gain` towards those of another histogram.
    pub fn adapt(&mut self, other: &Self, gain: f32) {
        for (b, o) in self.bins.iter_mut().zip(&other.bins) {
            *b += gain * (o - *b);
        }
    }

    /// Whether both can be histograms of the same paper.
    pub fn is_like(&self, other: &Self) -> bool {
        self.likeness(other) > Self::MIN_LIKENESS
    }

    /// Bhattacharyya coefficient Σ √(p·q) of two normalized histograms, each smoothed over its
    /// neighbors: 1 for equal ones.
    fn likeness(&self, other: &Self) -> f32 {
        let n = Self::BINS;
        let smooth = |h: &Self, i: usize| {
            0.25 * h.bins[(i + n - 1) % n] + 0.5 * h.bins[i] + 0.25 * h.bins[(i + 1) % n]
        };
        (0..n).map(|i| (smooth(self, i) * smooth(other, i)).sqrt()).sum()
    }
}

/// Hue (degrees) and saturation (0–1) of a pixel (r, g, b); `None` for gray.
pub fn hue([r, g, b]: [u8; 3]) -> Option<(f32, f32)> {
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
