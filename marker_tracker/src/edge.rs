//! One straight edge of a square, fitted below the pixel.

mod line;
mod outside;
mod rows;

use crate::{
    interior::Interior,
    outline::ShapePrior,
    quad::Quad,
    signal::{Sampler, nearest},
};
use line::Places;
use nalgebra::{Matrix2, Vector2};
use outside::Outside;
pub(crate) use rows::Rows;
use rows::Strip;
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
    /// Level outside, at the edge's middle.
    pub outside: f64,
    /// Whether the level outside is another than it was of late: something lies beside the marker, over its edge or just short of
    /// it, and this may be that thing's edge.
    pub foreign: bool,
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
/// How much further than its band an edge's surroundings are read, in parts of the square's width.
const REACH: f64 = 0.22;
/// Largest difference of the level beyond the band from that at its rim, in units of the contrast. Beside a step there is one level;
/// where there is another further out, something else is there, and only a closer look tells the edge.
const STEP: f64 = 0.1;
/// Half-width of the closest look, px, by what share each look is closer than the one before, and the difference of the levels
/// from which on not even the closest tells the edge.
const CLOSEST: f64 = 1.3;
const CLOSER: f64 = 0.65;
const LARGEST_STEP: f64 = 0.25;
/// What an edge's own blur leaves at the band's rim at most, in units of the contrast.
const TAIL: f64 = 0.03;
/// Standard deviation of an edge's place in a channel that is full, in parts of its blur.
const CUT_OFF: f64 = 0.15;
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
/// without interpolation. Where a thing of another level lies within reach, the look is repeated closer to the edge.
pub(crate) fn fit_edge(
    sampler: &Sampler<'_>,
    interior: &Interior,
    side: &Side,
    half_width: f64,
    prior: &ShapePrior,
    min_contrast: f64,
    scratch: &mut Rows,
) -> Option<EdgeFit> {
    let (mut half_width, mut beyond) = (half_width, f64::INFINITY);
    loop {
        let (edge, step) = look(sampler, interior, side, (half_width, beyond), prior, min_contrast, scratch)?;
        if step < STEP {
            return edge;
        }
        if half_width <= CLOSEST {
            return edge.filter(|_| step < LARGEST_STEP);
        }
        (half_width, beyond) = ((half_width * CLOSER).max(CLOSEST), 1.0);
    }
}

/// One look at an edge within `half_width` px of its predicted place and no more than `beyond` px further out: the edge, if enough
/// rows tell it, and by how much the level at the band's rim differs from it, in units of the contrast.
fn look(
    sampler: &Sampler<'_>,
    interior: &Interior,
    side: &Side,
    (half_width, beyond): (f64, f64),
    prior: &ShapePrior,
    min_contrast: f64,
    scratch: &mut Rows,
) -> Option<(Option<EdgeFit>, f64)> {
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
    let beyond = beyond.min((OUTSIDE * width).clamp(1.0, 3.0)).min(REACH * width - half_width).max(1.0);
    let beyond = if width < 20.0 { 1 } else { (beyond / steep).ceil() as i32 };
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
    let rows = &mut *scratch;
    rows.begin_anew(possible as usize, band);
    // Lines evenly over the edge: of each of `possible` parts of it the middle one.
    let line_of = |i: i32| first + (i * usable + usable / 2) / possible;
    let crossing_of = |line: i32| {
        let off = f64::from(line) - middle[1 - k];
        (off, middle[k] + off * slope_axis)
    };
    let from_of = |crossing: f64| nearest(crossing - f64::from(band - 1) / 2.0);
    let lead = if outward { 0 } else { beyond };
    let is_inside = |line: i32| {
        let start = from_of(crossing_of(line).1) - lead;
        start >= 0 && start + band + beyond <= columns && (0..lines).contains(&line)
    };
    // The edge is straight: where both of its ends are in the image, all of it is.
    let whole = is_inside(line_of(0)) && is_inside(line_of(possible - 1));
    let (quotient, remainder) = (usable / possible, usable % possible);
    let (mut line, mut part) = (line_of(0), (usable / 2) % possible);
    let mut cut = false;
    for _ in 0..possible {
        if whole || is_inside(line) {
            let (off, crossing) = crossing_of(line);
            let from = from_of(crossing);
            let (x, y) = if k == 0 { (from - lead, line) } else { (line, from - lead) };
            let crossing = (crossing - f64::from(from)) as f32;
            let inner = if outward { crossing + 0.5 } else { band as f32 - crossing - 0.5 };
            rows.add(sampler.begin(x, y), (off * per_row) as f32, crossing, inner);
        } else {
            cut = true;
        }
        (line, part) = (line + quotient, part + remainder);
        if part >= possible {
            (line, part) = (line + 1, part - possible);
        }
    }
    rows.read(sampler, &strip);
    if cut && sought {
        // At the image's edge as much as there is, as long as the marker's own edge is in it.
        for i in 0..possible {
            rows.add_cut(sampler, &strip, k, line_of(i), (middle, slope_axis, per_row, half, steep));
        }
    }
    let count = rows.count;
    if count < 3 || count * 4 < possible as usize {
        return None;
    }
    let outside = Outside::measure(&rows.along, &rows.outside, count, interior, min_contrast)?;
    // Inside, and the shading relative to the crossing, which the outside shares.
    let at_middle = f32x8::splat(interior.at(middle.x, middle.y) as f32);
    let inside_tilt = f32x8::splat(interior.gradient.dot(&tangent) as f32);
    // (Light that multiplies everything multiplies a signal of either sign.)
    let level_here = interior.level.abs().max(0.3).copysign(interior.level);
    let shading = interior.gradient[k] / level_here;
    let (level, tilt) = (f32x8::splat(outside.level as f32), f32x8::splat(outside.tilt as f32));
    let shading = f32x8::splat(shading as f32);
    let steep = f32x8::splat(steep as f32);
    let (limit, least) = (f32x8::splat(half_width as f32), f32x8::splat(min_contrast as f32));
    let gate = f32x8::splat(outside.gate);
    let rim_gate = f32x8::splat(outside.rim_gate);
    let (mut step, mut believed) = (f32x8::ZERO, f32x8::ZERO);
    let mut places = Places { count, along: rows.along, across: [0.0; MAX_ROWS] };
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
        let rim = of(&rows.rim) - outside_here;
        let is_good = (of(&rows.outside) - outside_here).abs().simd_le(gate)
            & difference.simd_ge(least)
            & across.abs().simd_lt(limit)
            & across.simd_lt(of(&rows.room) - f32x8::splat(0.3))
            & present(group, count);
        step += is_good & (rim / difference);
        believed += is_good & f32x8::ONE;
        let is_good = is_good & rim.abs().simd_le(rim_gate);
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
    let step = f64::from((step.reduce_add() / believed.reduce_add().max(1.0)).abs());
    let kept = all.reduce_add();
    let blur = f64::from(blur.reduce_add() / kept.max(1.0)).max(0.0);
    if kept < count as f32 {
        places.keep(&good);
    }
    let Some(mut edge) = places.line(possible as usize, length, prior) else {
        // A closer look may tell more of them.
        return Some((None, step));
    };
    (edge.blur, edge.outside) = (blur, outside.level);
    // What the outside level is uncertain by moves the whole edge: by the outer share of the band. Its tilt turns the edge.
    let contrast = (interior.level - outside.level).max(min_contrast);
    let outer = 0.5 * f64::from(band) * normal[k].abs();
    let by_level = (outer * interior.sigma / contrast * prior.correlation).powi(2) / f64::from(beyond);
    edge.covariance[(0, 0)] += by_level / outside.rows;
    edge.covariance[(1, 1)] += by_level * outside.tilt_variance;
    // What comes near the strip's end, and blur that is cut off in a full channel.
    edge.covariance[(0, 0)] += (half_width * (step - TAIL).max(0.0)).powi(2);
    if sampler.full {
        edge.covariance[(0, 0)] += (CUT_OFF * blur).powi(2);
    }
    Some((Some(edge), step))
}
