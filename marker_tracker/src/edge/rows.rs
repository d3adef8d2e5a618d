//! What is read along the rows that cross an edge, in columns of one quantity of all rows.

use crate::{
    edge::row_plan::{Crossing, INNER, MAX_BAND, RowPlan},
    signal::{Sampler, nearest},
};
use wide::f32x8;

/// Maximum number of rows of one edge that are used; longer edges are sampled evenly.
pub(crate) const MAX_ROWS: usize = 64;

/// One quantity of all rows.
pub(super) type Column = [f32; MAX_ROWS];

/// Eight rows of a quantity.
#[inline(always)]
pub(crate) fn eight<const N: usize>(column: &[f32; N], group: usize) -> f32x8 {
    let mut values = [0.0; 8];
    values.copy_from_slice(&column[group..group + 8]);
    f32x8::from(values)
}

/// Mask of those of eight rows that exist.
#[inline(always)]
pub(super) fn present(group: usize, count: usize) -> f32x8 {
    let numbers =
        f32x8::from([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]) + f32x8::splat(group as f32);
    numbers.simd_lt(f32x8::splat(count as f32))
}

/// Sums over the band across an edge and the level beyond it, row by row. One value serves all
/// edges of an outline: clearing it for each would take longer than reading some of its rows.
pub(crate) struct Rows {
    pub(super) count: usize,
    /// Start of the strip in the image's bytes.
    begin: [u32; MAX_ROWS],
    /// Place along the edge, px from its middle.
    pub(super) along: Column,
    /// Crossing with the predicted edge, px from the band's first pixel, and distance of the band's
    /// inner end from it, px.
    pub(super) crossing: Column,
    pub(super) inner: Column,
    /// Number of pixels j of the band, Σ s, Σ s·j and Σ s² of their signal s.
    pub(super) pixels: Column,
    pub(super) s: Column,
    pub(super) sj: Column,
    pub(super) ss: Column,
    /// Mean signal beyond the band.
    pub(super) outside: Column,
    /// Signal of the band's outermost pixel.
    pub(super) rim: Column,
    /// Σ of the light on the band's inner and outer pixels ([`RowPlan::inner_pixels`]), and mean
    /// light beyond the band.
    pub(super) light_inner: Column,
    pub(super) light_outer: Column,
    pub(super) light_outside: Column,
    /// Reach of the band outside of the prediction, across the edge, px.
    pub(super) room: Column,
}

impl Rows {
    /// Creates empty rows.
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
            light_inner: zero,
            light_outer: zero,
            light_outside: zero,
            room: zero,
        }
    }

    /// Stores where the band of row `n`, from the pixel `from` on, lies at the predicted edge.
    #[inline(always)]
    fn place(&mut self, n: usize, plan: &RowPlan, crossing: &Crossing, from: i32, band: i32) {
        let place = (crossing.place - f64::from(from)) as f32;
        self.along[n] = (crossing.off * plan.per_row) as f32;
        self.crossing[n] = place;
        self.inner[n] = if plan.outward { place + 0.5 } else { band as f32 - place - 0.5 };
    }

    /// Reads the rows of a plan; with `partly`, rows whose strip leaves the image as far as they
    /// are in it.
    pub(super) fn read_plan(&mut self, sampler: &Sampler<'_>, plan: &RowPlan, partly: bool) {
        let (columns, lines) = plan.pixel(sampler.width, sampler.height);
        // The other columns are overwritten row by row; what remains in the lanes after the last
        // row is masked.
        self.count = 0;
        let groups = (plan.possible as usize).next_multiple_of(8);
        self.pixels[..groups].fill(plan.band as f32);
        self.room[..groups].fill(f32::INFINITY);
        let mut cut = false;
        for line in (0..plan.possible).map(|i| plan.line(i)) {
            let crossing = plan.crossing(line);
            let from = plan.band_start(&crossing);
            let start = from - plan.lead();
            let is_on_line = start >= 0 && start + plan.band + plan.beyond <= columns;
            if !is_on_line || !(0..lines).contains(&line) {
                cut = true;
                continue;
            }
            let (x, y) = plan.pixel(start, line);
            let [first, last] = plan.ends(from).map(|along| plan.pixel(along, line));
            sampler.read(first.into(), last.into());
            let n = self.count;
            self.begin[n] = sampler.begin(x, y);
            self.place(n, plan, &crossing, from, plan.band);
            self.count = n + 1;
        }
        self.read(sampler, plan);
        if cut && partly {
            for i in 0..plan.possible {
                self.add_cut(sampler, plan, plan.line(i));
            }
        }
    }

    /// Normalizes each row to 1 inside and 0 outside by the levels at its own ends, and drops the
    /// rows that a shadow's edge crosses: where the brightness of the surroundings over the
    /// marker's is not `expected`.
    pub(super) fn relight(&mut self, sampler: &Sampler<'_>, plan: &RowPlan, expected: f32) {
        /// Largest relative deviation of the brightness's ratio: four standard deviations of two
        /// means of three pixels with a noise of 2 % each, and a shadow's tint.
        const TOLERANCE: f32 = 0.15;
        /// Largest missing brightness within the band, in pixels of the marker: four standard
        /// deviations of the sum of nine pixels with a noise of 2 %, and the two levels'.
        const SHADE: f32 = 0.4;
        /// Smallest contrast of a row, in units of the adapted one: a shadow may leave 0.15 of the
        /// light.
        const MIN_CONTRAST: f32 = 0.1;
        let RowPlan { band, beyond, hop, outward, .. } = *plan;
        let brightness = sampler.brightness();
        let (inner_first, band_first, outer_first) = if outward {
            (0u32.wrapping_sub(INNER * hop), 0, band as u32 * hop)
        } else {
            ((beyond + band) as u32 * hop, beyond as u32 * hop, 0)
        };
        let sum = |sampler: &Sampler<'_>, begin: u32, first: u32, count: u32| {
            let start = begin.wrapping_add(first);
            (0..count).map(|i| sampler.one(start.wrapping_add(i * hop))).sum::<f32>() / count as f32
        };
        let mut kept = 0;
        for n in 0..self.count {
            let begin = self.begin[n];
            let inside = sum(sampler, begin, inner_first, INNER);
            let outside = sum(sampler, begin, outer_first, beyond as u32);
            let bright = sum(&brightness, begin, inner_first, INNER);
            let ratio = sum(&brightness, begin, outer_first, beyond as u32) / bright.max(1e-3);
            let contrast = inside - outside;
            if contrast < MIN_CONTRAST || (ratio / expected - 1.0).abs() > TOLERANCE {
                continue;
            }
            let (scale, pixels) = (1.0 / contrast, self.pixels[n]);
            let shift = -outside * scale;
            let (s, sj, ss) = (self.s[n], self.sj[n], self.ss[n]);
            // The brightness of the band follows from the marker's share of it.
            let covered = scale * s + shift * pixels;
            let predicted = covered + (pixels - covered) * ratio;
            let measured = sum(&brightness, begin, band_first, band as u32) * pixels / bright;
            if (measured - predicted).abs() > SHADE {
                continue;
            }
            self.along[kept] = self.along[n];
            self.crossing[kept] = self.crossing[n];
            self.inner[kept] = self.inner[n];
            self.pixels[kept] = pixels;
            self.s[kept] = scale * s + shift * pixels;
            self.sj[kept] = scale * sj + shift * pixels * (pixels - 1.0) / 2.0;
            self.ss[kept] = scale * scale * ss + 2.0 * scale * shift * s + shift * shift * pixels;
            self.outside[kept] = 0.0;
            self.rim[kept] = scale * self.rim[n] + shift;
            self.room[kept] = self.room[n];
            self.light_inner[kept] = self.light_inner[n];
            self.light_outer[kept] = self.light_outer[n];
            self.light_outside[kept] = self.light_outside[n];
            kept += 1;
        }
        self.count = kept;
    }

    /// Reads all rows, eight side by side.
    #[inline(always)]
    fn read(&mut self, sampler: &Sampler<'_>, plan: &RowPlan) {
        let RowPlan { band, beyond, hop, outward, .. } = *plan;
        let (before, after) = if outward { (0, beyond) } else { (beyond, 0) };
        let rim_at = if outward { band - 1 } else { 0 };
        let second_half = band / 2;
        let shared = f32x8::splat(if band % 2 == 1 { 0.5 } else { 0.0 });
        let (scale, share) = (sampler.scale, sampler.scale / beyond as f32);
        for group in (0..self.count).step_by(8) {
            let mut begin = [0; 8];
            begin.copy_from_slice(&self.begin[group..group + 8]);
            let mut along = 0;
            let (mut s, mut sj, mut ss, mut outside) =
                (f32x8::ZERO, f32x8::ZERO, f32x8::ZERO, f32x8::ZERO);
            let (mut rim, mut light_outside) = (f32x8::ZERO, f32x8::ZERO);
            let (mut light, mut light_before) = (f32x8::ZERO, f32x8::ZERO);
            for _ in 0..before {
                let (signals, lights) = next(sampler, &begin, &mut along, hop);
                outside += signals;
                light_outside += lights;
            }
            let mut j = f32x8::ZERO;
            for i in 0..band {
                let (signals, lights) = next(sampler, &begin, &mut along, hop);
                if i == second_half {
                    // The middle pixel of an odd number belongs to both halves.
                    let before = lights * shared;
                    light_before = light + before;
                    light = lights - before;
                } else {
                    light += lights;
                }
                if i == rim_at {
                    rim = signals;
                }
                s += signals;
                sj += signals * j;
                ss += signals * signals;
                j += f32x8::ONE;
            }
            for _ in 0..after {
                let (signals, lights) = next(sampler, &begin, &mut along, hop);
                outside += signals;
                light_outside += lights;
            }
            let put = |column: &mut Column, values: f32x8, scale: f32| {
                column[group..group + 8].copy_from_slice((values * f32x8::splat(scale)).as_array());
            };
            put(&mut self.s, s, scale);
            put(&mut self.sj, sj, scale);
            put(&mut self.ss, ss, scale * scale);
            put(&mut self.outside, outside, share);
            put(&mut self.rim, rim, scale);
            let (light_inner, light_outer) =
                if outward { (light_before, light) } else { (light, light_before) };
            put(&mut self.light_inner, light_inner, 1.0);
            put(&mut self.light_outer, light_outer, 1.0);
            put(&mut self.light_outside, light_outside, 1.0 / beyond as f32);
        }
    }
}

/// The next pixel's signals and light of eight rows.
#[inline(always)]
fn next(sampler: &Sampler<'_>, begin: &[u32; 8], along: &mut u32, hop: u32) -> (f32x8, f32x8) {
    let signals = sampler.eight_with_light(&begin.map(|b| b.wrapping_add(*along)));
    *along += hop;
    signals
}

impl Rows {
    /// Reads a row whose strip leaves the image, as far as it is in it.
    #[cold]
    fn add_cut(&mut self, sampler: &Sampler<'_>, plan: &RowPlan, line: i32) {
        let half = plan.half_width / plan.steep;
        let (columns, lines) = plan.pixel(sampler.width, sampler.height);
        let end = columns - 1;
        let crossing = plan.crossing(line);
        let start = plan.band_start(&crossing) - plan.lead();
        if start >= 0 && start + plan.band + plan.beyond <= columns {
            return;
        }
        let (mut from, mut to) = (nearest(crossing.place - half), nearest(crossing.place + half));
        let mut room = f64::INFINITY;
        let beyond = if plan.outward {
            if to > end - 1 {
                to = end - 1;
                room = f64::from(to) - crossing.place;
            }
            plan.beyond.min(end - to)
        } else {
            if from < 1 {
                from = 1;
                room = crossing.place - f64::from(from);
            }
            plan.beyond.min(from)
        };
        let band = to - from + 1;
        let (first, last) = if plan.outward { (from, to + beyond) } else { (from - beyond, to) };
        if !(2..=MAX_BAND).contains(&band)
            || room < half.min(1.0)
            || beyond < 1
            || self.count >= MAX_ROWS
            || first < 0
            || last > end
            || !(0..lines).contains(&line)
        {
            return;
        }
        let [(x, y), last] = [first, last].map(|along| plan.pixel(along, line));
        sampler.read([x, y], last.into());
        let begin = sampler.begin(x, y);
        let at = |along: i32| begin + (along - first) as u32 * plan.hop;
        let (mut s, mut sj, mut ss) = (0f32, 0f32, 0f32);
        let (mut light_inner, mut light_outer) = (0f32, 0f32);
        for (j, pixel) in (from..=to).map(at).enumerate() {
            let value = sampler.one(pixel);
            s += value;
            sj += value * j as f32;
            ss += value * value;
            let from_inner_end = if plan.outward { j as i32 } else { band - 1 - j as i32 };
            let inner = (plan.inner_pixels() - from_inner_end as f32).clamp(0.0, 1.0);
            let light = sampler.light(pixel);
            light_inner += inner * light;
            light_outer += (1.0 - inner) * light;
        }
        let (mut outside, mut light_outside) = (0f32, 0f32);
        let outer = if plan.outward { to + 1 } else { first };
        for pixel in (outer..outer + beyond).map(at) {
            outside += sampler.one(pixel);
            light_outside += sampler.light(pixel);
        }
        let n = self.count;
        self.place(n, plan, &crossing, from, band);
        self.pixels[n] = band as f32;
        (self.s[n], self.sj[n], self.ss[n]) = (s, sj, ss);
        self.outside[n] = outside / beyond as f32;
        (self.light_inner[n], self.light_outer[n]) = (light_inner, light_outer);
        self.light_outside[n] = light_outside / beyond as f32;
        // The rim is unknown beyond the image; what is beside it stands in.
        self.rim[n] = self.outside[n];
        self.room[n] = (room * plan.steep) as f32;
        self.count = n + 1;
    }
}
