//! One straight edge of a square, fitted below the pixel.

use crate::{
    interior::Interior,
    outline::ShapePrior,
    quad::Quad,
    signal::{Sampler, nearest},
};
use nalgebra::{Matrix2, Vector2};
use wide::f32x8;

/// How an edge was measured.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgeFit {
    /// Displacement of the edge's middle along its outward normal, px.
    pub offset: f64,
    /// Change of the displacement per pixel along the edge.
    pub slope: f64,
    /// Covariance of (offset, slope).
    pub covariance: Matrix2<f64>,
    /// Share of the edge's usable rows that agreed with the line.
    pub support: f64,
    /// ∫ c·(1 − c) across the edge, px: a sixth of the width of a motion blur, 0.56 σ of a Gaussian one.
    pub blur: f64,
    /// Correlation of the residuals of rows that are k apart, summed up: Σ rᵢ², Σ rᵢrᵢ₊₁ … Σ rᵢrᵢ₊ₖ.
    pub lag: [f64; LAGS],
}

/// Over how many rows the residuals' correlation is measured, and the residuals themselves as lag 0.
pub(crate) const LAGS: usize = 2;
/// Most rows of one edge that are used; longer edges are sampled evenly.
pub(crate) const MAX_ROWS: usize = 64;
/// Least pixels along an edge that a corner's blur spoils.
const CORNER: f64 = 2.0;
/// Width of the band in which the level outside is measured, in parts of the square's, from 1 to 3 px; what surrounds a
/// square of less than 20 px may end 4 px beside it, and one pixel is all that is taken.
const OUTSIDE: f64 = 0.1;
/// Longest band that is read, px.
const MAX_BAND: i32 = 40;

/// An edge of a predicted outline.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Side {
    pub middle: Vector2<f64>,
    pub tangent: Vector2<f64>,
    /// Outward.
    pub normal: Vector2<f64>,
    pub length: f64,
    /// Distance of the middle from the outline's centroid, along the normal.
    pub distance: f64,
}

impl Side {
    /// All four of an outline whose centroid is `centre`.
    pub fn of(quad: &Quad, centre: Vector2<f64>) -> [Self; 4] {
        std::array::from_fn(|i| {
            let (p, q) = (quad.0[i], quad.0[(i + 1) % 4]);
            let length = (q - p).norm();
            let tangent = (q - p) / length;
            let middle = (p + q) / 2.0;
            let normal = Vector2::new(tangent.y, -tangent.x);
            let distance = normal.dot(&(middle - centre));
            let normal = if distance < 0.0 { -normal } else { normal };
            Self { middle, tangent, normal, length, distance: distance.abs() }
        })
    }
}

/// One quantity of all rows.
type Column = [f32; MAX_ROWS];

/// What was read along the rows: the sums over the band across the edge, and the level beyond it.
struct Rows {
    count: usize,
    /// Where the strip begins in the image's bytes.
    begin: [usize; MAX_ROWS],
    /// Place along the edge, px from its middle.
    along: Column,
    /// Where the predicted edge crosses the row, and where the band's inner end is seen from there, px.
    crossing: Column,
    inner: Column,
    /// Pixels of the band, Σ s, Σ s·j and Σ s².
    pixels: Column,
    s: Column,
    sj: Column,
    ss: Column,
    outside: Column,
    /// How far outside of the prediction the band reaches, across the edge, px.
    room: Column,
}

/// How the strip across an edge lies: band and what is beyond it, px, and the bytes from one pixel to the next.
struct Strip {
    band: i32,
    beyond: i32,
    hop: usize,
    /// The outside comes last.
    outward: bool,
}

impl Rows {
    /// Reads eight rows side by side.
    #[inline(always)]
    fn read(&mut self, sampler: &Sampler<'_>, strip: &Strip) {
        let Strip { band, beyond, hop, outward } = *strip;
        let (before, after) = if outward { (0, beyond) } else { (beyond, 0) };
        let (scale, share) = (sampler.scale, sampler.scale / beyond as f32);
        for group in (0..self.count).step_by(8) {
            let mut begin = [0; 8];
            begin.copy_from_slice(&self.begin[group..group + 8]);
            let (mut s, mut sj, mut ss, mut outside) = (f32x8::ZERO, f32x8::ZERO, f32x8::ZERO, f32x8::ZERO);
            for _ in 0..before {
                outside += next(sampler, &mut begin, hop);
            }
            let mut j = f32x8::ZERO;
            for _ in 0..band {
                let signals = next(sampler, &mut begin, hop);
                s += signals;
                sj += signals * j;
                ss += signals * signals;
                j += f32x8::ONE;
            }
            for _ in 0..after {
                outside += next(sampler, &mut begin, hop);
            }
            let put = |column: &mut Column, values: f32x8, scale: f32| {
                column[group..group + 8].copy_from_slice((values * f32x8::splat(scale)).as_array());
            };
            put(&mut self.s, s, scale);
            put(&mut self.sj, sj, scale);
            put(&mut self.ss, ss, scale * scale);
            put(&mut self.outside, outside, share);
        }
    }
}

/// The signals of eight rows, each a pixel further than the last time.
#[inline(always)]
fn next(sampler: &Sampler<'_>, begin: &mut [usize; 8], hop: usize) -> f32x8 {
    let signals = sampler.eight(begin);
    for b in begin {
        *b += hop;
    }
    signals
}

/// Eight rows of a quantity, and a mask of those that there are.
#[inline(always)]
fn eight(column: &Column, group: usize) -> f32x8 {
    let mut values = [0.0; 8];
    values.copy_from_slice(&column[group..group + 8]);
    f32x8::from(values)
}

#[inline(always)]
fn present(group: usize, count: usize) -> f32x8 {
    let numbers = f32x8::from([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]) + f32x8::splat(group as f32);
    numbers.simd_lt(f32x8::splat(count as f32))
}

/// Measures one edge; its offset and slope are told from the predicted side, and the level outside at its middle.
///
/// The edge is crossed by the rows (or columns, whichever crosses it more steeply) of the image. Along a row the signal,
/// scaled to 0 outside and 1 inside, is summed up: that is the place of the edge, exactly, for any symmetric blur and
/// without interpolation.
pub(crate) fn fit_edge(
    sampler: &Sampler<'_>,
    interior: &Interior,
    side: &Side,
    half_width: f64,
    prior: &ShapePrior,
    min_contrast: f64,
) -> Option<(EdgeFit, f64)> {
    let Side { middle, tangent, normal, length, .. } = *side;
    if length.is_nan() || length < 4.0 {
        return None;
    }
    // Along which axis the edge is crossed: k = 0 walks along x on rows, k = 1 along y on columns.
    let k = usize::from(normal.x.abs() < normal.y.abs());
    let (steep, sign) = (normal[k].abs(), normal[k].signum());
    // What surrounds a marker ends where the platform does, and small squares have it close by.
    let width = side.distance * 2.0;
    let half_width = half_width.min(0.2 * width).max(1.0);
    let half = half_width / steep;
    // Along the edge per row, and across rows along the edge.
    let per_row = 1.0 / tangent[1 - k];
    // Walking inward shifts the place along the edge, and must not run over the neighbouring edge.
    let inward = -sign * half * tangent[k];
    let corner = CORNER.min(0.15 * length + 0.5);
    let (low, high) = (-length / 2.0 + corner + (-inward).max(0.0), length / 2.0 - corner - inward.max(0.0));
    if high <= low {
        return None;
    }
    let (a, b) = (middle[1 - k] + low / per_row, middle[1 - k] + high / per_row);
    let first = nearest(a.min(b) + 0.5);
    let usable = nearest(a.max(b) - 0.5) - first + 1;
    if usable < 3 {
        return None;
    }
    let possible = usable.min(prior.rows.clamp(8, MAX_ROWS) as i32);
    let beyond = if width < 20.0 { 1 } else { ((OUTSIDE * width).clamp(1.0, 3.0) / steep).ceil() as i32 };
    // As many pixels in every row.
    let band = (2.0 * half + 0.5).ceil() as i32;
    if band > MAX_BAND {
        return None;
    }
    let outward = sign > 0.0;
    let strip = Strip { band, beyond, hop: sampler.hop(k), outward };
    let slope_axis = tangent[k] * per_row;
    // The image's columns and rows, along the row and across it.
    let (columns, lines) =
        if k == 0 { (sampler.width, sampler.height) } else { (sampler.height, sampler.width) };
    // While it is sought a place that is a little off will do; once it is known the whole band must be in the image.
    let sought = prior.edge_sigma >= 1.0;
    let zero: Column = [0.0; MAX_ROWS];
    let mut rows = Rows {
        count: 0,
        begin: [0; MAX_ROWS],
        along: zero,
        crossing: zero,
        inner: zero,
        pixels: [band as f32; MAX_ROWS],
        s: zero,
        sj: zero,
        ss: zero,
        outside: zero,
        room: [f32::INFINITY; MAX_ROWS],
    };
    let mut cut = false;
    for i in 0..possible {
        let line = first + if possible == usable { i } else { (i * usable + usable / 2) / possible };
        let off = f64::from(line) - middle[1 - k];
        let crossing = middle[k] + off * slope_axis;
        let from = nearest(crossing - f64::from(band - 1) / 2.0);
        let start = if outward { from } else { from - beyond };
        let inside = start >= 0 && start + band + beyond <= columns && (0..lines).contains(&line);
        if !inside {
            cut = true;
            continue;
        }
        let n = rows.count;
        let (x, y) = if k == 0 { (start, line) } else { (line, start) };
        rows.begin[n] = sampler.begin(x, y);
        rows.along[n] = (off * per_row) as f32;
        let crossing = (crossing - f64::from(from)) as f32;
        rows.crossing[n] = crossing;
        rows.inner[n] = if outward { crossing + 0.5 } else { band as f32 - crossing - 0.5 };
        rows.count = n + 1;
    }
    rows.read(sampler, &strip);
    if cut && sought {
        // At the image's edge as much as there is, as long as the marker's own edge is in it.
        for i in 0..possible {
            let line = first + if possible == usable { i } else { (i * usable + usable / 2) / possible };
            rows.add_cut(sampler, &strip, k, line, (middle, slope_axis, per_row, half, steep));
        }
    }
    let count = rows.count;
    if count < 3 || count * 4 < possible as usize {
        return None;
    }
    let outside = Outside::measure(&rows.along, &rows.outside, count, interior, min_contrast)?;
    let (level, tilt) = (f32x8::splat(outside.level as f32), f32x8::splat(outside.tilt as f32));
    // Inside, and the shading relative to the crossing, which the outside shares.
    let at_middle = f32x8::splat(interior.at(middle.x, middle.y) as f32);
    let inside_tilt = f32x8::splat(interior.gradient.dot(&tangent) as f32);
    let shading = f32x8::splat((interior.gradient[k] / interior.level.abs().max(0.3)) as f32);
    let steep = f32x8::splat(steep as f32);
    let (limit, least) = (f32x8::splat(half_width as f32), f32x8::splat(min_contrast as f32));
    let gate = f32x8::splat(outside.gate);
    let mut places = Places { count, along: rows.along, across: zero };
    let (mut good, mut blur) = ([0.0f32; MAX_ROWS], f32x8::ZERO);
    let mut all = f32x8::ZERO;
    for group in (0..count).step_by(8) {
        let of = |column: &Column| eight(column, group);
        let (along, pixels, s) = (of(&rows.along), of(&rows.pixels), of(&rows.s));
        // Σ c with c = (s·(1 − shading·(j − crossing)) − outside)/difference, all rows alike.
        let outside_here = level + tilt * along;
        let difference = at_middle + inside_tilt * along - outside_here;
        let sum =
            s * (f32x8::ONE + shading * of(&rows.crossing)) - shading * of(&rows.sj) - pixels * outside_here;
        let covered = sum / difference;
        let across = (covered - of(&rows.inner)) * steep;
        let is_good = (of(&rows.outside) - outside_here).abs().simd_le(gate)
            & difference.simd_ge(least)
            & across.abs().simd_lt(limit)
            & across.simd_lt(of(&rows.room) - f32x8::splat(0.3))
            & present(group, count);
        let one = is_good & f32x8::ONE;
        all += one;
        good[group..group + 8].copy_from_slice(one.as_array());
        // A row without contrast may have any number there.
        places.across[group..group + 8].copy_from_slice((is_good & across).as_array());
        // Σ c − Σ c², without the shading.
        let square = of(&rows.ss) - outside_here * (s + s - pixels * outside_here);
        let spread = (covered - square / (difference * difference)) * steep;
        blur += is_good & spread;
    }
    let kept = all.reduce_add();
    let blur = f64::from(blur.reduce_add() / kept.max(1.0)).max(0.0);
    if kept < count as f32 {
        places.keep(&good);
    }
    let mut edge = places.line(possible as usize, length, prior)?;
    edge.blur = blur;
    // What the outside level is uncertain by moves the whole edge: by the half-width's share of it.
    let pixels = outside.rows * f64::from(beyond);
    let contrast = (interior.level - outside.level).max(min_contrast);
    edge.covariance[(0, 0)] +=
        (half_width * interior.sigma / contrast).powi(2) * prior.correlation * prior.correlation / pixels;
    Some((edge, outside.level))
}

impl Rows {
    /// Reads a row whose strip leaves the image, as far as it is in it.
    #[cold]
    fn add_cut(
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
        self.room[n] = (room * steep) as f32;
        self.count = n + 1;
    }
}

/// Level outside along the edge: a line through the rows that agree.
struct Outside {
    level: f64,
    /// Per pixel along the edge.
    tilt: f64,
    gate: f32,
    rows: f64,
}

impl Outside {
    fn measure(
        along: &Column,
        outside: &Column,
        count: usize,
        interior: &Interior,
        min_contrast: f64,
    ) -> Option<Self> {
        // The median; where all agree the mean is as good.
        let mean = outside[..count].iter().sum::<f32>() / count as f32;
        let median = if outside[..count].iter().all(|o| (o - mean).abs() < 0.05) {
            mean
        } else {
            let mut levels = *outside;
            let levels = &mut levels[..count];
            levels.sort_unstable_by(f32::total_cmp);
            levels[count / 2]
        };
        let contrast = interior.level - f64::from(median);
        if contrast.is_nan() || contrast <= min_contrast {
            return None;
        }
        let gate = ((4.0 * interior.sigma).clamp(0.06, 0.2) * contrast.max(0.3)) as f32;
        let zero = f32x8::ZERO;
        let (mut n, mut st, mut stt, mut so, mut sto) = (zero, zero, zero, zero, zero);
        for group in (0..count).step_by(8) {
            let off = eight(outside, group) - f32x8::splat(median);
            let member = off.abs().simd_lt(f32x8::splat(gate)) & present(group, count) & f32x8::ONE;
            let (off, along) = (off * member, eight(along, group) * member);
            n += member;
            st += along;
            stt += along * along;
            so += off;
            sto += along * off;
        }
        let [n, st, stt, so, sto] = [n, st, stt, so, sto].map(|v| f64::from(v.reduce_add()));
        if n < 3.0 {
            return None;
        }
        // A weak pull to a constant level: the outer rows must not lever it.
        let stt = stt + 2.0 * n * n;
        let det = stt * n - st * st;
        Some(Self {
            level: f64::from(median) + (stt * so - st * sto) / det,
            tilt: (n * sto - st * so) / det,
            gate,
            rows: n,
        })
    }
}

/// Where the edge lies on its rows: how far along, and how far outside of the prediction, px.
struct Places {
    count: usize,
    along: Column,
    across: Column,
}

/// Sums of a straight line's normal equations.
struct LineSums {
    n: f64,
    st: f64,
    stt: f64,
    sa: f64,
    sta: f64,
}

impl Places {
    /// Leaves out the rows that are not good (those that are have 1).
    fn keep(&mut self, good: &Column) {
        let mut kept = 0;
        for (i, good) in good.iter().enumerate().take(self.count) {
            if *good > 0.0 {
                (self.along[kept], self.across[kept]) = (self.along[i], self.across[i]);
                kept += 1;
            }
        }
        self.count = kept;
    }

    /// Robust straight line through the rows' places.
    ///
    /// What covers an edge shows as rows whose crossing lies further in, never further out, so of several places that rows
    /// agree on the outermost is the edge. Rows beside ones that disagree are half covered and left out with them.
    fn line(&self, possible: usize, length: f64, prior: &ShapePrior) -> Option<EdgeFit> {
        let count = self.count;
        if count < 3 {
            return None;
        }
        let lean = 2.0 * prior.slope_sigma * length / 2.0;
        // Where nothing disagrees all rows are taken, and one look is enough.
        let zero = f32x8::ZERO;
        let (mut st, mut stt, mut sa, mut sta) = (zero, zero, zero, zero);
        for group in (0..count).step_by(8) {
            let there = present(group, count);
            let (along, across) = (eight(&self.along, group) & there, eight(&self.across, group) & there);
            st += along;
            stt += along * along;
            sa += across;
            sta += along * across;
        }
        let [st, stt, sa, sta] = [st, stt, sa, sta].map(|v| f64::from(v.reduce_add()));
        let sums = LineSums { n: count as f64, st, stt, sa, sta };
        let mean = f32x8::splat((sa / count as f64) as f32);
        let mut furthest = zero;
        for group in (0..count).step_by(8) {
            let off = (eight(&self.across, group) - mean).abs() & present(group, count);
            furthest = furthest.fast_max(off);
        }
        if !largest(furthest).is_nan() && largest(furthest) < 0.3 {
            let fit = sums.solve(prior)?;
            let (offset, slope) = (f32x8::splat(fit.0 as f32), f32x8::splat(fit.1 as f32));
            let mut residuals: Column = [0.0; MAX_ROWS];
            let (mut square, mut furthest) = (zero, zero);
            for group in (0..count).step_by(8) {
                let residual = (eight(&self.across, group) - offset - slope * eight(&self.along, group))
                    & present(group, count);
                square += residual * residual;
                furthest = furthest.fast_max(residual.abs());
                residuals[group..group + 8].copy_from_slice(residual.as_array());
            }
            let product: f32 = residuals[..count].windows(2).map(|r| r[0] * r[1]).sum();
            let (edge, gate) =
                sums.edge(fit, square.reduce_add(), product, (0.3 + lean) as f32, possible, prior);
            if largest(furthest) < gate {
                return (edge.support > 0.2).then_some(edge);
            }
        }
        self.robust_line(possible, lean, prior)
    }

    fn robust_line(&self, possible: usize, lean: f64, prior: &ShapePrior) -> Option<EdgeFit> {
        let count = self.count;
        let (along, across) = (&self.along[..count], &self.across[..count]);
        let mean = across.iter().sum::<f32>() / count as f32;
        let (mut offset, mut slope, reach);
        if across.iter().all(|a| (a - mean).abs() < 0.3) {
            (offset, slope, reach) = (mean, 0f32, 0.3 + lean);
        } else {
            let mut sorted = self.across;
            let sorted = &mut sorted[..count];
            sorted.sort_unstable_by(f32::total_cmp);
            let spread = f64::from(sorted[count * 3 / 4] - sorted[count / 4]) / 1.35;
            // The fullest place within ± reach, and the outermost that is half as full.
            reach = (2.0 * spread).clamp(0.2, 0.4) + lean;
            let near = reach as f32;
            let fullness = |at: usize| {
                let from = sorted.partition_point(|&v| v < sorted[at] - near);
                let to = sorted.partition_point(|&v| v <= sorted[at] + near);
                (from, to)
            };
            let most = (0..count).map(&fullness).map(|(a, b)| b - a).max()?;
            let enough = most.max(8.min(count));
            let (from, to) = (0..count).rev().map(&fullness).find(|(a, b)| 2 * (b - a) >= enough)?;
            (offset, slope) = (sorted[(from + to) / 2], 0.0);
        }
        let mut gate = reach as f32;
        let mut used = [false; MAX_ROWS];
        // Rows far apart are no neighbours.
        let neighbours = possible < prior.rows;
        let mut before = usize::MAX;
        let mut result = None;
        for round in 0..3 {
            let agrees = |i: usize| (across[i] - offset - slope * along[i]).abs() < gate;
            let mut members = 0usize;
            for (i, used) in used[..count].iter_mut().enumerate() {
                let member = agrees(i)
                    && (round == 0
                        || !neighbours
                        || ((i == 0 || agrees(i - 1)) && (i + 1 == count || agrees(i + 1))));
                *used = member;
                members += usize::from(member);
            }
            if members < 3 {
                return None;
            }
            if members == count && members == before {
                // Every row again: nothing changes any more.
                break;
            }
            before = members;
            let (mut st, mut stt, mut sa, mut sta) = (0f32, 0f32, 0f32, 0f32);
            for i in (0..count).filter(|i| used[*i]) {
                st += along[i];
                stt += along[i] * along[i];
                sa += across[i];
                sta += along[i] * across[i];
            }
            let [st, stt, sa, sta] = [st, stt, sa, sta].map(f64::from);
            let sums = LineSums { n: members as f64, st, stt, sa, sta };
            let fit = sums.solve(prior)?;
            (offset, slope) = (fit.0 as f32, fit.1 as f32);
            let (mut square, mut product, mut last) = (0f32, 0f32, 0f32);
            for i in 0..count {
                let residual = if used[i] { across[i] - offset - slope * along[i] } else { 0.0 };
                square += residual * residual;
                product += residual * last;
                last = residual;
            }
            let edge;
            (edge, gate) = sums.edge(fit, square, product, gate, possible, prior);
            result = Some(edge);
        }
        result.filter(|e| e.support > 0.2)
    }
}

fn largest(of: f32x8) -> f32 {
    of.as_array().iter().fold(0.0, |m, v| m.max(*v))
}

impl LineSums {
    /// Σ along², with what is known of the direction: to `slope_sigma` beforehand; what the rows weigh against it is their
    /// usual noise.
    fn stt(&self, prior: &ShapePrior) -> f64 {
        self.stt + 0.01 / (prior.slope_sigma * prior.slope_sigma)
    }

    /// Offset and slope.
    fn solve(&self, prior: &ShapePrior) -> Option<(f64, f64)> {
        let stt = self.stt(prior);
        let det = self.n * stt - self.st * self.st;
        (det > 0.0).then(|| {
            ((stt * self.sa - self.st * self.sta) / det, (self.n * self.sta - self.st * self.sa) / det)
        })
    }

    /// The edge that was fitted so, from its residuals' sum of squares and of products of neighbours, and the gate (at most
    /// `gate`, px) for its rows.
    fn edge(
        &self,
        (offset, slope): (f64, f64),
        square: f32,
        product: f32,
        gate: f32,
        possible: usize,
        prior: &ShapePrior,
    ) -> (EdgeFit, f32) {
        let stt = self.stt(prior);
        let det = self.n * stt - self.st * self.st;
        let variance = (f64::from(square) / (self.n - 2.0).max(1.0)).max(4e-4);
        let support = self.n / possible.max(1) as f64;
        let mut covariance =
            Matrix2::new(stt, -self.st, -self.st, self.n) * (variance * prior.inflation / det);
        // Rows that a cover's blur touches a little stay unnoticed: the more is covered the more there are.
        covariance[(0, 0)] += (0.2 * (1.0 - support)).powi(2);
        let lag = [f64::from(square), f64::from(product)];
        let gate = ((3.2 * variance.sqrt()) as f32).clamp(0.15, gate);
        (EdgeFit { offset, slope, covariance, support, blur: 0.0, lag }, gate)
    }
}
