//! Combination of four edges with the prior knowledge of the square's shape.

use crate::edge::{EdgeFit, ShapePrior, Side};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

type Edges = [Option<EdgeFit>; 4];

/// Largest deviation of an edge from the shape, in standard deviations (normal distribution,
/// two-sided: 5e-4).
const GATE: f64 = 3.5;

/// Outline as displacements of its predicted sides.
pub(super) struct Estimate {
    /// Common displacement, px.
    shift: Vector2<f64>,
    /// Displacement along each outward normal, px.
    pub offsets: [f64; 4],
    /// Change of each displacement per pixel along the side.
    pub slopes: [f64; 4],
    /// Of (offsets, slopes), where edges depend on each other; otherwise each edge has its own.
    pub covariance: Option<SMatrix<f64, 8, 8>>,
}

/// Combines the edges; where one is missing or contradicts the shape, the shape prior stands in.
/// Returns the estimate and the edges that it is based on; `None` where no two adjacent edges
/// agree.
pub(super) fn combine(
    sides: &[Side; 4],
    mut edges: Edges,
    prior: &ShapePrior,
) -> Option<(Estimate, Edges)> {
    if let Some(estimate) = measured(sides, &edges, prior)
        && contradiction(sides, &edges, &estimate, prior).worst < GATE
    {
        return Some((estimate, edges));
    }
    // While an edge contradicts the shape, leave out the one without which the others agree best.
    loop {
        if !has_adjacent(&edges) {
            return None;
        }
        let estimate = solve(sides, &edges, prior)?;
        let Contradiction { worst, total } = contradiction(sides, &edges, &estimate, prior);
        if worst < GATE {
            return Some((estimate, edges));
        }
        let mut best: Option<(usize, f64)> = None;
        for i in 0..4 {
            let mut fewer = edges;
            if fewer[i].take().is_none() || !has_adjacent(&fewer) {
                continue;
            }
            let Some(estimate) = solve(sides, &fewer, prior) else { continue };
            let rest = contradiction(sides, &fewer, &estimate, prior).total;
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

fn has_adjacent(edges: &Edges) -> bool {
    (0..4).any(|i| edges[i].is_some() && edges[(i + 1) % 4].is_some())
}

/// Deviation of the edges from the shape.
struct Contradiction {
    /// Of the worst edge, in standard deviations.
    worst: f64,
    /// Sum of the squared deviations of edges and place.
    total: f64,
}

fn contradiction(
    sides: &[Side; 4],
    edges: &Edges,
    estimate: &Estimate,
    prior: &ShapePrior,
) -> Contradiction {
    let (mut worst, mut total) =
        (0.0f64, estimate.shift.norm_squared() / prior.tolerance.place.powi(2));
    for (i, (side, e)) in sides.iter().zip(edges).enumerate() {
        let Some(e) = e else { continue };
        let expected = side.normal.dot(&estimate.shift) + prior.edge_bias[i % 2];
        let z2 =
            (e.offset - expected).powi(2) / (prior.tolerance.edge.powi(2) + e.covariance[(0, 0)]);
        worst = worst.max(z2.sqrt());
        total += z2;
    }
    Contradiction { worst, total }
}

/// The estimate where all four edges were measured well: no prior needed.
fn measured(sides: &[Side; 4], edges: &Edges, prior: &ShapePrior) -> Option<Estimate> {
    let (mut offsets, mut slopes) = ([0.0; 4], [0.0; 4]);
    let (mut normal, mut right) = (Matrix2::zeros(), Vector2::zeros());
    for i in 0..4 {
        let e = edges[i].as_ref().filter(|e| e.support > 0.7 && !e.foreign && !e.moved)?;
        let n = sides[i].normal;
        normal += n * n.transpose();
        right += n * (e.offset - prior.edge_bias[i % 2]);
        (offsets[i], slopes[i]) = (e.offset, e.slope);
    }
    let shift = normal.try_inverse()? * right;
    Some(Estimate { shift, offsets, slopes, covariance: None })
}

/// Least squares over the common shift (2), the edges' offsets (4) and slopes (4): an offset is the
/// shift's normal part plus the bias and a slope is zero, each within its tolerance, and both are
/// what was measured.
fn solve(sides: &[Side; 4], edges: &Edges, prior: &ShapePrior) -> Option<Estimate> {
    let mut information = SMatrix::<f64, 10, 10>::zeros();
    let mut right = SVector::<f64, 10>::zeros();
    information[(0, 0)] = 1e-4;
    information[(1, 1)] = 1e-4;
    let (we, ws) = (prior.tolerance.edge.powi(-2), prior.tolerance.slope.powi(-2));
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
