//! Which causes explain a recording: the fewest parameters beyond the accuracy of a survey.
//!
//! All groups start with tight priors. From the normal equations, in which the states are
//! eliminated, follows by how much the cost falls when one group's priors are widened. The group
//! that explains most is freed, the problem solved again, until no group explains much.

use super::groups::{Cause, GROUPS, Group};
use crate::{
    CalibrationError,
    adjustment::Adjustment,
    parameters::{FORCE_BIAS, MARKERS, PARAMETERS, Parameters, RATE_BIAS},
};
use nalgebra::{DMatrix, DVector, SMatrix};
use rig_model::Distortion;

/// Cost that a group must explain for each of its parameters, in units of the noise, beyond
/// [`Group::least`].
pub(crate) const PER_PARAMETER: f64 = 5.0;
/// Largest number of freed groups.
const MOST: usize = 6;
/// Another cause counts as an alternative if it explains this share.
const ALTERNATIVE: f64 = 0.85;
/// Standard deviation of the biases of the IMU, which the filter estimates itself, m/s² and rad/s.
const BIAS: f64 = 0.3;
/// Share of the cost by which it falls where an axis' readings do not follow the motion.
const NOT_FOLLOWING: f64 = 0.5;
/// Cost per image of a constant reading that shows that the axis moved; a reading that is right
/// costs one.
const MOVES: f64 = 3.0;
/// Squared residual per degree of freedom beyond which the model does not fit.
pub const MISFIT: f64 = 6.0;

/// One freed group.
#[derive(Clone, Debug)]
pub(crate) struct Explanation {
    pub cause: Cause,
    /// Causes that explain nearly as much.
    pub alternatives: Vec<Cause>,
}

/// Result of [`explain`].
pub(crate) enum Explained {
    /// Causes, if any.
    By(Box<Outcome>),
    /// Climber axes (x, y, turn) whose readings do not follow the motion: nothing can be estimated
    /// with them.
    Deaf(Vec<usize>),
}

/// What explains a recording.
pub(crate) struct Outcome {
    pub parameters: Parameters,
    pub explanations: Vec<Explanation>,
    /// Per parameter: further change if its group alone were freed, and its standard deviation.
    pub alone: Vec<(f64, f64)>,
    /// Covariance of the markers' places, m².
    pub markers: SMatrix<f64, 12, 12>,
    /// Squared residual per degree of freedom.
    pub noise: f64,
    /// Images used, and rejected ones.
    pub images: (usize, usize),
    /// RMS of the pixel residuals per axis, px.
    pub pixel_rms: f64,
}

/// Normal equations at an estimate: matrix and right side of the data, and the deviation from the
/// prior.
struct Local {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
    moved: DVector<f64>,
}

impl Local {
    fn of(work: &Adjustment<'_>) -> Option<Self> {
        // All parameters have derivatives here, also those that are held.
        let mut open = work.clone();
        open.priors = priors(work.start.camera.distortion(), &[], true);
        let (matrix, right) = open.reduced()?;
        Some(Self { matrix, right, moved: work.parameters.minus(&work.start) })
    }

    /// Cost relative to the estimate's data cost after a step to the minimum with these priors; the
    /// step; and the covariance.
    fn step(&self, priors: &[f64]) -> Option<(f64, DVector<f64>, DMatrix<f64>)> {
        let weights =
            DVector::from_iterator(PARAMETERS, priors.iter().map(|s| 1.0 / (s * s).max(1e-20)));
        let mut matrix = self.matrix.clone();
        for i in 0..PARAMETERS {
            matrix[(i, i)] += weights[i];
        }
        let pull = weights.component_mul(&self.moved);
        let right = &self.right - &pull;
        let factor = matrix.cholesky()?;
        let step = factor.solve(&right);
        let cost = pull.dot(&self.moved) - right.dot(&step);
        Some((cost, step, factor.inverse()))
    }
}

/// Priors with these groups freed; `open`: none is held.
pub(crate) fn priors(lens: &Distortion, freed: &[Cause], open: bool) -> Vec<f64> {
    let mut priors = vec![if open { 1e-6 } else { 0.0 }; PARAMETERS];
    priors[FORCE_BIAS.start..RATE_BIAS.end].fill(BIAS);
    for group in &GROUPS {
        let wide = group.always_free() || freed.contains(&group.cause);
        for i in group.indexes() {
            priors[i] = if wide { group.wide } else { group.tight } * group.scale(i, lens);
        }
    }
    priors
}

/// Explains a recording; `moved` is a marker whose position is unknown.
pub(crate) fn explain(
    work: Adjustment<'_>,
    moved: Option<usize>,
) -> Result<Explained, CalibrationError> {
    let deaf = stuck_axes(&work)?;
    if !deaf.is_empty() {
        return Ok(Explained::Deaf(deaf));
    }
    let outcome = explain_files(work.clone(), moved)?;
    if outcome.noise < MISFIT {
        return Ok(Explained::By(Box::new(outcome)));
    }
    // Where no cause explains the recording, the readings of an axis may mean nothing.
    let deaf = deaf_axes(work)?;
    Ok(if deaf.is_empty() { Explained::By(Box::new(outcome)) } else { Explained::Deaf(deaf) })
}

fn explain_files(
    mut work: Adjustment<'_>,
    moved: Option<usize>,
) -> Result<Outcome, CalibrationError> {
    let diverged = CalibrationError::Diverged;
    let lens = *work.start.camera.distortion();
    let known = |i| Explanation { cause: Cause::Marker(i), alternatives: vec![] };
    let mut freed: Vec<Explanation> = moved.map(known).into_iter().collect();
    let causes = |freed: &[Explanation]| freed.iter().map(|e| e.cause).collect::<Vec<_>>();
    work.priors = priors(&lens, &causes(&freed), false);
    work.solve()?;
    let mut noise;
    let local = loop {
        let local = Local::of(&work).ok_or(diverged)?;
        let data = work.data_cost().ok_or(diverged)?;
        let freedom = 8.0 * work.used.iter().filter(|u| **u).count() as f64;
        let all: Vec<Cause> = GROUPS.iter().map(|g| g.cause).collect();
        let least = local.step(&priors(&lens, &all, true)).ok_or(diverged)?.0;
        noise = ((data + least) / freedom).max(0.5);
        let now = local.step(&priors(&lens, &causes(&freed), true)).ok_or(diverged)?.0;
        let gain = |group: &Group| {
            let mut with = causes(&freed);
            with.push(group.cause);
            let cost = local.step(&priors(&lens, &with, true))?.0;
            Some((now - cost) / noise - PER_PARAMETER * group.count as f64 - group.least())
        };
        let mut gains: Vec<(f64, Cause)> = GROUPS
            .iter()
            .filter(|g| !g.always_free() && !freed.iter().any(|e| e.cause == g.cause))
            .filter_map(|g| Some((gain(g)?, g.cause)))
            .collect();
        gains.sort_by(|a, b| b.0.total_cmp(&a.0));
        let Some(&(best, cause)) = gains.first() else { break local };
        if best < 0.0 || freed.len() >= MOST {
            break local;
        }
        let alternatives =
            gains[1..].iter().filter(|g| g.0 > ALTERNATIVE * best).map(|g| g.1).collect();
        freed.push(Explanation { cause, alternatives });
        work.priors = priors(&lens, &causes(&freed), false);
        work.use_all();
        work.solve()?;
    };
    let freed_now = causes(&freed);
    let covariance = local.step(&priors(&lens, &freed_now, true)).ok_or(diverged)?.2;
    let first = MARKERS.start;
    let markers = covariance.fixed_view::<12, 12>(first, first) * noise;
    let mut alone = vec![(0.0, f64::INFINITY); PARAMETERS];
    for group in &GROUPS {
        let mut with = freed_now.clone();
        with.push(group.cause);
        if let Some((_, step, covariance)) = local.step(&priors(&lens, &with, true)) {
            for i in group.indexes() {
                alone[i] = (step[i], (covariance[(i, i)] * noise).sqrt());
            }
        }
    }
    let used = work.used.iter().filter(|u| **u).count();
    Ok(Outcome {
        pixel_rms: work.pixel_rms(),
        images: (used, work.used.len() - used),
        parameters: work.parameters,
        explanations: freed,
        alone,
        markers,
        noise,
    })
}

/// Returns the climber axes (x, y, turn) without whose readings the cost falls by more than half,
/// as long as the files' values do not fit.
fn deaf_axes(mut work: Adjustment<'_>) -> Result<Vec<usize>, CalibrationError> {
    let mut deaf = vec![];
    work.priors = priors(work.start.camera.distortion(), &[], false);
    work.iterations = 12;
    work.solve()?;
    loop {
        let before = work.data_cost().ok_or(CalibrationError::Diverged)?;
        if before < 8.0 * MISFIT * work.states.len() as f64 {
            return Ok(deaf);
        }
        let mut best: Option<(f64, usize, Adjustment<'_>)> = None;
        for axis in (0..3).filter(|axis| !deaf.contains(axis)) {
            let mut without = work.clone();
            without.ignore(axis);
            without.use_all();
            if without.solve().is_ok()
                && let Some(cost) = without.data_cost()
                && best.as_ref().is_none_or(|b| cost < b.0)
            {
                best = Some((cost, axis, without));
            }
        }
        match best {
            Some((cost, axis, without)) if cost < NOT_FOLLOWING * before => {
                work = without;
                deaf.push(axis);
            }
            _ => return Ok(deaf),
        }
    }
}

/// Returns the climber axes (x, y, turn) with a constant reading although the climber moves along
/// them.
fn stuck_axes(work: &Adjustment<'_>) -> Result<Vec<usize>, CalibrationError> {
    let climber = &work.recording.climber;
    let reading = |axis: usize, k: usize| match axis {
        2 => climber[k].2,
        _ => climber[k].1[axis],
    };
    let constant = |axis: &usize| {
        (0..climber.len()).all(|k| (reading(*axis, k) - reading(*axis, 0)).abs() < 1e-9)
    };
    let mut with = work.clone();
    with.priors = priors(work.start.camera.distortion(), &[], false);
    with.iterations = 20;
    let mut stuck = vec![];
    let candidates: Vec<usize> = (0..3).filter(constant).collect();
    if candidates.is_empty() {
        return Ok(stuck);
    }
    let solved = with.solve();
    // All constant axes are freed together, then each is held again.
    let mut free = with.clone();
    candidates.iter().for_each(|axis| free.ignore(*axis));
    free.use_all();
    if solved.is_err() || free.solve().is_err() {
        return Ok(candidates);
    }
    let least = free.data_cost().ok_or(CalibrationError::Diverged)?;
    let images = free.states.len() as f64;
    for axis in candidates.iter() {
        let mut held = with.clone();
        candidates.iter().filter(|other| *other != axis).for_each(|other| held.ignore(*other));
        held.use_all();
        let solved = held.solve().ok().and_then(|_| held.data_cost());
        let cost = solved.unwrap_or(f64::INFINITY);
        let noise = (least / (8.0 * images)).max(0.5);
        if (cost - least) / noise > MOVES * images {
            stuck.push(*axis);
        }
    }
    Ok(stuck)
}
