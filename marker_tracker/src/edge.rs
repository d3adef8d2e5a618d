//! One straight edge of a square, fitted below the pixel.

use crate::{
    interior::Interior,
    outline::ShapePrior,
    quad::Quad,
    signal::{Sampler, nearest},
};
use nalgebra::{Matrix2, Vector2};

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

/// What was read along the rows, quantity by quantity: the sums over the band across the edge, and the level beyond it.
struct Rows {
    count: usize,
    /// Place along the edge, px from its middle.
    along: [f32; MAX_ROWS],
    /// Where the predicted edge crosses the row, and where the band's inner end is seen from there, px.
    crossing: [f32; MAX_ROWS],
    inner: [f32; MAX_ROWS],
    /// Pixels of the band, Σ s, Σ s·j, and Σ s² where it was taken, else 0.
    pixels: [f32; MAX_ROWS],
    s: [f32; MAX_ROWS],
    sj: [f32; MAX_ROWS],
    ss: [f32; MAX_ROWS],
    outside: [f32; MAX_ROWS],
    /// How far outside of the prediction the band reaches, across the edge, px.
    room: [f32; MAX_ROWS],
}

/// Where an edge lies on a row: how far along, and how far outside of the prediction, px.
#[derive(Clone, Copy, Default)]
struct Place {
    along: f32,
    across: f32,
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
    let slope_axis = tangent[k] * per_row;
    // The image's last column or row.
    let end = if k == 0 { sampler.width } else { sampler.height } - 1;
    // While it is sought a place that is a little off will do; once it is known the whole band must be in the image.
    let (least_room, least_beyond) =
        if prior.edge_sigma >= 1.0 { (half.min(1.0), 1) } else { (f64::INFINITY, beyond) };
    let zero = [0f32; MAX_ROWS];
    let mut rows = Rows {
        count: 0,
        along: zero,
        crossing: zero,
        inner: zero,
        pixels: zero,
        s: zero,
        sj: zero,
        ss: zero,
        outside: zero,
        room: zero,
    };
    for i in 0..possible {
        let line = first + if possible == usable { i } else { (i * usable + usable / 2) / possible };
        let off = f64::from(line) - middle[1 - k];
        let crossing = middle[k] + off * slope_axis;
        let (mut from, mut to) = (nearest(crossing - half), nearest(crossing + half));
        // At the image's edge as much as there is, as long as the marker's own edge is in it.
        let mut room = f64::INFINITY;
        let beyond = if sign > 0.0 {
            if to > end - 1 {
                to = end - 1;
                room = f64::from(to) - crossing;
            }
            beyond.min(end - to)
        } else {
            if from < 1 {
                from = 1;
                room = crossing - f64::from(from);
            }
            beyond.min(from)
        };
        let band = to - from + 1;
        if !(2..=MAX_BAND).contains(&band) || room < least_room || beyond < least_beyond {
            continue;
        }
        let start = if sign > 0.0 { from } else { from - beyond };
        let (x, y) = if k == 0 { (start, line) } else { (line, start) };
        let Some((bytes, hop)) = sampler.line(x, y, k, band + beyond, 1) else { continue };
        let (inner, outer) = if sign > 0.0 {
            bytes.split_at(band as usize * hop)
        } else {
            let (outer, inner) = bytes.split_at(beyond as usize * hop);
            (inner, outer)
        };
        let sums = sampler.line_sums(inner, hop);
        let outside = sampler.line_sum(outer, hop);
        let n = rows.count;
        rows.along[n] = (off * per_row) as f32;
        let crossing = (crossing - f64::from(from)) as f32;
        rows.crossing[n] = crossing;
        rows.inner[n] = if sign > 0.0 { crossing + 0.5 } else { band as f32 - crossing - 0.5 };
        rows.pixels[n] = band as f32;
        rows.s[n] = sums.s as f32 * sampler.scale;
        rows.sj[n] = sums.sj as f32 * sampler.scale;
        // The blur is the same all along.
        if n % 3 == 1 {
            rows.ss[n] = sampler.line_squares(inner, hop) * (sampler.scale * sampler.scale);
        }
        rows.outside[n] = outside as f32 * (sampler.scale / beyond as f32);
        rows.room[n] = room as f32 * steep as f32;
        rows.count = n + 1;
    }
    let count = rows.count;
    if count < 3 || count * 4 < possible as usize {
        return None;
    }
    let outside = Outside::measure(&rows.along[..count], &rows.outside[..count], interior, min_contrast)?;
    let (level, tilt) = (outside.level as f32, outside.tilt as f32);
    // Inside, and the shading relative to the crossing, which the outside shares.
    let at_middle = interior.at(middle.x, middle.y) as f32;
    let inside_tilt = interior.gradient.dot(&tangent) as f32;
    let shading = (interior.gradient[k] / interior.level.abs().max(0.3)) as f32;
    let steep = steep as f32;
    // Σ c with c = (s·(1 − shading·(j − crossing)) − outside)/difference, all rows alike.
    let (mut across, mut difference) = ([0f32; MAX_ROWS], [0f32; MAX_ROWS]);
    for i in 0..count.next_multiple_of(8).min(MAX_ROWS) {
        let outside_here = level + tilt * rows.along[i];
        difference[i] = at_middle + inside_tilt * rows.along[i] - outside_here;
        let sum = rows.s[i] * (1.0 + shading * rows.crossing[i])
            - shading * rows.sj[i]
            - rows.pixels[i] * outside_here;
        across[i] = (sum / difference[i] - rows.inner[i]) * steep;
    }
    let mut places = [Place::default(); MAX_ROWS];
    let (mut kept, mut blur, mut blurred) = (0usize, 0f32, 0u32);
    let (limit, least) = (half_width as f32, min_contrast as f32);
    for i in 0..count {
        let outside_here = level + tilt * rows.along[i];
        let good = (rows.outside[i] - outside_here).abs() <= outside.gate
            && difference[i] >= least
            && across[i].abs() < limit
            && across[i] < rows.room[i] - 0.3;
        if !good {
            continue;
        }
        places[kept] = Place { along: rows.along[i], across: across[i] };
        kept += 1;
        if rows.ss[i] > 0.0 {
            // Σ c − Σ c², without the shading.
            let scale = 1.0 / difference[i];
            let sum = across[i] / steep + rows.inner[i];
            let square = rows.ss[i] - outside_here * (2.0 * rows.s[i] - rows.pixels[i] * outside_here);
            blur += (sum - scale * scale * square) * steep;
            blurred += 1;
        }
    }
    let mut edge = line_through(&places[..kept], possible as usize, length, prior)?;
    edge.blur = f64::from(blur / blurred.max(1) as f32).max(0.0);
    // What the outside level is uncertain by moves the whole edge: by the half-width's share of it.
    let pixels = outside.rows * f64::from(beyond);
    let contrast = (interior.level - outside.level).max(min_contrast);
    edge.covariance[(0, 0)] +=
        (half_width * interior.sigma / contrast).powi(2) * prior.correlation * prior.correlation / pixels;
    Some((edge, outside.level))
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
    fn measure(along: &[f32], outside: &[f32], interior: &Interior, min_contrast: f64) -> Option<Self> {
        // The median; where all agree the mean is as good.
        let mean = outside.iter().sum::<f32>() / outside.len() as f32;
        let median = if outside.iter().all(|o| (o - mean).abs() < 0.05) {
            mean
        } else {
            let mut levels = [0f32; MAX_ROWS];
            let levels = &mut levels[..outside.len()];
            levels.copy_from_slice(outside);
            levels.sort_unstable_by(f32::total_cmp);
            levels[outside.len() / 2]
        };
        let contrast = interior.level - f64::from(median);
        if contrast.is_nan() || contrast <= min_contrast {
            return None;
        }
        let gate = ((4.0 * interior.sigma).clamp(0.06, 0.2) * contrast.max(0.3)) as f32;
        let (mut n, mut st, mut stt, mut so, mut sto) = (0f32, 0f32, 0f32, 0f32, 0f32);
        for (&along, &outside) in along.iter().zip(outside) {
            let off = outside - median;
            let member = if off.abs() < gate { 1.0 } else { 0.0 };
            let (off, along) = (off * member, along * member);
            n += member;
            st += along;
            stt += along * along;
            so += off;
            sto += along * off;
        }
        if n < 3.0 {
            return None;
        }
        let [n, st, stt, so, sto] = [n, st, stt, so, sto].map(f64::from);
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

/// Robust straight line through the rows' offsets.
///
/// What covers an edge shows as rows whose crossing lies further in, never further out, so of several places that rows
/// agree on the outermost is the edge. Rows beside ones that disagree are half covered and left out with them.
fn line_through(rows: &[Place], possible: usize, length: f64, prior: &ShapePrior) -> Option<EdgeFit> {
    if rows.len() < 3 {
        return None;
    }
    let lean = 2.0 * prior.slope_sigma * length / 2.0;
    let mean = rows.iter().map(|r| r.across).sum::<f32>() / rows.len() as f32;
    let (mut offset, mut slope, reach);
    if rows.iter().all(|r| (r.across - mean).abs() < 0.3) {
        // Nothing disagrees.
        (offset, slope, reach) = (mean, 0f32, 0.3 + lean);
    } else {
        let mut sorted = [0f32; MAX_ROWS];
        for (s, r) in sorted.iter_mut().zip(rows.iter()) {
            *s = r.across;
        }
        let sorted = &mut sorted[..rows.len()];
        sorted.sort_unstable_by(f32::total_cmp);
        let spread = f64::from(sorted[rows.len() * 3 / 4] - sorted[rows.len() / 4]) / 1.35;
        // The fullest place within ± reach, and the outermost that is half as full.
        reach = (2.0 * spread).clamp(0.2, 0.4) + lean;
        let near = reach as f32;
        let fullness = |at: usize| {
            let from = sorted.partition_point(|&v| v < sorted[at] - near);
            let to = sorted.partition_point(|&v| v <= sorted[at] + near);
            (from, to)
        };
        let most = (0..rows.len()).map(&fullness).map(|(a, b)| b - a).max()?;
        let enough = most.max(8.min(rows.len()));
        let (from, to) = (0..rows.len()).rev().map(&fullness).find(|(a, b)| 2 * (b - a) >= enough)?;
        (offset, slope) = (sorted[(from + to) / 2], 0.0);
    }
    let mut gate = reach as f32;
    let mut used = [false; MAX_ROWS];
    // Rows far apart are no neighbours.
    let neighbours = possible < prior.rows;
    let mut before = usize::MAX;
    let mut result = None;
    for round in 0..3 {
        let agrees = |r: &Place| (r.across - offset - slope * r.along).abs() < gate;
        let mut count = 0usize;
        for i in 0..rows.len() {
            let member = agrees(&rows[i])
                && (round == 0
                    || !neighbours
                    || ((i == 0 || agrees(&rows[i - 1])) && (i + 1 == rows.len() || agrees(&rows[i + 1]))));
            used[i] = member;
            count += usize::from(member);
        }
        if count < 3 {
            return None;
        }
        if count == rows.len() && count == before {
            // Every row again: nothing changes any more.
            break;
        }
        before = count;
        let (mut st, mut stt, mut sa, mut sta) = (0f32, 0f32, 0f32, 0f32);
        for (r, _) in rows.iter().zip(&used).filter(|(_, used)| **used) {
            st += r.along;
            stt += r.along * r.along;
            sa += r.across;
            sta += r.along * r.across;
        }
        let [st, stt, sa, sta] = [st, stt, sa, sta].map(f64::from);
        let n = count as f64;
        // The direction is known to slope_sigma beforehand; what the rows weigh against it is their usual noise.
        let stt = stt + 0.01 / (prior.slope_sigma * prior.slope_sigma);
        let det = n * stt - st * st;
        if det.is_nan() || det <= 0.0 {
            return None;
        }
        let inverse = Matrix2::new(stt, -st, -st, n) / det;
        let solution = inverse * Vector2::new(sa, sta);
        (offset, slope) = (solution.x as f32, solution.y as f32);
        let (mut square, mut product, mut last) = (0f32, 0f32, 0f32);
        for (r, used) in rows.iter().zip(&used) {
            let residual = if *used { r.across - offset - slope * r.along } else { 0.0 };
            square += residual * residual;
            product += residual * last;
            last = residual;
        }
        let variance = (f64::from(square) / (n - 2.0).max(1.0)).max(4e-4);
        gate = ((3.2 * variance.sqrt()) as f32).clamp(0.15, gate);
        let support = n / possible.max(1) as f64;
        let mut covariance = inverse * (variance * prior.inflation);
        // Rows that a cover's blur touches a little stay unnoticed: the more is covered the more there are.
        covariance[(0, 0)] += (0.2 * (1.0 - support)).powi(2);
        result = Some(EdgeFit {
            offset: solution.x,
            slope: solution.y,
            covariance,
            support,
            blur: 0.0,
            lag: [f64::from(square), f64::from(product)],
        });
    }
    result.filter(|e| e.support > 0.2)
}
