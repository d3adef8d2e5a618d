//! The square's outline: four straight edges, each fitted below the pixel, and the area centroid that they enclose.
//!
//! In flow the colour signal of a window ([`Window`]) and the predicted outline; out flow the measured outline, its
//! centroid and the centroid's covariance. The image of a square through a lens of ordinary distortion bends by a few
//! hundredths of a pixel; the straight line fitted by least squares encloses the same area, and so the same centroid to
//! first order.

use crate::signal::{Window, nearest};
use nalgebra::{Matrix2, Matrix3, SMatrix, SVector, Vector2, Vector3};

/// Four corners in order around the square, px.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Quad(pub [Vector2<f64>; 4]);

impl Quad {
    pub fn shifted(&self, by: Vector2<f64>) -> Self {
        Self(self.0.map(|c| c + by))
    }

    /// Signed area and area centroid of the polygon.
    pub fn area_and_centroid(&self) -> (f64, Vector2<f64>) {
        let origin = self.0[0];
        let (mut area, mut moment) = (0.0, Vector2::zeros());
        for i in 0..4 {
            let (a, b) = (self.0[i] - origin, self.0[(i + 1) % 4] - origin);
            let cross = a.x * b.y - a.y * b.x;
            area += cross;
            moment += (a + b) * cross;
        }
        if area.abs() < 1e-9 {
            return (0.0, self.0.iter().sum::<Vector2<f64>>() / 4.0);
        }
        (area / 2.0, origin + moment / (3.0 * area))
    }

    /// Larger on all sides, by `margin` px about.
    pub fn grown(&self, margin: f64) -> Self {
        let (_, centre) = self.area_and_centroid();
        let scale = 1.0 + 2.0 * margin / self.thickness().max(4.0);
        Self(self.0.map(|c| centre + (c - centre) * scale))
    }

    /// x0, y0, x1, y1 with a margin, whole pixels, the upper ones excluded.
    pub fn bounds(&self, margin: f64) -> [i32; 4] {
        let min = self.0.iter().fold(Vector2::repeat(f64::INFINITY), |m, c| m.inf(c));
        let max = self.0.iter().fold(Vector2::repeat(f64::NEG_INFINITY), |m, c| m.sup(c));
        [
            (min.x - margin).floor() as i32,
            (min.y - margin).floor() as i32,
            (max.x + margin).ceil() as i32 + 1,
            (max.y + margin).ceil() as i32 + 1,
        ]
    }

    /// Distances between the middles of opposite edges, across them, px.
    pub fn widths(&self) -> [f64; 2] {
        [0, 1].map(|i| {
            let middle = |k: usize| (self.0[k % 4] + self.0[(k + 1) % 4]) / 2.0;
            let (a, b) = (middle(i), middle(i + 2));
            let edge = (self.0[(i + 1) % 4] - self.0[i]) - (self.0[(i + 3) % 4] - self.0[(i + 2) % 4]);
            let length = edge.norm().max(1e-9);
            ((b - a).x * edge.y - (b - a).y * edge.x).abs() / length
        })
    }

    /// Whole columns inside on a row, from (included) to (excluded); `None` where there is none.
    pub fn span(&self, y: f64) -> Option<(i32, i32)> {
        let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
        for i in 0..4 {
            let (p, q) = (self.0[i], self.0[(i + 1) % 4]);
            if (p.y <= y) != (q.y <= y) {
                let x = p.x + (y - p.y) * (q.x - p.x) / (q.y - p.y);
                from = from.min(x);
                to = to.max(x);
            }
        }
        let (from, to) = (nearest(from + 0.5), nearest(to - 0.5) + 1);
        (from < to && from > -(1 << 19) && to < 1 << 19).then_some((from, to))
    }

    /// Smallest distance between opposite sides' middles, px: what is there to measure a level in.
    pub fn thickness(&self) -> f64 {
        let (area, _) = self.area_and_centroid();
        let longest = (0..4).map(|i| (self.0[(i + 1) % 4] - self.0[i]).norm()).fold(0.0, f64::max);
        if longest > 0.0 { area.abs() / longest } else { 0.0 }
    }
}

/// How the outline was measured.
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

/// The outline, measured.
#[derive(Clone, Copy, Debug)]
pub(crate) struct QuadFit {
    pub quad: Quad,
    pub centroid: Vector2<f64>,
    pub covariance: Matrix2<f64>,
    pub area: f64,
    /// Per edge; `None` where it was not seen.
    pub edges: [Option<EdgeFit>; 4],
    /// Change of the interior's level over the square, in units of the contrast.
    pub unevenness: f64,
    /// Signal inside and outside at the square's middle.
    pub inside: f64,
    pub outside: f64,
    /// Share of the interior samples that have the marker's level.
    pub filled: f64,
    /// The variance inflation that is in the covariance.
    pub inflation: f64,
}

/// What is known of the outline beforehand, beside its predicted place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ShapePrior {
    /// By how much the marker's edges lie further out than the geometry says, px (paper cut too large, blooming).
    pub edge_bias: f64,
    /// Standard deviation of one edge's distance from the predicted shape, px.
    pub edge_sigma: f64,
    /// Standard deviation of the predicted place, px; only to tell which of two contradicting edges is right.
    pub place_sigma: f64,
    /// Standard deviation of one edge's direction, rad.
    pub slope_sigma: f64,
    /// Variance of a mean of neighbouring pixels of a row over that of as many independent ones.
    pub correlation: f64,
    /// Variance inflation of an edge by all that its rows cannot tell.
    pub inflation: f64,
    /// Half-width across the edge that is integrated, px.
    pub half_width: f64,
    /// Most rows of an edge that are used.
    pub rows: usize,
}

/// Pixels along an edge that a corner's blur spoils.
const CORNER: f64 = 2.0;
/// Width of the band in which the level outside is measured, in parts of the square's, from 1 to 3 px.
const OUTSIDE: f64 = 0.1;
/// Over how many rows the residuals' correlation is measured, and the residuals themselves as lag 0.
pub(crate) const LAGS: usize = 2;
/// Most rows of one edge that are used; longer edges are sampled evenly.
const MAX_ROWS: usize = 96;

#[derive(Clone, Copy, Default)]
struct Row {
    along: f64,
    across: f64,
    outside: f64,
}

/// Signal level of the interior: a plane, robustly.
struct Interior {
    centre: Vector2<f64>,
    level: f64,
    gradient: Vector2<f64>,
    filled: f64,
    sigma: f64,
    /// Variance, in units of a pixel's, of the gradient times half the side.
    reach: f64,
}

impl Interior {
    fn at(&self, x: f64, y: f64) -> f64 {
        self.level + self.gradient.x * (x - self.centre.x) + self.gradient.y * (y - self.centre.y)
    }

    fn measure(window: &Window, quad: &Quad, half_width: f64, lines: usize) -> Option<Self> {
        const N: usize = 7;
        let (_, centre) = quad.area_and_centroid();
        // Samples on a grid that stays half_width away from the edges.
        let side = quad.thickness();
        let shrink = ((side - 2.0 * half_width) / side).clamp(0.25, 0.9);
        let mut samples = [0f32; N * N];
        let mut count = 0;
        for i in 0..N {
            for j in 0..N {
                let (u, v) = (i as f64 / (N - 1) as f64, j as f64 / (N - 1) as f64);
                let p = quad.0[0] * (1.0 - u) * (1.0 - v)
                    + quad.0[1] * u * (1.0 - v)
                    + quad.0[2] * u * v
                    + quad.0[3] * (1.0 - u) * v;
                let p = centre + (p - centre) * shrink;
                if let Some(value) = window.at(nearest(p.x), nearest(p.y)) {
                    samples[count] = value;
                    count += 1;
                }
            }
        }
        if count < N * N / 2 {
            return None;
        }
        let samples = &mut samples[..count];
        samples.sort_unstable_by(f32::total_cmp);
        let median = samples[count / 2];
        // The middle half tells the noise, whatever crosses the square.
        let spread = f64::from(samples[count * 3 / 4] - samples[count / 4]) / 1.35;
        let gate = (4.0 * spread).clamp(0.08, 0.3) as f32;

        // The plane through every pixel of the shrunken square that agrees.
        let shrunken = Quad(quad.0.map(|c| centre + (c - centre) * shrink));
        let [_, top, _, bottom] = shrunken.bounds(0.0);
        let (cx, cy) = (nearest(centre.x), nearest(centre.y));
        let (mut n, mut all) = (0f64, 0f64);
        let (mut sx, mut sy, mut sxx, mut sxy, mut syy) = (0f64, 0f64, 0f64, 0f64, 0f64);
        let (mut ss, mut sxs, mut sys, mut square) = (0f64, 0f64, 0f64, 0f64);
        let rows = (bottom - top).max(1);
        let stride = (rows / lines.min(48) as i32).max(1);
        for y in (top..bottom).step_by(stride as usize) {
            let Some((from, to)) = shrunken.span(f64::from(y)) else { continue };
            let Some(row) = window.row(y, from, to) else { continue };
            let [rn, rx, rxx, rs, rxs, rss] = row_sums(row, (from - cx) as f32, median, gate);
            let dy = f64::from(y - cy);
            all += row.len() as f64;
            n += f64::from(rn);
            sx += f64::from(rx);
            sy += dy * f64::from(rn);
            sxx += f64::from(rxx);
            sxy += dy * f64::from(rx);
            syy += dy * dy * f64::from(rn);
            ss += f64::from(rs);
            sxs += f64::from(rxs);
            sys += dy * f64::from(rs);
            square += f64::from(rss);
        }
        if n < 8.0 {
            return None;
        }
        // A weak pull to a flat level keeps small squares stable.
        let weak = 10.0 * n.min(20.0);
        let normal = Matrix3::new(n, sx, sy, sx, sxx + weak, sxy, sy, sxy, syy + weak);
        let right = Vector3::new(ss, sxs, sys);
        let solution = normal.cholesky()?.solve(&right);
        let variance = ((square - solution.dot(&right)) / (n - 3.0)).max(1e-8);
        Some(Self {
            centre: Vector2::new(f64::from(cx), f64::from(cy)),
            level: f64::from(median) + solution.x,
            gradient: Vector2::new(solution.y, solution.z),
            filled: n / all.max(1.0),
            sigma: variance.sqrt(),
            // Of a level at an edge's middle that the gradient carries there, both ends alike.
            reach: 3.0 / (n * shrink * shrink),
        })
    }
}

/// Σ m, Σ m·x, Σ m·x², Σ m·d, Σ m·x·d, Σ m·d² of a row's pixels, where d is the value less `middle`, m is 1 where |d| is below
/// `gate` and 0 elsewhere, and x counts from `x`. Eight pixels at a time.
fn row_sums(row: &[f32], x: f32, middle: f32, gate: f32) -> [f32; 6] {
    const LANES: usize = 8;
    let mut sums = [[0f32; LANES]; 6];
    let mut places: [f32; LANES] = std::array::from_fn(|i| x + i as f32);
    let mut add = |values: &[f32; LANES], places: &[f32; LANES]| {
        for i in 0..LANES {
            let d = values[i] - middle;
            // A NaN (not looked at) is no member.
            let m = if d.abs() < gate { 1.0f32 } else { 0.0 };
            let d = if d.abs() < gate { d } else { 0.0 };
            let mx = m * places[i];
            sums[0][i] += m;
            sums[1][i] += mx;
            sums[2][i] += mx * places[i];
            sums[3][i] += d;
            sums[4][i] += d * places[i];
            sums[5][i] += d * d;
        }
    };
    let chunks = row.chunks_exact(LANES);
    let rest = chunks.remainder();
    for chunk in chunks {
        let mut values = [0f32; LANES];
        values.copy_from_slice(chunk);
        add(&values, &places);
        for p in &mut places {
            *p += LANES as f32;
        }
    }
    let mut values = [f32::NAN; LANES];
    values[..rest.len()].copy_from_slice(rest);
    add(&values, &places);
    sums.map(|lane| lane.iter().sum())
}

/// Measures the outline near `predicted`.
///
/// Each edge is crossed by the rows (or columns, whichever crosses it more steeply) of the image. Along a row the signal,
/// scaled to 0 outside and 1 inside, is summed up: that is the place of the edge, exactly, for any symmetric blur and
/// without interpolation. The inside level is a plane over the interior and the outside level a line along the edge,
/// carried on with the interior's relative shading. Rows that a crossing thing spoils are left out. An edge that is not
/// seen is put where the shape prior has it relative to the others, and the covariance says so.
///
/// `None` where fewer than two adjacent edges were seen or the contrast is gone.
pub(crate) fn fit(
    window: &Window,
    predicted: &Quad,
    prior: &ShapePrior,
    min_contrast: f64,
) -> Option<QuadFit> {
    let (signed_area, centre) = predicted.area_and_centroid();
    if signed_area.abs() < 9.0 {
        return None;
    }
    let half_width = prior.half_width.min(predicted.thickness() * 0.25).max(1.0);
    let interior = Interior::measure(window, predicted, half_width, prior.rows)?;
    let mut edges: [Option<EdgeFit>; 4] = [None; 4];
    let mut outside_levels = [0.0; 4];
    for i in 0..4 {
        let (p, q) = (predicted.0[i], predicted.0[(i + 1) % 4]);
        if let Some((edge, outside)) =
            fit_edge(window, &interior, p, q, centre, half_width, prior, min_contrast)
        {
            edges[i] = Some(edge);
            outside_levels[i] = outside;
        }
    }
    combine(predicted, edges, prior, &interior, outside_levels)
}

#[allow(clippy::too_many_arguments)]
fn fit_edge(
    window: &Window,
    interior: &Interior,
    p: Vector2<f64>,
    q: Vector2<f64>,
    centre: Vector2<f64>,
    half_width: f64,
    prior: &ShapePrior,
    min_contrast: f64,
) -> Option<(EdgeFit, f64)> {
    let length = (q - p).norm();
    if length < 4.0 {
        return None;
    }
    let tangent = (q - p) / length;
    let middle = (p + q) / 2.0;
    let mut normal = Vector2::new(tangent.y, -tangent.x);
    let centre_distance = normal.dot(&(middle - centre)).abs();
    if normal.dot(&(middle - centre)) < 0.0 {
        normal = -normal;
    }
    // Along which axis the edge is crossed: k = 0 walks along x on rows, k = 1 along y on columns.
    let k = usize::from(normal.x.abs() < normal.y.abs());
    let (steep, sign) = (normal[k].abs(), normal[k].signum());
    // What surrounds a marker ends where the platform does, and small squares have it close by.
    let width = centre_distance * 2.0;
    let half_width = half_width.min(0.2 * width).max(1.0);
    let half = half_width / steep;
    let (from, to) = (p[1 - k].min(q[1 - k]), p[1 - k].max(q[1 - k]));
    // Walking inward shifts the place along the edge, and must not run over the neighbouring edge.
    let inward = -sign * half * tangent[k];
    let corner = CORNER.min(0.15 * length + 0.5);
    let (low, high) = (-length / 2.0 + corner + (-inward).max(0.0), length / 2.0 - corner - inward.max(0.0));
    let first = nearest(from + 0.5);
    let last = nearest(to - 0.5);
    let usable = ((last - first + 1).max(0)) as usize;
    let stride = usable.div_ceil(prior.rows.clamp(8, MAX_ROWS)).max(1);
    let outside_count = ((OUTSIDE * width).clamp(1.0, 3.0) / steep).ceil() as i32;
    let mut rows = [Row::default(); MAX_ROWS];
    let (mut count, mut possible) = (0usize, 0usize);
    let step = sign as i32;
    let at = |along_axis: i32, line: i32| {
        if k == 0 { window.at(along_axis, line) } else { window.at(line, along_axis) }
    };
    let slope_axis = (q[k] - p[k]) / (q[1 - k] - p[1 - k]);
    for line in (first..=last).step_by(stride) {
        let crossing = p[k] + (f64::from(line) - p[1 - k]) * slope_axis;
        let point = if k == 0 {
            Vector2::new(crossing, f64::from(line))
        } else {
            Vector2::new(f64::from(line), crossing)
        };
        let along = (point - middle).dot(&tangent);
        if along < low || along > high {
            continue;
        }
        possible += 1;
        let end = nearest(crossing + sign * half);
        // Outside level first.
        let mut outside = 0.0;
        let mut seen = 0;
        for j in 1..=outside_count {
            if let Some(v) = at(end + step * j, line) {
                outside += f64::from(v);
                seen += 1;
            }
        }
        if seen < outside_count {
            continue;
        }
        outside /= f64::from(seen);
        if count < MAX_ROWS {
            // Until the outside level is known along the edge, `across` holds where the row's sum starts.
            rows[count] = Row { along, across: f64::from(line), outside };
            count += 1;
        }
    }
    if count < 3 || count * 4 < possible {
        return None;
    }
    let rows = &mut rows[..count];
    // Outside level along the edge: median, then a line through what agrees. Where all agree the mean is as good.
    let mean = rows.iter().map(|r| r.outside).sum::<f64>() / count as f64;
    let outside_median = if rows.iter().all(|r| (r.outside - mean).abs() < 0.05) {
        mean
    } else {
        let mut levels = [0f64; MAX_ROWS];
        for (l, r) in levels.iter_mut().zip(rows.iter()) {
            *l = r.outside;
        }
        levels[..count].sort_unstable_by(f64::total_cmp);
        levels[count / 2]
    };
    let contrast = interior.level - outside_median;
    if contrast.is_nan() || contrast <= min_contrast {
        return None;
    }
    let gate = (4.0 * interior.sigma).clamp(0.06, 0.2) * contrast.max(0.3);
    let (mut n, mut st, mut stt, mut so, mut sto) = (0f64, 0.0, 0.0, 0.0, 0.0);
    for r in rows.iter().filter(|r| (r.outside - outside_median).abs() < gate) {
        n += 1.0;
        st += r.along;
        stt += r.along * r.along;
        so += r.outside - outside_median;
        sto += r.along * (r.outside - outside_median);
    }
    if n < 3.0 {
        return None;
    }
    // A weak pull to a constant level: the outer rows must not lever it.
    let det = (stt + 2.0 * n * n) * n - st * st;
    let (level, tilt) =
        (outside_median + ((stt + 2.0 * n * n) * so - st * sto) / det, (n * sto - st * so) / det);
    // Sum the scaled signal along each row.
    let (mut kept, mut blur) = (0usize, 0.0);
    for index in 0..count {
        let r = rows[index];
        let outside_here = level + tilt * r.along;
        if (r.outside - outside_here).abs() > gate {
            continue;
        }
        let line = r.across as i32;
        let crossing = p[k] + (r.across - p[1 - k]) * slope_axis;
        let start = nearest(crossing - sign * half);
        let end = nearest(crossing + sign * half);
        let (x, y) = if k == 0 { (crossing, r.across) } else { (r.across, crossing) };
        let inside_here = interior.at(x, y);
        let difference = inside_here - outside_here;
        if difference < min_contrast {
            continue;
        }
        // Shading relative to the crossing; the outside shares it.
        let shading = interior.gradient[k] / interior.level.abs().max(0.3);
        let (low_end, high_end) = (start.min(end), start.max(end));
        let (first_at, last_at) =
            if k == 0 { ((low_end, line), (high_end, line)) } else { ((line, low_end), (line, high_end)) };
        let Some((values, stride)) = window.between(first_at, last_at) else { continue };
        let scale = 1.0 / difference;
        // 1/(1 + shading·distance), to first order.
        let mut local = 1.0 - shading * (f64::from(low_end) - crossing);
        let (mut sum, mut mixed) = (0.0, 0.0);
        for v in values.iter().step_by(stride) {
            let c = (f64::from(*v) * local - outside_here) * scale;
            local -= shading;
            sum += c;
            mixed += c * (1.0 - c);
        }
        let edge = f64::from(start) - 0.5 * sign + sign * sum;
        let across = (edge - crossing) * sign * steep;
        if across.abs() < half_width {
            rows[kept] = Row { along: r.along, across, outside: r.outside };
            kept += 1;
            blur += mixed * steep;
        }
    }
    let rows = &rows[..kept];
    let mut edge = line_through(rows, possible, length, prior)?;
    edge.blur = (blur / rows.len().max(1) as f64).max(0.0);
    // What the outside level is uncertain by moves the whole edge: by the half-width's share of it.
    let pixels = n * f64::from(outside_count);
    let contrast = (interior.level - level).max(min_contrast);
    edge.covariance[(0, 0)] +=
        (half_width * interior.sigma / contrast).powi(2) * prior.correlation * prior.correlation / pixels;
    Some((edge, level))
}

/// Robust straight line through the rows' offsets.
///
/// What covers an edge shows as rows whose crossing lies further in, never further out, so of several places that rows
/// agree on the outermost is the edge. Rows beside ones that disagree are half covered and left out with them.
fn line_through(rows: &[Row], possible: usize, length: f64, prior: &ShapePrior) -> Option<EdgeFit> {
    if rows.len() < 3 {
        return None;
    }
    let lean = 2.0 * prior.slope_sigma * length / 2.0;
    let mean = rows.iter().map(|r| r.across).sum::<f64>() / rows.len() as f64;
    let (mut offset, mut slope, reach);
    if rows.iter().all(|r| (r.across - mean).abs() < 0.3) {
        // Nothing disagrees.
        (offset, slope, reach) = (mean, 0.0, 0.3 + lean);
    } else {
        let mut sorted = [0f64; MAX_ROWS];
        for (s, r) in sorted.iter_mut().zip(rows.iter()) {
            *s = r.across;
        }
        let sorted = &mut sorted[..rows.len()];
        sorted.sort_unstable_by(f64::total_cmp);
        let spread = (sorted[rows.len() * 3 / 4] - sorted[rows.len() / 4]) / 1.35;
        // The fullest place within ± reach, and the outermost that is half as full.
        reach = (2.0 * spread).clamp(0.2, 0.4) + lean;
        let fullness = |at: usize| {
            let from = sorted.partition_point(|&v| v < sorted[at] - reach);
            let to = sorted.partition_point(|&v| v <= sorted[at] + reach);
            (from, to)
        };
        let most = (0..rows.len()).map(&fullness).map(|(a, b)| b - a).max()?;
        let enough = most.max(8.min(rows.len()));
        let (from, to) = (0..rows.len()).rev().map(&fullness).find(|(a, b)| 2 * (b - a) >= enough)?;
        (offset, slope) = (sorted[(from + to) / 2], 0.0);
    }
    let mut gate = reach;
    let mut result = None;
    for round in 0..3 {
        let agrees = |r: &Row| (r.across - offset - slope * r.along).abs() < gate;
        // Rows far apart are no neighbours.
        let used = |i: usize| {
            agrees(&rows[i])
                && (round == 0
                    || prior.rows < 48
                    || ((i == 0 || agrees(&rows[i - 1])) && (i + 1 == rows.len() || agrees(&rows[i + 1]))))
        };
        let (mut n, mut st, mut stt, mut sa, mut sta) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for (_, r) in rows.iter().enumerate().filter(|(i, _)| used(*i)) {
            n += 1.0;
            st += r.along;
            stt += r.along * r.along;
            sa += r.across;
            sta += r.along * r.across;
        }
        if n < 3.0 {
            return None;
        }
        // The direction is known to slope_sigma beforehand; what the rows weigh against it is their usual noise.
        let pull = 0.01 / (prior.slope_sigma * prior.slope_sigma);
        let inverse = Matrix2::new(n, st, st, stt + pull).try_inverse()?;
        let solution = inverse * Vector2::new(sa, sta);
        let (mut lag, mut count) = ([0.0; LAGS], 0usize);
        let mut recent = [0.0; LAGS];
        for (i, r) in rows.iter().enumerate() {
            recent.copy_within(..LAGS - 1, 1);
            recent[0] = 0.0;
            if used(i) {
                recent[0] = r.across - solution.x - solution.y * r.along;
                count += 1;
                for (sum, earlier) in lag.iter_mut().zip(&recent) {
                    *sum += recent[0] * earlier;
                }
            }
        }
        let square = lag[0];
        (offset, slope) = (solution.x, solution.y);
        let variance = (square / (n - 2.0).max(1.0)).max(4e-4);
        gate = (3.2 * variance.sqrt()).clamp(0.15, gate);
        let support = count as f64 / possible.max(1) as f64;
        let mut covariance = inverse * variance * prior.inflation;
        // Rows that a cover's blur touches a little stay unnoticed: the more is covered the more there are.
        covariance[(0, 0)] += (0.2 * (1.0 - support)).powi(2);
        result = Some(EdgeFit { offset, slope, covariance, support, blur: 0.0, lag });
    }
    result.filter(|e| e.support > 0.2)
}

/// Edges into an outline; where one is missing or contradicts the shape, the shape prior stands in.
fn combine(
    predicted: &Quad,
    mut edges: [Option<EdgeFit>; 4],
    prior: &ShapePrior,
    interior: &Interior,
    outside_levels: [f64; 4],
) -> Option<QuadFit> {
    let (_, centre) = predicted.area_and_centroid();
    let geometry: [Geometry; 4] = std::array::from_fn(|i| {
        let (p, q) = (predicted.0[i], predicted.0[(i + 1) % 4]);
        let length = (q - p).norm();
        let tangent = (q - p) / length;
        let middle = (p + q) / 2.0;
        let normal = Vector2::new(tangent.y, -tangent.x);
        let normal = if normal.dot(&(middle - centre)) < 0.0 { -normal } else { normal };
        (middle, tangent, normal, length)
    });
    let done = |estimate: Estimate, edges: [Option<EdgeFit>; 4]| {
        let mut fit = finish(predicted, &geometry, edges, estimate, interior, outside_levels);
        let contrast = (fit.inside - fit.outside).abs().max(1e-3);
        let lever = prior.half_width * interior.sigma / contrast * prior.correlation;
        fit.covariance +=
            Matrix2::identity() * (lever * lever * interior.reach * prior.inflation / prior.correlation);
        fit.inflation = prior.inflation;
        fit
    };
    if let Some(estimate) = measured(&geometry, &edges, prior)
        && contradiction(&geometry, &edges, &estimate, prior).0 < 3.5
    {
        return Some(done(estimate, edges));
    }
    // While an edge contradicts the shape, leave out the one without which the rest agrees best.
    loop {
        let seen = Seen::of(&edges);
        if seen.count < 2 || !seen.adjacent() {
            return None;
        }
        let estimate = solve(&geometry, &edges, prior)?;
        let (worst, total) = contradiction(&geometry, &edges, &estimate, prior);
        if worst < 3.5 {
            return Some(done(estimate, edges));
        }
        let mut best: Option<(usize, f64)> = None;
        for i in 0..4 {
            let mut fewer = edges;
            if fewer[i].take().is_none() || !Seen::of(&fewer).adjacent() {
                continue;
            }
            let Some(estimate) = solve(&geometry, &fewer, prior) else { continue };
            let (_, rest) = contradiction(&geometry, &fewer, &estimate, prior);
            if best.is_none_or(|b| rest < b.1) {
                best = Some((i, rest));
            }
        }
        match best {
            Some((i, rest)) if rest < total => edges[i] = None,
            _ => return None,
        }
    }
}

/// Largest deviation of an edge from the shape, in sigmas, and the sum of all squared ones with that of the place.
fn contradiction(
    geometry: &[Geometry; 4],
    edges: &[Option<EdgeFit>; 4],
    estimate: &Estimate,
    prior: &ShapePrior,
) -> (f64, f64) {
    let (mut worst, mut total) = (0.0f64, estimate.shift.norm_squared() / prior.place_sigma.powi(2));
    for (g, e) in geometry.iter().zip(edges) {
        let Some(e) = e else { continue };
        let expected = g.2.dot(&estimate.shift) + prior.edge_bias;
        let z2 = (e.offset - expected).powi(2) / (prior.edge_sigma.powi(2) + e.covariance[(0, 0)]);
        worst = worst.max(z2.sqrt());
        total += z2;
    }
    (worst, total)
}

struct Seen {
    seen: [bool; 4],
    count: usize,
}

impl Seen {
    fn of(edges: &[Option<EdgeFit>; 4]) -> Self {
        let seen = edges.map(|e| e.is_some());
        Self { seen, count: seen.iter().filter(|s| **s).count() }
    }

    fn adjacent(&self) -> bool {
        (0..4).any(|i| self.seen[i] && self.seen[(i + 1) % 4])
    }
}

struct Estimate {
    shift: Vector2<f64>,
    offsets: [f64; 4],
    slopes: [f64; 4],
    /// Of (offsets, slopes).
    covariance: SMatrix<f64, 8, 8>,
}

/// The estimate where all four edges were seen well: they speak for themselves. The covariance is block by block.
fn measured(geometry: &[Geometry; 4], edges: &[Option<EdgeFit>; 4], prior: &ShapePrior) -> Option<Estimate> {
    let mut estimate = Estimate {
        shift: Vector2::zeros(),
        offsets: [0.0; 4],
        slopes: [0.0; 4],
        covariance: SMatrix::zeros(),
    };
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for i in 0..4 {
        let e = edges[i].as_ref().filter(|e| e.support > 0.7)?;
        let n = geometry[i].2;
        normal += n * n.transpose();
        right += n * (e.offset - prior.edge_bias);
        estimate.offsets[i] = e.offset;
        estimate.slopes[i] = e.slope;
        estimate.covariance[(i, i)] = e.covariance[(0, 0)];
        estimate.covariance[(i, 4 + i)] = e.covariance[(0, 1)];
        estimate.covariance[(4 + i, i)] = e.covariance[(1, 0)];
        estimate.covariance[(4 + i, 4 + i)] = e.covariance[(1, 1)];
    }
    estimate.shift = normal.try_inverse()? * right;
    Some(estimate)
}

/// Middle, direction, outward normal and length of an edge.
type Geometry = (Vector2<f64>, Vector2<f64>, Vector2<f64>, f64);

/// Least squares over the common shift (2), the edges' offsets (4) and slopes (4): offsets are the shift's normal part
/// plus the bias within `edge_sigma`, slopes are zero within `slope_sigma`, and both are what was measured.
fn solve(geometry: &[Geometry; 4], edges: &[Option<EdgeFit>; 4], prior: &ShapePrior) -> Option<Estimate> {
    let mut information = SMatrix::<f64, 10, 10>::zeros();
    let mut right = SVector::<f64, 10>::zeros();
    information[(0, 0)] = 1e-4;
    information[(1, 1)] = 1e-4;
    let (we, ws) = (prior.edge_sigma.powi(-2), prior.slope_sigma.powi(-2));
    for i in 0..4 {
        let n = geometry[i].2;
        let a = 2 + i;
        for r in 0..2 {
            for c in 0..2 {
                information[(r, c)] += we * n[r] * n[c];
            }
            information[(r, a)] -= we * n[r];
            information[(a, r)] -= we * n[r];
            right[r] -= we * n[r] * prior.edge_bias;
        }
        information[(a, a)] += we;
        right[a] += we * prior.edge_bias;
        let b = 6 + i;
        information[(b, b)] += ws;
        if let Some(e) = &edges[i] {
            let info = e.covariance.try_inverse()?;
            let measured = Vector2::new(e.offset, e.slope);
            let v = info * measured;
            information[(a, a)] += info[(0, 0)];
            information[(a, b)] += info[(0, 1)];
            information[(b, a)] += info[(1, 0)];
            information[(b, b)] += info[(1, 1)];
            right[a] += v.x;
            right[b] += v.y;
        }
    }
    let inverse = information.cholesky()?.inverse();
    let x = inverse * right;
    Some(Estimate {
        shift: Vector2::new(x[0], x[1]),
        offsets: std::array::from_fn(|i| x[2 + i]),
        slopes: std::array::from_fn(|i| x[6 + i]),
        covariance: inverse.fixed_view::<8, 8>(2, 2).into_owned(),
    })
}

fn finish(
    predicted: &Quad,
    geometry: &[Geometry; 4],
    edges: [Option<EdgeFit>; 4],
    estimate: Estimate,
    interior: &Interior,
    outside_levels: [f64; 4],
) -> QuadFit {
    // Each edge as point and direction, then neighbours intersected.
    let line: [(Vector2<f64>, Vector2<f64>); 4] = std::array::from_fn(|i| {
        let (middle, tangent, normal, _) = geometry[i];
        (middle + normal * estimate.offsets[i], tangent + normal * estimate.slopes[i])
    });
    let mut quad = *predicted;
    for i in 0..4 {
        // Corner i + 1 is where edge i meets edge i + 1.
        let ((p, d), (q, e)) = (line[i], line[(i + 1) % 4]);
        let cross = d.x * e.y - d.y * e.x;
        if cross.abs() > 1e-6 {
            let w = q - p;
            quad.0[(i + 1) % 4] = p + d * ((w.x * e.y - w.y * e.x) / cross);
        }
    }
    let (area, centroid) = quad.area_and_centroid();
    let a = area.abs().max(1.0);
    // ∂centroid/∂(offset, slope) of each edge: the strip's first moment about the centroid over the area.
    let mut by = SMatrix::<f64, 2, 8>::zeros();
    for i in 0..4 {
        let (middle, tangent, _, length) = geometry[i];
        let lever = (middle - predicted.area_and_centroid().1) * (length / a);
        let turn = tangent * (length.powi(3) / (12.0 * a));
        for r in 0..2 {
            by[(r, i)] = lever[r];
            by[(r, 4 + i)] = turn[r];
        }
    }
    let covariance = by * estimate.covariance * by.transpose();
    let seen: f64 = edges.iter().flatten().count() as f64;
    let outside =
        (0..4).filter(|&i| edges[i].is_some()).map(|i| outside_levels[i]).sum::<f64>() / seen.max(1.0);
    QuadFit {
        quad,
        centroid,
        covariance: (covariance + covariance.transpose()) * 0.5,
        area: a,
        edges,
        inside: interior.level,
        outside,
        filled: interior.filled,
        inflation: 1.0,
        unevenness: interior.gradient.norm() * a.sqrt() / (interior.level - outside).abs().max(1e-3),
    }
}
