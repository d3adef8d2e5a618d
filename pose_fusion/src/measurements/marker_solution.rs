//! Iterated update of the state by a subset of an image's markers (Bell and Cathey 1993), and the
//! choice of the subset.

use super::{
    geometry::Geometry,
    marker_prediction::{Linearization, innovation_spread, linearize, times_error},
    markers::{Block, ByCalibration, Gain, Image, Jacobian, Residual, SEEN},
};
use crate::ekf::{
    propagation::ImuReading,
    state::{ATTITUDE, Covariance, Error, State},
};
use nalgebra::{Cholesky, Const, SMatrix};

/// What an image's update knows at the prior.
pub struct Prediction {
    /// Residuals and their derivatives by the state.
    pub linear: Linearization,
    /// Covariance of the centroids.
    pub noise: Block,
    /// `H V + E`.
    pub by_parameter: ByCalibration,
    /// Covariance that the uncertain places of the markers add to the residuals.
    pub layout: Block,
}

/// Correction by the markers of a subset.
pub struct Solution {
    /// Error to add to the state.
    pub step: Error,
    /// `W = P Hᵀ L⁻ᵀ`.
    pub root: Gain,
    /// Squared deviation from prior, layout and pixels, in units of their covariances.
    pub cost: f64,
    /// Normalized innovation squared at the prior, the layout's uncertainty included.
    pub nis: f64,
    /// Innovation `L⁻¹ r`.
    pub whitened: Residual,
    /// `L⁻¹ (H V + E)`.
    pub by_parameter: ByCalibration,
    /// `L⁻¹` of the derivatives by the climber's x, y and turn.
    pub by_climber: SMatrix<f64, 8, 3>,
}

/// Largest number of linearizations; a fifth one changes nothing on any recorded bag.
const ITERATIONS: usize = 5;
/// χ² quantile (0.9999) for 0, 2, 4, 6, 8 degrees of freedom.
const JOINT_LIMIT: [f64; 5] = [0.0, 18.42, 23.51, 27.86, 31.83];

/// Returns the number of markers in a subset.
pub fn count(mask: &[bool; 4]) -> usize {
    mask.iter().filter(|m| **m).count()
}

/// Returns the largest consistent subset of `pass`, among equals the likeliest, and its solution.
/// With `any` every subset counts as consistent. One marker is always consistent with itself, which
/// proves nothing: it is used only where it is alone.
pub fn largest_consistent(
    pass: &[bool; 4],
    any: bool,
    solve: impl Fn(&[bool; 4]) -> Option<Solution>,
) -> Option<([bool; 4], Solution)> {
    if count(pass) == 1 {
        return Some((*pass, solve(pass)?));
    }
    for size in (2..=count(pass)).rev() {
        let masks = (1u8..16).map(|bits| std::array::from_fn(|i| bits >> i & 1 == 1));
        let consistent = masks
            .filter(|mask| count(mask) == size && (0..4).all(|i| pass[i] || !mask[i]))
            .filter_map(|mask| Some((mask, solve(&mask)?)))
            .filter(|(_, solution)| any || solution.cost <= JOINT_LIMIT[size])
            .reduce(|best, next| if next.1.cost < best.1.cost { next } else { best });
        if consistent.is_some() {
            return consistent;
        }
    }
    None
}

/// Computes the correction of `prior` by the markers in `mask`. `None` where it cannot be computed.
pub fn solve(
    prior: &State,
    geometry: &Geometry,
    image: &Image,
    reading: &ImuReading,
    at_prior: &Prediction,
    mask: &[bool; 4],
) -> Option<Solution> {
    let used = |row: usize| mask[row / 2] && image.has(row / 2);
    let of_used = |block: &Block, unused: &Block| {
        Block::from_fn(|i, j| if used(i) && used(j) { block[(i, j)] } else { unused[(i, j)] })
    };
    let noise = of_used(&at_prior.noise, &Block::identity());
    let layout = of_used(&at_prior.layout, &Block::zeros());
    let masked =
        |linear: &Linearization| (rows_of(&linear.residual, mask), rows_of(&linear.jacobian, mask));
    let (mut residual, mut jacobian) = masked(&at_prior.linear);
    let mut step = Error::zeros();
    let mut nis = f64::NAN;
    for iteration in 0..ITERATIONS {
        let gain = covariance_times(&prior.covariance, &jacobian);
        let spread = innovation_spread(&jacobian, &gain);
        let cholesky = Cholesky::<f64, Const<8>>::new(spread + noise)?;
        let seen = times_error(&jacobian, &step);
        let target = residual + seen;
        let weighted = cholesky.solve(&target);
        let whole = Cholesky::<f64, Const<8>>::new(spread + noise + layout)?;
        let cost = target.dot(&whole.solve(&target));
        if iteration == 0 {
            nis = cost;
        }
        let next: Error = gain * weighted;
        let moved = times_error(&jacobian, &next);
        let left = target - moved;
        // Relinearize where the projection bends: more than two pixels, or half a degree.
        let bends =
            (moved - seen).amax() > 2.0 || (next - step).fixed_rows::<3>(ATTITUDE).amax() > 0.01;
        step = next;
        if bends && iteration + 1 < ITERATIONS {
            let mut there = prior.clone();
            there.add(&step);
            let linear = linearize(&there, geometry, image, reading);
            if (0..4).any(|i| mask[i] && !linear.valid[i]) {
                return None;
            }
            let (r, h) = masked(&linear);
            if (r - left).amax() > 0.01 {
                (residual, jacobian) = (r, h);
                continue;
            }
        }
        let l = cholesky.l();
        let root = l.solve_lower_triangular(&gain.transpose())?.transpose();
        let by_parameter = l.solve_lower_triangular(&rows_of(&at_prior.by_parameter, mask))?;
        let by_climber = jacobian.fixed_columns::<3>(6).into_owned();
        let by_climber = l.solve_lower_triangular(&by_climber)?;
        let whitened = l.solve_lower_triangular(&target)?;
        return cost.is_finite().then_some(Solution {
            step,
            root,
            cost,
            nis,
            whitened,
            by_parameter,
            by_climber,
        });
    }
    None
}

/// Returns the rows of the markers in `mask`, zero for the others.
fn rows_of<const C: usize>(all: &SMatrix<f64, 8, C>, mask: &[bool; 4]) -> SMatrix<f64, 8, C> {
    let mut rows = *all;
    for i in (0..4).filter(|i| !mask[*i]) {
        rows.fixed_rows_mut::<2>(2 * i).fill(0.0);
    }
    rows
}

/// Returns `P Hᵀ`, by the columns of P that H touches.
pub fn covariance_times(p: &Covariance, h: &Jacobian) -> Gain {
    let mut out = Gain::zeros();
    for row in 0..8 {
        let mut column = out.column_mut(row);
        for (k, &index) in SEEN.iter().enumerate() {
            let weight = h[(row, k)];
            if weight != 0.0 {
                column.axpy(weight, &p.column(index), 1.0);
            }
        }
    }
    out
}
