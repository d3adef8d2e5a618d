//! Edge measurement: rows across the edge, summed up and fitted by a line.

use crate::{
    edge::{
        interior::Interior,
        line::{EdgeFit, Places},
        outside::{MIN_CONTRAST, Outside},
        prior::{Light, ShapePrior},
        row_plan::{RowPlan, Side},
        rows::{Column, MAX_ROWS, Rows, eight, present},
    },
    signal::Sampler,
};
use wide::f32x8;

/// Largest difference of the level beyond the band from that at its rim, in units of the contrast.
/// Beside a step there is one level; where another one lies further out, something else is there,
/// and only a narrower band measures the edge. Tuned on scenes with poles and hands before the
/// markers.
const STEP: f64 = 0.1;
/// The same for the narrowest band.
const LARGEST_STEP: f64 = 0.25;
/// Half-width of the narrowest band, px: the blur of a lens and of JPEG's chroma; and the share of
/// the width that each attempt has of the one before.
const NARROWEST: f64 = 1.3;
const NARROWER: f64 = 0.65;
/// Largest share of the contrast that an edge's own blur leaves at the band's rim: 2.5 σ of a
/// Gaussian blur leave 0.6 %, a motion blur and sharpening more.
const TAIL: f64 = 0.03;
/// Standard deviation of an edge's place in a saturated channel, in units of its blur.
const SATURATED: f64 = 0.15;
/// Largest [`EdgeFit::shade`] in even light, px: noise and JPEG leave 0.12 of the recorded bags'
/// rows. Tuned; guarded by `tests/synthetic` and `tests/bags`.
pub(crate) const SHADE: f64 = 0.2;
/// Standard deviation of an edge's place, in units of the shade: where the rows are normalized, of
/// what is above [`SHADE`]; where the pixels are, because light and share of the marker do not
/// factor within a pixel. Tuned; guarded by `tests/synthetic`.
const BY_ROW: f64 = 0.3;
const BY_PIXEL: f64 = 0.08;

/// Measures one edge: offset and slope relative to the predicted side, and the level outside.
///
/// The edge is crossed by rows (or columns, whichever cross it more steeply) of the image. Along a
/// row the signal, scaled to 0 outside and 1 inside, is summed up: the place of the edge, exact for
/// any symmetric blur and without interpolation. Where something of another level lies within the
/// band, or while the edge is searched the light changes in it, the measurement is repeated with a
/// narrower one; of those in changing light the widest counts.
///
/// `half_width`: of the band, px. `None` where too few rows agree on an edge.
pub(crate) fn fit_edge(
    sampler: &Sampler<'_>,
    interior: &Interior,
    side: &Side,
    half_width: f64,
    prior: &ShapePrior,
    scratch: &mut Rows,
) -> Option<EdgeFit> {
    let (mut half_width, mut beyond) = (half_width, f64::INFINITY);
    // While an edge is searched, a shade is rather a border or cable that a narrower band leaves
    // out.
    let searching = prior.tolerance.edge >= 1.0 && prior.light == Light::Even;
    let mut shaded = None;
    loop {
        let bands = [half_width, beyond];
        let Some(attempt) = attempt(sampler, interior, side, bands, prior, scratch) else {
            return shaded;
        };
        if attempt.step < STEP {
            match attempt.edge {
                Some(edge) if searching && edge.shade > SHADE => shaded = shaded.or(Some(edge)),
                edge => return edge.or(shaded),
            }
        }
        if half_width <= NARROWEST {
            return shaded.or(attempt.edge.filter(|_| attempt.step < LARGEST_STEP));
        }
        (half_width, beyond) = ((half_width * NARROWER).max(NARROWEST), 1.0);
    }
}

/// One measurement of an edge.
struct Attempt {
    /// `None` where too few rows agree; a narrower band may find more.
    edge: Option<EdgeFit>,
    /// Difference of the level at the band's rim from that beyond, in units of the contrast.
    step: f64,
}

/// Measures an edge with one band; its half-width and the width beyond it are as in
/// [`RowPlan::new`].
fn attempt(
    sampler: &Sampler<'_>,
    interior: &Interior,
    side: &Side,
    [half_width, beyond]: [f64; 2],
    prior: &ShapePrior,
    rows: &mut Rows,
) -> Option<Attempt> {
    let plan = RowPlan::new(sampler, side, half_width, beyond, prior.tolerance.rows)?;
    if let Light::ByRow { brightness } = prior.light {
        rows.read_plan(sampler, &plan, false);
        rows.relight(sampler, &plan, brightness);
    } else {
        // While the edge is searched, rows that leave the image serve as far as they are in it.
        rows.read_plan(sampler, &plan, prior.tolerance.edge >= 1.0);
    }
    let count = rows.count;
    if count < 3 || count * 4 < plan.possible as usize {
        return None;
    }
    let outside = Outside::measure(&rows.along, &rows.outside, count, interior)?;
    let contrast = (interior.level - outside.level).max(MIN_CONTRAST);
    let weights = match prior.light {
        Light::Even => [interior.level, outside.level].map(|level| level / contrast),
        Light::ByRow { .. } | Light::ByPixel => [1.0; 2],
    };
    let crossings = Crossings::find(rows, &plan, interior, &outside, weights);
    let step = crossings.step;
    let Some(mut edge) = crossings.places.line(plan.possible as usize, side.length, prior) else {
        return Some(Attempt { edge: None, step });
    };
    (edge.blur, edge.outside, edge.shade) = (crossings.blur, outside.level, crossings.shade);
    edge.light_outside = f64::from(rows.light_outside[..count].iter().sum::<f32>())
        / (count as f64 * interior.light.max(1e-3));
    // The outside level's error moves the whole edge, by the outer share of the band; that of its
    // tilt turns the edge.
    let outer = 0.5 * f64::from(plan.band) * plan.steep;
    let by_level =
        (outer * interior.sigma / contrast * prior.correlation).powi(2) / f64::from(plan.beyond);
    edge.covariance[(0, 0)] += by_level / outside.rows;
    edge.covariance[(1, 1)] += by_level * outside.tilt_variance;
    edge.covariance[(0, 0)] += (plan.half_width * (step - TAIL).max(0.0)).powi(2);
    let by_shade = match prior.light {
        Light::Even => 0.0,
        Light::ByRow { .. } => BY_ROW * (edge.shade - SHADE).max(0.0),
        Light::ByPixel => BY_PIXEL * edge.shade,
    };
    edge.covariance[(0, 0)] += by_shade.powi(2);
    if sampler.saturated {
        edge.covariance[(0, 0)] += (SATURATED * crossings.blur).powi(2);
    }
    Some(Attempt { edge: Some(edge), step })
}

/// Where an edge crosses its rows.
struct Crossings {
    places: Places,
    /// Mean of ∫ c·(1 − c) across the edge, px.
    blur: f64,
    /// Mean level at the band's rim, in units of the contrast.
    step: f64,
    /// As in [`EdgeFit`].
    shade: f64,
}

impl Crossings {
    /// Sums up each row, scaled to 0 outside and 1 inside.
    ///
    /// `weights`: by how much more light on a pixel inside of the edge, and outside, moves it, px
    /// per unit of the light inside.
    fn find(
        rows: &Rows,
        plan: &RowPlan,
        interior: &Interior,
        outside: &Outside,
        weights: [f64; 2],
    ) -> Self {
        let (count, side) = (rows.count, &plan.side);
        // The level inside, and its shading relative to the crossing, which the outside shares.
        let at_middle = f32x8::splat(interior.at(side.middle.x, side.middle.y) as f32);
        let inside_tilt = f32x8::splat(interior.gradient.dot(&side.tangent) as f32);
        // Light that multiplies everything multiplies a signal of either sign.
        let level_here = interior.level.abs().max(0.3).copysign(interior.level);
        let shading = f32x8::splat((interior.gradient[plan.axis] / level_here) as f32);
        let (level, tilt) = (f32x8::splat(outside.level as f32), f32x8::splat(outside.tilt as f32));
        let steep = f32x8::splat(plan.steep as f32);
        let limit = f32x8::splat(plan.half_width as f32);
        let least = f32x8::splat(MIN_CONTRAST as f32);
        let gate = f32x8::splat(outside.gate);
        let rim_gate = f32x8::splat(outside.rim_gate);
        let (mut step, mut valid) = (f32x8::ZERO, f32x8::ZERO);
        let mut places = Places { count, along: rows.along, across: [0.0; MAX_ROWS] };
        let (mut good, mut blur) = ([0.0f32; MAX_ROWS], f32x8::ZERO);
        let mut all = f32x8::ZERO;
        let light_inside = f32x8::splat((interior.light as f32).max(1e-3));
        let inner_pixels = f32x8::splat(plan.inner_pixels());
        let weights = weights.map(|weight| f32x8::splat(weight as f32));
        let mut shades: Column = [0.0; MAX_ROWS];
        for group in (0..count).step_by(8) {
            let of = |column: &Column| eight(column, group);
            let (along, pixels, s) = (of(&rows.along), of(&rows.pixels), of(&rows.s));
            // Σ c with c = (s·(1 − shading·(j − crossing)) − outside)/difference, all rows alike.
            let outside_here = level + tilt * along;
            let difference = at_middle + inside_tilt * along - outside_here;
            let sum = s * (f32x8::ONE + shading * of(&rows.crossing))
                - shading * of(&rows.sj)
                - pixels * outside_here;
            let covered = sum / difference;
            let across = (covered - of(&rows.inner)) * steep;
            let rim = of(&rows.rim) - outside_here;
            let is_good = (of(&rows.outside) - outside_here).abs().simd_le(gate)
                & difference.simd_ge(least)
                & across.abs().simd_lt(limit)
                & across.simd_lt(of(&rows.room) - f32x8::splat(0.3))
                & present(group, count);
            // The light on the band's two halves, less what its two parts have at their outer
            // ends.
            let is_seen = difference.simd_ge(least) & present(group, count);
            let part = covered.fast_max(f32x8::ZERO).fast_min(pixels);
            let inner_pixels = inner_pixels.fast_min(pixels);
            let inner = part.fast_min(inner_pixels);
            let light_outside = of(&rows.light_outside);
            let excess = |light: f32x8, part: f32x8, pixels: f32x8| {
                light - part * light_inside - (pixels - part) * light_outside
            };
            let shade = weights[0] * excess(of(&rows.light_inner), inner, inner_pixels)
                + weights[1] * excess(of(&rows.light_outer), part - inner, pixels - inner_pixels);
            let here = is_seen & (shade / light_inside * steep);
            shades[group..group + 8].copy_from_slice(here.as_array());
            step += is_good & (rim / difference);
            valid += is_good & f32x8::ONE;
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
        let step = f64::from((step.reduce_add() / valid.reduce_add().max(1.0)).abs());
        let kept = all.reduce_add();
        let blur = f64::from(blur.reduce_add() / kept.max(1.0)).max(0.0);
        if kept < count as f32 {
            places.keep(&good);
        }
        // The noise of neighboring rows is nearly independent.
        let product: f32 = shades[..count].windows(2).map(|m| m[0] * m[1]).sum();
        let shade = f64::from(product.max(0.0) / (count - 1) as f32).sqrt();
        Self { places, blur, step, shade }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        edge::Tolerance,
        image::{Pixels, fixtures::drawn},
        quad::Quad,
        signal::Discriminant,
    };
    use nalgebra::{Matrix3, Vector2};
    use rig_model::Stamp;

    #[test]
    fn rows_that_leave_the_image_are_not_normalized_by_those_of_another_edge() {
        // Two squares; the second one ends 4 px before the image's right border.
        let squares = [[6, 20, 30, 44], [36, 20, 60, 44]].map(|square| (square, [200, 40, 40]));
        let image = drawn(64, 64, 120, &squares);
        let image = Pixels::whole(image.view(Stamp::default()), None);
        let discriminant =
            Discriminant::between([200.0, 40.0, 40.0], [120.0; 3], &Matrix3::zeros()).unwrap();
        let sampler = Sampler::new(&image, &discriminant);
        let tolerance =
            Tolerance { edge: 1.0, slope: 0.06, rows: MAX_ROWS, ..Tolerance::default() };
        let mut scratch = Rows::new();
        let mut right_edge = |left: f64, light: Light| {
            let (right, top, bottom) = (left + 24.0, 19.5, 43.5);
            let corners = [(left, top), (right, top), (right, bottom), (left, bottom)];
            let quad = Quad(corners.map(|(x, y)| Vector2::new(x, y)));
            let interior = Interior::measure(&sampler, &quad, 4.5, false, None).unwrap();
            let interior = if light == Light::Even { interior } else { interior.relit() };
            let (correlation, inflation) = (1.0, 1.0);
            let prior =
                ShapePrior { tolerance, correlation, inflation, light, ..ShapePrior::default() };
            let side = Side::of(&quad, quad.area_and_centroid().1)[1];
            fit_edge(&sampler, &interior, &side, 4.5, &prior, &mut scratch)
        };
        let by_row = Light::ByRow { brightness: 360.0 / 280.0 };
        assert!(right_edge(5.5, by_row).is_some() && right_edge(35.5, Light::Even).is_some());
        assert!(right_edge(5.5, by_row).is_some() && right_edge(35.5, by_row).is_none());
    }
}
