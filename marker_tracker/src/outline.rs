//! The square's outline: four straight edges, each fitted below the pixel, and the area centroid that they enclose.
//!
//! In flow an image seen through a marker's discriminant ([`Sampler`]) and the predicted outline; out flow the measured
//! outline, its centroid and the centroid's covariance. The image of a square through a lens of ordinary distortion bends
//! by a few hundredths of a pixel; the straight line fitted by least squares encloses the same area, and so the same
//! centroid to first order.

use crate::{
    edge::{EdgeFit, MAX_ROWS, Rows, Side, fit_edge},
    interior::Interior,
    quad::Quad,
    signal::Sampler,
};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

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
    /// Gradient of the level inside, per px.
    pub gradient: Vector2<f64>,
    /// Signal inside and outside at the square's middle.
    pub inside: f64,
    pub outside: f64,
    /// Share of the interior samples that have the marker's level.
    pub filled: f64,
    /// The variance inflation that is in the covariance.
    pub inflation: f64,
    /// How far the outline lay off the place where it was sought, at most, px.
    pub miss: f64,
}

/// What is known of the outline beforehand, beside its predicted place.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ShapePrior {
    /// By how much the marker's edges lie further out than the geometry says, px (paper cut too large, blooming): the first and the
    /// third, the second and the fourth.
    pub edge_bias: [f64; 2],
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
    /// Gradient of the level inside as it was of late, per px.
    pub gradient: Option<Vector2<f64>>,
    /// The levels as they were of late.
    pub levels: Option<Levels>,
}

/// Levels of the signal inside of a whole square and beside each of its edges.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Levels {
    inside: f64,
    beside: [f64; 4],
}

/// Change of the level beside an edge, in units of the contrast, from which on something else lies there.
const FOREIGN: f64 = 0.15;
/// Standard deviation, px, that the place of such an edge has beside its rows': it may be that thing's, or a gap too narrow to be seen.
const FOREIGN_SIGMA: f64 = 0.3;

/// How much further in than the others say such an edge may lie, in sigmas.
const COVERED: f64 = 2.0;

impl Levels {
    /// Of a whole outline; `None` where an edge was not seen.
    pub fn of(f: &QuadFit) -> Option<Self> {
        let mut beside = [0.0; 4];
        for (level, edge) in beside.iter_mut().zip(&f.edges) {
            *level = edge.as_ref()?.outside;
        }
        Some(Self { inside: f.inside, beside })
    }

    /// Goes over to other levels by a share `gain`.
    pub fn follow(&mut self, other: &Self, gain: f64) {
        self.inside += gain * (other.inside - self.inside);
        for (level, now) in self.beside.iter_mut().zip(other.beside) {
            *level += gain * (now - *level);
        }
    }

    /// Marks the edges beside which something else lies now. Where it is at most of them, or the level inside is another one, the
    /// light has changed instead.
    fn mark(&self, edges: &mut [Option<EdgeFit>; 4], inside: f64) {
        // Light changes both alike.
        let light = if self.inside.abs() > 0.3 { inside / self.inside } else { 1.0 };
        if !(0.8..1.25).contains(&light) {
            return;
        }
        // In units of the contrast; nought where an edge was not seen.
        let change: [f64; 4] = std::array::from_fn(|i| {
            let beside = self.beside[i] * light;
            edges[i].map_or(0.0, |e| (e.outside - beside) / (self.inside * light - beside).abs())
        });
        // What changes beside all edges is the light's colour; a thing changes some.
        let mut sorted = change;
        sorted.sort_unstable_by(f64::total_cmp);
        let common = (sorted[1] + sorted[2]) / 2.0;
        let foreign = change.map(|c| c.abs() > FOREIGN && (c - common).abs() > FOREIGN / 2.0);
        if foreign.iter().filter(|f| **f).count() > 2 {
            return;
        }
        for (edge, _) in edges.iter_mut().zip(foreign).filter(|(_, f)| *f) {
            if let Some(e) = edge {
                e.foreign = true;
                e.covariance[(0, 0)] += FOREIGN_SIGMA * FOREIGN_SIGMA;
            }
        }
    }
}

/// Measures the outline near `predicted`.
///
/// Each edge is told by the rows that cross it ([`fit_edge`]). The inside level is a plane over the interior and the
/// outside level a line along the edge, carried on with the interior's relative shading. Rows that a crossing thing spoils
/// are left out. An edge that is not seen is put where the shape prior has it relative to the others, and the covariance
/// says so.
///
/// `None` where fewer than two adjacent edges were seen or the contrast is gone.
pub(crate) fn fit(
    sampler: &Sampler<'_>,
    predicted: &Quad,
    prior: &ShapePrior,
    min_contrast: f64,
) -> Option<QuadFit> {
    if !predicted.0.iter().all(|c| c.amax() < 1e6) {
        return None;
    }
    let (signed_area, centre) = predicted.area_and_centroid();
    if signed_area.is_nan() || signed_area.abs() < 9.0 {
        return None;
    }
    let half_width = prior.half_width.min(predicted.thickness_of(signed_area) * 0.25).max(1.0);
    let interior = Interior::measure(sampler, predicted, half_width, prior.rows < MAX_ROWS, prior.gradient)?;
    let sides = Side::of(predicted, centre);
    let mut edges: [Option<EdgeFit>; 4] = [None; 4];
    let mut scratch = Rows::new();
    for i in 0..4 {
        edges[i] = fit_edge(sampler, &interior, &sides[i], half_width, prior, min_contrast, &mut scratch);
    }
    if let Some(levels) = &prior.levels
        && !sampler.full
    {
        levels.mark(&mut edges, interior.level);
    }
    combine(predicted, centre, &sides, edges, prior, &interior)
}

/// Edges into an outline; where one is missing or contradicts the shape, the shape prior stands in.
fn combine(
    predicted: &Quad,
    centre: Vector2<f64>,
    sides: &[Side; 4],
    mut edges: [Option<EdgeFit>; 4],
    prior: &ShapePrior,
    interior: &Interior,
) -> Option<QuadFit> {
    let done = |estimate: &Estimate, edges: [Option<EdgeFit>; 4]| {
        let mut fit = finish(predicted, centre, sides, edges, estimate, interior);
        let contrast = (fit.inside - fit.outside).abs().max(1e-3);
        // (A band is whole pixels, some 0.4 px more on either side.)
        let lever = (prior.half_width + 0.4) * interior.sigma / contrast * prior.correlation;
        fit.covariance +=
            Matrix2::identity() * (lever * lever * interior.reach * prior.inflation / prior.correlation);
        fit.inflation = prior.inflation;
        fit
    };
    if let Some(estimate) = measured(sides, &edges, prior)
        && contradiction(sides, &edges, &estimate, prior).0 < 3.5
    {
        return Some(done(&estimate, edges));
    }
    leave_out_a_cover(sides, &mut edges, prior);
    // While an edge contradicts the shape, leave out the one without which the rest agrees best.
    loop {
        let seen = Seen::of(&edges);
        if seen.count < 2 || !seen.adjacent() {
            return None;
        }
        let estimate = solve(sides, &edges, prior)?;
        let (worst, total) = contradiction(sides, &edges, &estimate, prior);
        if worst < 3.5 {
            return Some(done(&estimate, edges));
        }
        let mut best: Option<(usize, f64)> = None;
        for i in 0..4 {
            let mut fewer = edges;
            if fewer[i].take().is_none() || !Seen::of(&fewer).adjacent() {
                continue;
            }
            let Some(estimate) = solve(sides, &fewer, prior) else { continue };
            let (_, rest) = contradiction(sides, &fewer, &estimate, prior);
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

/// Leaves out the one edge beside which something else lies, where it lies further in than the three others allow: it is that thing's.
/// (A thing that only touches the square leaves its edge where it is.)
fn leave_out_a_cover(sides: &[Side; 4], edges: &mut [Option<EdgeFit>; 4], prior: &ShapePrior) {
    let is_foreign = |e: &Option<EdgeFit>| e.is_some_and(|e| e.foreign);
    let mut foreign = (0..4).filter(|i| is_foreign(&edges[*i]));
    let (Some(i), None) = (foreign.next(), foreign.next()) else { return };
    let mut others = *edges;
    let Some(edge) = others[i].take() else { return };
    if others.iter().flatten().count() < 3 {
        return;
    }
    let Some(estimate) = solve(sides, &others, prior) else { return };
    let expected = sides[i].normal.dot(&estimate.shift) + prior.edge_bias[i % 2];
    let rows = (edge.covariance[(0, 0)] - FOREIGN_SIGMA * FOREIGN_SIGMA).max(0.0);
    if edge.offset - expected < -COVERED * (prior.edge_sigma.powi(2) + rows).sqrt() {
        *edges = others;
    }
}

/// Largest deviation of an edge from the shape, in sigmas, and the sum of all squared ones with that of the place.
fn contradiction(
    sides: &[Side; 4],
    edges: &[Option<EdgeFit>; 4],
    estimate: &Estimate,
    prior: &ShapePrior,
) -> (f64, f64) {
    let (mut worst, mut total) = (0.0f64, estimate.shift.norm_squared() / prior.place_sigma.powi(2));
    for (i, (g, e)) in sides.iter().zip(edges).enumerate() {
        let Some(e) = e else { continue };
        let expected = g.normal.dot(&estimate.shift) + prior.edge_bias[i % 2];
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
    /// Of (offsets, slopes), where edges depend on each other; else each edge's own.
    covariance: Option<SMatrix<f64, 8, 8>>,
}

/// The estimate where all four edges were seen well: they speak for themselves.
fn measured(sides: &[Side; 4], edges: &[Option<EdgeFit>; 4], prior: &ShapePrior) -> Option<Estimate> {
    let (mut offsets, mut slopes) = ([0.0; 4], [0.0; 4]);
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for i in 0..4 {
        let e = edges[i].as_ref().filter(|e| e.support > 0.7 && !e.foreign)?;
        let n = sides[i].normal;
        normal += n * n.transpose();
        right += n * (e.offset - prior.edge_bias[i % 2]);
        (offsets[i], slopes[i]) = (e.offset, e.slope);
    }
    let shift = normal.try_inverse()? * right;
    Some(Estimate { shift, offsets, slopes, covariance: None })
}

/// Least squares over the common shift (2), the edges' offsets (4) and slopes (4): offsets are the shift's normal part
/// plus the bias within `edge_sigma`, slopes are zero within `slope_sigma`, and both are what was measured.
fn solve(sides: &[Side; 4], edges: &[Option<EdgeFit>; 4], prior: &ShapePrior) -> Option<Estimate> {
    let mut information = SMatrix::<f64, 10, 10>::zeros();
    let mut right = SVector::<f64, 10>::zeros();
    information[(0, 0)] = 1e-4;
    information[(1, 1)] = 1e-4;
    let (we, ws) = (prior.edge_sigma.powi(-2), prior.slope_sigma.powi(-2));
    for i in 0..4 {
        let n = sides[i].normal;
        let a = 2 + i;
        for r in 0..2 {
            for c in 0..2 {
                information[(r, c)] += we * n[r] * n[c];
            }
            information[(r, a)] -= we * n[r];
            information[(a, r)] -= we * n[r];
            right[r] -= we * n[r] * prior.edge_bias[i % 2];
        }
        information[(a, a)] += we;
        right[a] += we * prior.edge_bias[i % 2];
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
        covariance: Some(inverse.fixed_view::<8, 8>(2, 2).into_owned()),
    })
}

fn finish(
    predicted: &Quad,
    centre: Vector2<f64>,
    sides: &[Side; 4],
    edges: [Option<EdgeFit>; 4],
    estimate: &Estimate,
    interior: &Interior,
) -> QuadFit {
    // Each edge as point and direction, then neighbours intersected.
    let line: [(Vector2<f64>, Vector2<f64>); 4] = std::array::from_fn(|i| {
        let Side { middle, tangent, normal, .. } = sides[i];
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
    let by: [Matrix2<f64>; 4] = std::array::from_fn(|i| {
        let Side { middle, tangent, length, .. } = sides[i];
        Matrix2::from_columns(&[(middle - centre) * (length / a), tangent * (length.powi(3) / (12.0 * a))])
    });
    let mut covariance = Matrix2::zeros();
    match &estimate.covariance {
        None => {
            for (b, e) in by.iter().zip(&edges) {
                if let Some(e) = e {
                    covariance += b * e.covariance * b.transpose();
                }
            }
        }
        Some(all) => {
            for i in 0..4 {
                for j in 0..4 {
                    let part =
                        Matrix2::new(all[(i, j)], all[(i, 4 + j)], all[(4 + i, j)], all[(4 + i, 4 + j)]);
                    covariance += by[i] * part * by[j].transpose();
                }
            }
        }
    }
    let miss = (0..4)
        .map(|i| estimate.offsets[i].abs() + estimate.slopes[i].abs() * sides[i].length / 2.0)
        .fold(0.0, f64::max);
    let seen = edges.iter().flatten().count() as f64;
    let outside = edges.iter().flatten().map(|e| e.outside).sum::<f64>() / seen.max(1.0);
    QuadFit {
        quad,
        centroid,
        covariance: (covariance + covariance.transpose()) * 0.5,
        area: a,
        edges,
        gradient: interior.gradient,
        inside: interior.level,
        outside,
        filled: interior.filled,
        inflation: 1.0,
        miss,
        unevenness: interior.gradient.norm() * a.sqrt() / (interior.level - outside).abs().max(1e-3),
    }
}
