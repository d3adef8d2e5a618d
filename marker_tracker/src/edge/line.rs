//! Line fit: the straight line through the places of an edge on its rows, which is the measured
//! edge.

use crate::edge::{
    prior::ShapePrior,
    rows::{Column, MAX_ROWS, eight, present},
};
use nalgebra::Matrix2;
use wide::f32x8;

/// Variance of a row's place that is assumed at least, px²: 0.02 px, which 8-bit values leave at a
/// weak edge.
const MIN_VARIANCE: f64 = 4e-4;
/// Gate for a row's residual in standard deviations (normal distribution: 0.14 % of the rows are
/// lost), and its least value, px.
const ROW_GATE: f64 = 3.2;
const MIN_GATE: f32 = 0.15;
/// Largest distance of a row's place from the mean, px, up to which the plain least squares line is
/// tried first.
const PLAIN: f32 = 0.3;
/// Least share of an edge's rows that determine it.
const MIN_SUPPORT: f64 = 0.2;
/// Standard deviation of an edge of which all rows are covered, px: rows that a cover's blur
/// touches a little go unnoticed, in proportion to the covered share. Tuned; guarded by the bound
/// on partly covered markers in `tests/bags`.
const COVERED_SIGMA: f64 = 0.2;

/// Number of lags at which the residuals of rows are correlated, lag 0 included.
pub(crate) const LAGS: usize = 2;

/// A measured edge of a square.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct EdgeFit {
    /// Displacement of the edge's middle along its outward normal, px.
    pub offset: f64,
    /// Change of the displacement per pixel along the edge.
    pub slope: f64,
    /// Covariance of (offset, slope); px², px, 1.
    pub covariance: Matrix2<f64>,
    /// Share of the edge's usable rows that agree with the line.
    pub support: f64,
    /// Level outside, at the edge's middle.
    pub outside: f64,
    /// Whether the level outside has changed: something lies beside the marker, over its edge or
    /// just short of it, and this may be that thing's edge.
    pub foreign: bool,
    /// ∫ c·(1 − c) across the edge, px, for the share c of the marker: a sixth of the width of a
    /// motion blur, 0.56 σ of a Gaussian one.
    pub blur: f64,
    /// Root mean square, over the rows, of how far the light that the band has in excess of that
    /// inside and beyond it moves the edge, px: 0 unless the light changes within the band. Where
    /// the signal of the surroundings is small, dark or bright things there move little.
    pub shade: f64,
    /// Mean light beyond the band, in units of that inside.
    pub light_outside: f64,
    /// Whether a thing beside the marker may have moved the edge, so that the other edges and the
    /// known shape have to correct it. (It still counts as seen: a shadow looks alike.)
    pub moved: bool,
    /// Part of the offset's variance that is due to what is beside the marker, px².
    pub beside: f64,
    /// Σ rᵢ² and Σ rᵢ·rᵢ₊₁ of the rows' residuals, px².
    pub lag: [f64; LAGS],
}

impl EdgeFit {
    /// Adds an error of the offset with this standard deviation, px, for what is beside the marker.
    pub fn widen(&mut self, sigma: f64) {
        self.beside += sigma * sigma;
        self.covariance[(0, 0)] += sigma * sigma;
    }
}

/// Places of an edge on its rows: distance along it, and outside of the prediction, px.
pub(super) struct Places {
    pub count: usize,
    pub along: Column,
    pub across: Column,
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
    /// Keeps the rows whose entry in `good` is positive.
    pub fn keep(&mut self, good: &Column) {
        let mut kept = 0;
        for (i, good) in good.iter().enumerate().take(self.count) {
            if *good > 0.0 {
                (self.along[kept], self.across[kept]) = (self.along[i], self.across[i]);
                kept += 1;
            }
        }
        self.count = kept;
    }

    /// Fits a robust straight line to the rows' places. `possible`: number of rows that the edge
    /// has; `length`: its length, px. `None` where fewer than three rows, or less than a fifth of
    /// them, agree.
    ///
    /// A cover moves a row's crossing inward, never outward, so that of several places on which
    /// rows agree the outermost is the edge. Rows beside ones that disagree are half covered and
    /// are left out with them.
    pub fn line(&self, possible: usize, length: f64, prior: &ShapePrior) -> Option<EdgeFit> {
        let count = self.count;
        if count < 3 {
            return None;
        }
        let lean = 2.0 * prior.tolerance.slope * length / 2.0;
        // Where all rows agree, one pass suffices.
        let zero = f32x8::ZERO;
        let (mut st, mut stt, mut sa, mut sta) = (zero, zero, zero, zero);
        for group in (0..count).step_by(8) {
            let there = present(group, count);
            let (along, across) =
                (eight(&self.along, group) & there, eight(&self.across, group) & there);
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
        if !largest(furthest).is_nan() && largest(furthest) < PLAIN {
            let fit = sums.solve(prior)?;
            let (offset, slope) = (f32x8::splat(fit.0 as f32), f32x8::splat(fit.1 as f32));
            let mut residuals: Column = [0.0; MAX_ROWS];
            let (mut square, mut furthest) = (zero, zero);
            for group in (0..count).step_by(8) {
                let residual =
                    (eight(&self.across, group) - offset - slope * eight(&self.along, group))
                        & present(group, count);
                square += residual * residual;
                furthest = furthest.fast_max(residual.abs());
                residuals[group..group + 8].copy_from_slice(residual.as_array());
            }
            let product: f32 = residuals[..count].windows(2).map(|r| r[0] * r[1]).sum();
            let (edge, gate) =
                sums.edge(fit, square.reduce_add(), product, (0.3 + lean) as f32, possible, prior);
            if largest(furthest) < gate {
                return (edge.support > MIN_SUPPORT).then_some(edge);
            }
        }
        self.robust_line(possible, lean, prior)
    }

    fn robust_line(&self, possible: usize, lean: f64, prior: &ShapePrior) -> Option<EdgeFit> {
        let count = self.count;
        let (along, across) = (&self.along[..count], &self.across[..count]);
        let mean = across.iter().sum::<f32>() / count as f32;
        let (mut offset, mut slope, reach);
        if across.iter().all(|a| (a - mean).abs() < PLAIN) {
            (offset, slope, reach) = (mean, 0f32, 0.3 + lean);
        } else {
            let mut sorted = self.across;
            let sorted = &mut sorted[..count];
            sorted.sort_unstable_by(f32::total_cmp);
            let spread = f64::from(sorted[count * 3 / 4] - sorted[count / 4]) / 1.35;
            // The place with most rows within ± reach, and the outermost with half as many.
            reach = (2.0 * spread).clamp(0.2, 0.4) + lean;
            let near = reach as f32;
            let fullness = |at: usize| {
                let from = sorted.partition_point(|&v| v < sorted[at] - near);
                let to = sorted.partition_point(|&v| v <= sorted[at] + near);
                (from, to)
            };
            let most = (0..count).map(&fullness).map(|(a, b)| b - a).max()?;
            let enough = most.max(8.min(count));
            let (from, to) =
                (0..count).rev().map(&fullness).find(|(a, b)| 2 * (b - a) >= enough)?;
            (offset, slope) = (sorted[(from + to) / 2], 0.0);
        }
        let mut gate = reach as f32;
        let mut used = [false; MAX_ROWS];
        // Sampled rows are no neighbors.
        let neighbors = possible < prior.tolerance.rows;
        let mut before = usize::MAX;
        let mut result = None;
        for round in 0..3 {
            let agrees = |i: usize| (across[i] - offset - slope * along[i]).abs() < gate;
            let mut members = 0usize;
            for (i, used) in used[..count].iter_mut().enumerate() {
                let member = agrees(i)
                    && (round == 0
                        || !neighbors
                        || ((i == 0 || agrees(i - 1)) && (i + 1 == count || agrees(i + 1))));
                *used = member;
                members += usize::from(member);
            }
            if members < 3 {
                return None;
            }
            if members == count && members == before {
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
        result.filter(|e| e.support > MIN_SUPPORT)
    }
}

fn largest(of: f32x8) -> f32 {
    of.as_array().iter().fold(0.0, |m, v| m.max(*v))
}

impl LineSums {
    /// Σ along² with the prior of the direction, whose weight assumes a row's usual noise of 0.1
    /// px.
    fn stt(&self, prior: &ShapePrior) -> f64 {
        self.stt + 0.01 / (prior.tolerance.slope * prior.tolerance.slope)
    }

    /// Offset and slope.
    fn solve(&self, prior: &ShapePrior) -> Option<(f64, f64)> {
        let stt = self.stt(prior);
        let det = self.n * stt - self.st * self.st;
        (det > 0.0).then(|| {
            (
                (stt * self.sa - self.st * self.sta) / det,
                (self.n * self.sta - self.st * self.sa) / det,
            )
        })
    }

    /// The edge with this line, from the sum of its squared residuals (px²) and of the products of
    /// neighboring ones, and the gate (px, at most `gate`) for its rows.
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
        let variance = (f64::from(square) / (self.n - 2.0).max(1.0)).max(MIN_VARIANCE);
        let support = self.n / possible.max(1) as f64;
        let mut covariance =
            Matrix2::new(stt, -self.st, -self.st, self.n) * (variance * prior.inflation / det);
        covariance[(0, 0)] += (COVERED_SIGMA * (1.0 - support)).powi(2);
        let lag = [f64::from(square), f64::from(product)];
        let gate = ((ROW_GATE * variance.sqrt()) as f32).clamp(MIN_GATE, gate);
        (EdgeFit { offset, slope, covariance, support, lag, ..EdgeFit::default() }, gate)
    }
}
