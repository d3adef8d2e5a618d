//! Bundle adjustment of parameters and platform states, by Levenberg's and Marquardt's method.

use crate::{
    CalibrationError,
    arrow::{Arrow, STATE},
    parameters::{self, PARAMETERS, Parameters},
    problem::{CLIMBER_NOISE, State, integrated, motion, pixel_whitener, pixels},
    recording::Recording,
};
use nalgebra::{DMatrix, DVector, SMatrix};
use rig_model::median;

/// Eight residuals of variance one: 60 is beyond the 1 - 1e-9 quantile of χ². Nine of an interval:
/// 34 is the 1 - 1e-4 quantile.
const OUTLIER: [f64; 2] = [60.0, 34.0];
/// Medians of χ² with 8 and with 9 degrees of freedom.
const MEDIANS: [f64; 2] = [7.34, 8.34];
/// Largest relative change of the cost by the last step of an adjustment that has converged: it
/// moves the result by a fraction of its standard deviation.
const CONVERGED: f64 = 1e-3;
/// Step of the numerical derivatives, in the parameters' units.
const H: f64 = 1e-6;

/// Problem, current estimate and its settings.
#[derive(Clone)]
pub(crate) struct Adjustment<'a> {
    pub recording: &'a Recording,
    pub start: Parameters,
    /// Standard deviation of the prior of each parameter; 0 holds it.
    pub priors: Vec<f64>,
    /// Rows that hold the layout's position, rotation and size.
    pub gauge: Option<SMatrix<f64, 7, 12>>,
    /// Standard deviation of the climber's pose: m along each axis, rad about the vertical.
    pub climber_noise: [f64; 4],
    pub parameters: Parameters,
    pub states: Vec<State>,
    /// Images that are not outliers.
    pub used: Vec<bool>,
    /// Weights of the intervals between images: below 1 where the IMU samples are outliers, such as
    /// a shock. None is left out, because it links the states.
    pub weights: Vec<f64>,
    /// Limit of iterations.
    pub iterations: usize,
    /// Whether the last solution has converged.
    pub converged: bool,
}

/// Rows of a residual, and its derivatives by the parameters.
type Row = (DVector<f64>, DMatrix<f64>);

impl<'a> Adjustment<'a> {
    /// Starts at parameters and states.
    pub fn new(
        recording: &'a Recording,
        start: Parameters,
        states: Vec<State>,
        priors: Vec<f64>,
    ) -> Self {
        Self {
            recording,
            parameters: start.clone(),
            start,
            priors,
            gauge: None,
            climber_noise: CLIMBER_NOISE,
            used: vec![true; states.len()],
            weights: vec![1.0; states.len()],
            states,
            iterations: 40,
            converged: false,
        }
    }

    fn prior(&self, p: &Parameters) -> Row {
        let moved = p.minus(&self.start);
        let mut r = DVector::zeros(PARAMETERS + 7);
        let mut j = DMatrix::zeros(PARAMETERS + 7, PARAMETERS);
        for i in 0..PARAMETERS {
            // A parameter that is held has no derivatives; one keeps the matrix regular.
            let weight = if self.priors[i] > 0.0 { 1.0 / self.priors[i] } else { 1.0 };
            r[i] = moved[i] * weight;
            j[(i, i)] = weight;
        }
        if let Some(gauge) = self.gauge {
            // A micrometer: held, and still well conditioned.
            let gauge = gauge * 1e6;
            let markers = moved.fixed_rows::<12>(parameters::MARKERS.start);
            r.fixed_rows_mut::<7>(PARAMETERS).copy_from(&(gauge * markers));
            j.fixed_view_mut::<7, 12>(PARAMETERS, parameters::MARKERS.start).copy_from(&gauge);
        }
        (r, j)
    }

    fn whiteners(&self) -> Option<Vec<SMatrix<f64, 8, 8>>> {
        let noise = &self.climber_noise;
        self.recording
            .shots
            .iter()
            .zip(&self.states)
            .map(|(shot, s)| pixel_whitener(self.recording, shot, &self.parameters, s, noise))
            .collect()
    }

    /// Squared whitened residuals of each image and of each interval; infinite where a marker does
    /// not project.
    fn squares(
        &self,
        whiteners: &[SMatrix<f64, 8, 8>],
        p: &Parameters,
        states: &[State],
    ) -> [Vec<f64>; 2] {
        let shots = &self.recording.shots;
        let image = |k: usize| {
            pixels(self.recording, &shots[k], p, &states[k])
                .map_or(f64::INFINITY, |r| (whiteners[k] * r).norm_squared())
        };
        let interval = |k: usize| {
            let change = integrated(self.recording, (&shots[k], &shots[k + 1]), p);
            motion(&change, p, &states[k], &states[k + 1]).norm_squared()
        };
        [(0..shots.len()).map(image).collect(), (0..shots.len() - 1).map(interval).collect()]
    }

    fn cost(
        &self,
        whiteners: &[SMatrix<f64, 8, 8>],
        p: &Parameters,
        states: &[State],
        prior: bool,
    ) -> f64 {
        let [images, intervals] = self.squares(whiteners, p, states);
        let kept = images.iter().zip(&self.used).filter(|(_, used)| **used);
        let images: f64 = kept.map(|(s, _)| s).sum();
        let intervals: f64 = intervals.iter().zip(&self.weights).map(|(s, w)| s * w * w).sum();
        let prior = if prior { self.prior(p).0.norm_squared() } else { 0.0 };
        prior + images + intervals
    }

    /// Returns the squared whitened residuals at the current estimate, without the priors.
    pub fn data_cost(&self) -> Option<f64> {
        Some(self.cost(&self.whiteners()?, &self.parameters, &self.states, false))
    }

    /// Normal equations at the current estimate, by central differences.
    fn linearise(&self, whiteners: &[SMatrix<f64, 8, 8>], prior: bool) -> Option<Arrow> {
        let shots = &self.recording.shots;
        let mut arrow = Arrow::new(shots.len(), PARAMETERS);
        if prior {
            let (r, j) = self.prior(&self.parameters);
            arrow.add_parameters(&j, &r);
        }
        let nudged: Vec<[Parameters; 2]> = (0..PARAMETERS)
            .map(|i| {
                [H, -H].map(|h| {
                    let mut step = [0.0; PARAMETERS];
                    step[i] = h;
                    self.parameters.moved(&step)
                })
            })
            .collect();
        let free = |i: &usize| self.priors[*i] > 0.0;
        let nudge = |state: &State, i: usize, h: f64| {
            let mut step = [0.0; STATE];
            step[i] = h;
            state.moved(&step)
        };
        let p = &self.parameters;
        for k in 0..shots.len() {
            let state = &self.states[k];
            if self.used[k] {
                let whitened = |p: &Parameters, s: &State| {
                    pixels(self.recording, &shots[k], p, s).map(|r| whiteners[k] * r)
                };
                let mut by_state = DMatrix::zeros(8, STATE);
                for i in 0..6 {
                    let d = whitened(p, &nudge(state, i, H))? - whitened(p, &nudge(state, i, -H))?;
                    by_state.column_mut(i).copy_from(&(d / (2.0 * H)));
                }
                let mut by_parameters = DMatrix::zeros(8, PARAMETERS);
                for i in (0..PARAMETERS).filter(|i| parameters::of_pixels(*i)).filter(free) {
                    let d = whitened(&nudged[i][0], state)? - whitened(&nudged[i][1], state)?;
                    by_parameters.column_mut(i).copy_from(&(d / (2.0 * H)));
                }
                let r = whitened(p, state)?;
                let r = DVector::from_column_slice(r.as_slice());
                arrow.add(k, &[&by_state], &by_parameters, &r);
            }
            if k + 1 < shots.len() {
                let next = &self.states[k + 1];
                let pair = (&shots[k], &shots[k + 1]);
                let change = integrated(self.recording, pair, p);
                let weight = self.weights[k];
                let at = |a: &State, b: &State| motion(&change, p, a, b) * weight;
                let (mut first, mut second) = (DMatrix::zeros(9, STATE), DMatrix::zeros(9, STATE));
                for i in 0..STATE {
                    let d = at(&nudge(state, i, H), next) - at(&nudge(state, i, -H), next);
                    first.column_mut(i).copy_from(&(d / (2.0 * H)));
                    let d = at(state, &nudge(next, i, H)) - at(state, &nudge(next, i, -H));
                    second.column_mut(i).copy_from(&(d / (2.0 * H)));
                }
                let mut by_parameters = DMatrix::zeros(9, PARAMETERS);
                for i in (0..PARAMETERS).filter(|i| parameters::of_motion(*i)).filter(free) {
                    let [a, b] = [0, 1].map(|side| {
                        let p = &nudged[i][side];
                        // The mounting does not change the integral.
                        if (6..12).contains(&i) {
                            motion(&change, p, state, next) * weight
                        } else {
                            motion(&integrated(self.recording, pair, p), p, state, next) * weight
                        }
                    });
                    by_parameters.column_mut(i).copy_from(&((a - b) / (2.0 * H)));
                }
                let r = DVector::from_column_slice(at(state, next).as_slice());
                arrow.add(k, &[&first, &second], &by_parameters, &r);
            }
        }
        Some(arrow)
    }

    /// Minimizes the cost; returns the parameters' covariance and the cost. `converged` says
    /// whether that is the minimum.
    pub fn solve(&mut self) -> Result<(DMatrix<f64>, f64), CalibrationError> {
        let failed = CalibrationError::Diverged;
        let mut damping = 1e-4;
        let mut whiteners = self.whiteners().ok_or(failed)?;
        // The first steps are nearly undamped: outliers would lead them astray.
        let [images, _] = self.squares(&whiteners, &self.parameters, &self.states);
        self.leave_out_images(&images);
        self.converged = false;
        let mut cost = self.cost(&whiteners, &self.parameters, &self.states, true);
        if !cost.is_finite() {
            return Err(failed);
        }
        for iteration in 0..self.iterations {
            let solution =
                self.linearise(&whiteners, true).and_then(|a| a.solve(damping)).ok_or(failed)?;
            let parameters = self.parameters.moved(solution.parameters.as_slice());
            let steps = self.states.iter().zip(&solution.states);
            let states: Vec<State> = steps.map(|(s, step)| s.moved(step.as_slice())).collect();
            let new = self.cost(&whiteners, &parameters, &states, true);
            let gain = (cost - new) / cost;
            // A strongly damped step changes little anywhere.
            self.converged = gain.abs() < CONVERGED && (self.converged || damping < 1.0);
            if new < cost {
                (self.parameters, self.states) = (parameters, states);
                damping = (damping * 0.1).max(1e-12);
                if iteration == 4 || iteration == 8 {
                    self.leave_out_outliers(&whiteners);
                }
                whiteners = self.whiteners().ok_or(failed)?;
                cost = self.cost(&whiteners, &self.parameters, &self.states, true);
            } else {
                damping *= 10.0;
                if damping > 1e8 {
                    break;
                }
            }
            if gain.abs() < 1e-7 && iteration > 5 {
                break;
            }
        }
        let solution = self.linearise(&whiteners, true).and_then(|a| a.solve(0.0)).ok_or(failed)?;
        Ok((solution.covariance, cost))
    }

    /// Returns the normal equations of the free parameters alone, without priors: matrix and right
    /// side, the states eliminated.
    pub fn reduced(&self) -> Option<(DMatrix<f64>, DVector<f64>)> {
        self.linearise(&self.whiteners()?, false)?.reduce()
    }

    /// Leaves out images, and weights down intervals, that exceed the quantile.
    fn leave_out_outliers(&mut self, whiteners: &[SMatrix<f64, 8, 8>]) {
        let [images, intervals] = self.squares(whiteners, &self.parameters, &self.states);
        self.leave_out_images(&images);
        let most = limit(&intervals, 1);
        for (weight, square) in self.weights.iter_mut().zip(&intervals) {
            *weight = (most / square.max(1e-9)).min(1.0);
        }
    }

    /// Leaves out images whose squared residuals exceed the quantile.
    fn leave_out_images(&mut self, squares: &[f64]) {
        let most = limit(squares, 0);
        self.used.iter_mut().zip(squares).for_each(|(used, s)| *used = *s < most);
    }

    /// Takes a climber axis (x, y, turn) as unknown.
    pub fn ignore(&mut self, axis: usize) {
        /// Range of a rail, m, and of the turn, rad.
        const UNKNOWN: f64 = 0.3;
        self.parameters.ignored[axis] = true;
        self.climber_noise[if axis < 2 { axis } else { 3 }] = UNKNOWN;
    }

    /// Uses all images and intervals again.
    pub fn use_all(&mut self) {
        self.used.fill(true);
        self.weights.fill(1.0);
    }

    /// Returns the RMS of the pixel residuals per axis, px.
    pub fn pixel_rms(&self) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for (k, shot) in self.recording.shots.iter().enumerate().filter(|(k, _)| self.used[*k]) {
            if let Some(r) = pixels(self.recording, shot, &self.parameters, &self.states[k]) {
                sum += r.norm_squared();
                count += 8.0;
            }
        }
        (sum / f64::max(count, 1.0)).sqrt()
    }
}

/// Square beyond which a residual of a kind is an outlier; where most exceed the quantile, it grows
/// with their median.
fn limit(squares: &[f64], kind: usize) -> f64 {
    let median = median(squares.to_vec()).unwrap_or(0.0);
    OUTLIER[kind] * f64::max(1.0, median / MEDIANS[kind])
}
