//! What is read along the rows that cross an edge.

use super::{Column, MAX_BAND, MAX_ROWS};
use crate::signal::{Sampler, nearest};
use nalgebra::Vector2;
use wide::f32x8;

/// What was read along the rows: the sums over the band across the edge, and the level beyond it. One for all edges of an outline:
/// to clear it for each would take longer than to read some of its rows.
pub(crate) struct Rows {
    pub(super) count: usize,
    /// Where the strip begins in the image's bytes.
    pub(super) begin: [u32; MAX_ROWS],
    /// Place along the edge, px from its middle.
    pub(super) along: Column,
    /// Where the predicted edge crosses the row, and where the band's inner end is seen from there, px.
    pub(super) crossing: Column,
    pub(super) inner: Column,
    /// Pixels of the band, Σ s, Σ s·j and Σ s².
    pub(super) pixels: Column,
    pub(super) s: Column,
    pub(super) sj: Column,
    pub(super) ss: Column,
    pub(super) outside: Column,
    /// The band's outermost pixel.
    pub(super) rim: Column,
    /// How far outside of the prediction the band reaches, across the edge, px.
    pub(super) room: Column,
}

impl Rows {
    /// No rows yet.
    pub fn new() -> Self {
        let zero: Column = [0.0; MAX_ROWS];
        Self {
            count: 0,
            begin: [0; MAX_ROWS],
            along: zero,
            crossing: zero,
            inner: zero,
            pixels: zero,
            s: zero,
            sj: zero,
            ss: zero,
            outside: zero,
            rim: zero,
            room: zero,
        }
    }

    /// Forgets all rows, for at most `possible` new ones of a band of as many pixels each. Other columns are written anew for every
    /// row that is added; what they still hold in the lanes after the last row is masked out.
    pub fn begin_anew(&mut self, possible: usize, band: i32) {
        self.count = 0;
        let groups = possible.next_multiple_of(8).min(MAX_ROWS);
        self.pixels[..groups].fill(band as f32);
        self.room[..groups].fill(f32::INFINITY);
    }

    /// A row that is in the image as a whole.
    #[inline(always)]
    pub fn add(&mut self, begin: u32, along: f32, crossing: f32, inner: f32) {
        let n = self.count;
        if n < MAX_ROWS {
            self.begin[n] = begin;
            self.along[n] = along;
            self.crossing[n] = crossing;
            self.inner[n] = inner;
            self.count = n + 1;
        }
    }
}

/// How the strip across an edge lies: band and what is beyond it, px, and the bytes from one pixel to the next.
pub(super) struct Strip {
    pub band: i32,
    pub beyond: i32,
    pub hop: u32,
    /// The outside comes last.
    pub outward: bool,
}

impl Rows {
    /// Reads eight rows side by side.
    #[inline(always)]
    pub(super) fn read(&mut self, sampler: &Sampler<'_>, strip: &Strip) {
        let Strip { band, beyond, hop, outward } = *strip;
        let (before, after) = if outward { (0, beyond) } else { (beyond, 0) };
        let rim_at = if outward { band - 1 } else { 0 };
        let (scale, share) = (sampler.scale, sampler.scale / beyond as f32);
        for group in (0..self.count).step_by(8) {
            let mut begin = [0; 8];
            begin.copy_from_slice(&self.begin[group..group + 8]);
            let mut along = 0;
            let (mut s, mut sj, mut ss, mut outside) = (f32x8::ZERO, f32x8::ZERO, f32x8::ZERO, f32x8::ZERO);
            let mut rim = f32x8::ZERO;
            for _ in 0..before {
                outside += next(sampler, &begin, &mut along, hop);
            }
            let mut j = f32x8::ZERO;
            for i in 0..band {
                let signals = next(sampler, &begin, &mut along, hop);
                if i == rim_at {
                    rim = signals;
                }
                s += signals;
                sj += signals * j;
                ss += signals * signals;
                j += f32x8::ONE;
            }
            for _ in 0..after {
                outside += next(sampler, &begin, &mut along, hop);
            }
            let put = |column: &mut Column, values: f32x8, scale: f32| {
                column[group..group + 8].copy_from_slice((values * f32x8::splat(scale)).as_array());
            };
            put(&mut self.s, s, scale);
            put(&mut self.sj, sj, scale);
            put(&mut self.ss, ss, scale * scale);
            put(&mut self.outside, outside, share);
            put(&mut self.rim, rim, scale);
        }
    }
}

/// The signals of eight rows, each a pixel further than the last time.
#[inline(always)]
fn next(sampler: &Sampler<'_>, begin: &[u32; 8], along: &mut u32, hop: u32) -> f32x8 {
    let signals = sampler.eight(&begin.map(|b| b.wrapping_add(*along)));
    *along += hop;
    signals
}

impl Rows {
    /// Reads a row whose strip leaves the image, as far as it is in it.
    #[cold]
    pub(super) fn add_cut(
        &mut self,
        sampler: &Sampler<'_>,
        strip: &Strip,
        k: usize,
        line: i32,
        (middle, slope_axis, per_row, half, steep): (Vector2<f64>, f64, f64, f64, f64),
    ) {
        let end = if k == 0 { sampler.width } else { sampler.height } - 1;
        let off = f64::from(line) - middle[1 - k];
        let crossing = middle[k] + off * slope_axis;
        let from = nearest(crossing - f64::from(strip.band - 1) / 2.0);
        let start = if strip.outward { from } else { from - strip.beyond };
        if start >= 0 && start + strip.band + strip.beyond <= end + 1 {
            return;
        }
        let (mut from, mut to) = (nearest(crossing - half), nearest(crossing + half));
        let mut room = f64::INFINITY;
        let beyond = if strip.outward {
            if to > end - 1 {
                to = end - 1;
                room = f64::from(to) - crossing;
            }
            strip.beyond.min(end - to)
        } else {
            if from < 1 {
                from = 1;
                room = crossing - f64::from(from);
            }
            strip.beyond.min(from)
        };
        let band = to - from + 1;
        if !(2..=MAX_BAND).contains(&band) || room < half.min(1.0) || beyond < 1 || self.count >= MAX_ROWS {
            return;
        }
        let start = if strip.outward { from } else { from - beyond };
        let (x, y) = if k == 0 { (start, line) } else { (line, start) };
        let Some((bytes, hop)) = sampler.line(x, y, k, band + beyond, 1) else { return };
        let (inner, outer) = if strip.outward {
            bytes.split_at(band as usize * hop)
        } else {
            let (outer, inner) = bytes.split_at(beyond as usize * hop);
            (inner, outer)
        };
        let (mut s, mut sj, mut ss, mut outside) = (0f32, 0f32, 0f32, 0f32);
        sampler.each(inner, hop, |j, value| {
            let value = value as f32 * sampler.scale;
            s += value;
            sj += value * j as f32;
            ss += value * value;
        });
        sampler.each(outer, hop, |_, value| outside += value as f32 * sampler.scale);
        let n = self.count;
        self.along[n] = (off * per_row) as f32;
        let crossing = (crossing - f64::from(from)) as f32;
        self.crossing[n] = crossing;
        self.inner[n] = if strip.outward { crossing + 0.5 } else { band as f32 - crossing - 0.5 };
        self.pixels[n] = band as f32;
        (self.s[n], self.sj[n], self.ss[n]) = (s, sj, ss);
        self.outside[n] = outside / beyond as f32;
        // What is beyond the image is not known: its rim is taken to be as what is beside it.
        self.rim[n] = self.outside[n];
        self.room[n] = (room * steep) as f32;
        self.count = n + 1;
    }
}
