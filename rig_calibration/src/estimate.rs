//! Bundle adjustment: first with all parameters free under weak priors, to detect which the motion
//! determines, then with the others held. What then agrees with the rig file is held, too: an exact
//! file is not replaced by an estimate of it.

use crate::{
    CalibrationError, Samples,
    adjustment::Adjustment,
    initial::first_states,
    parameters::{PARAMETERS, Parameters},
    problem::layout_gauge,
    recording::Recording,
};
use nalgebra::DMatrix;
use rig_model::Rig;
use std::ops::Range;

/// 0.99 quantiles of χ² with 3 degrees of freedom, and with the 5 that the gauge leaves of the
/// markers' 12.
const SIGNIFICANT: [(Range<usize>, f64); 5] =
    [(0..3, 11.34), (3..6, 11.34), (6..9, 11.34), (9..12, 11.34), (12..24, 15.09)];

/// Number of parameters that are refined; the others keep the files' values.
const REFINED: usize = 32;

/// One refined parameter.
#[derive(Clone, Debug)]
pub struct Row {
    /// Name, with its axis.
    pub name: String,
    /// Change against the rig file: degrees or millimeters (milliseconds for clocks, SI for
    /// biases); where it agrees with the file, the one that the motion alone would give.
    pub change: f64,
    /// Standard deviation in the same unit, with what the model lacks.
    pub deviation: f64,
    /// The unit.
    pub unit: &'static str,
    /// What became of it.
    pub refinement: Refinement,
}

/// What became of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refinement {
    /// It was refined.
    Refined,
    /// It agrees with the rig file, whose value is kept.
    Agrees,
    /// The motion does not determine it; the rig file's value is kept.
    Undetermined,
}

/// Result of the adjustment.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The refined rig.
    pub rig: Rig,
    /// All parameters.
    pub rows: Vec<Row>,
    /// Numbers of used images and of images rejected as outliers.
    pub images: (usize, usize),
    /// RMS of the pixel residuals per axis, px.
    pub pixel_rms: f64,
    /// Whitened squared residual per degree of freedom (ideal 1).
    pub reduced: f64,
}

/// Name, unit, factor from SI to the unit, standard deviation of the prior, standard deviation
/// below which a parameter counts as determined, and what the model lacks (SI): an accelerometer's
/// slow errors of 0.02 m/s² (MTx data sheet) tilt the camera, its axes and the gyroscope's are
/// aligned to 0.05°, its sensors are millimeters apart, and centroids are off by 0.02 px.
struct Trait {
    name: String,
    unit: &'static str,
    scale: f64,
    prior: f64,
    limit: f64,
    floor: f64,
}

fn traits() -> Vec<Trait> {
    let deg = 1f64.to_radians();
    let mut list = Vec::with_capacity(REFINED);
    let mut three = |what: &str, unit, scale, [prior, limit, floor]: [f64; 3]| {
        for axis in ["x", "y", "z"] {
            list.push(Trait { name: format!("{what} {axis}"), unit, scale, prior, limit, floor });
        }
    };
    three("camera rotation about climber", "deg", 1.0 / deg, [5.0 * deg, 0.3 * deg, 0.12 * deg]);
    three("camera position along climber", "mm", 1e3, [0.1, 0.005, 1e-3]);
    three("imu rotation about volant", "deg", 1.0 / deg, [10.0 * deg, 0.3 * deg, 0.05 * deg]);
    three("imu position along volant", "mm", 1e3, [0.05, 0.005, 1e-3]);
    for color in ["red", "green", "blue", "yellow"] {
        three(&format!("marker {color}"), "mm", 1e3, [0.005, 0.001, 5e-5]);
    }
    three("accelerometer bias", "m/s2", 1.0, [0.3, f64::INFINITY, 0.0]);
    three("gyroscope bias", "deg/s", 1.0 / deg, [0.02, f64::INFINITY, 0.0]);
    for name in ["camera clock against imu", "climber clock against camera"].map(str::to_owned) {
        let (prior, limit, floor) = (0.03, f64::INFINITY, 0.0);
        list.push(Trait { name, unit: "ms", scale: 1e3, prior, limit, floor });
    }
    list
}

/// Refines a rig with a recording, but for the parameters whose names begin with one of `held`.
///
/// # Errors
/// The recording is too short, no pose fits it, its motion determines neither mounting, or the
/// adjustment does not converge.
pub fn refine_rig(
    samples: &Samples,
    rig: &Rig,
    held: &[&str],
) -> Result<Estimate, CalibrationError> {
    let recording = Recording::new(samples)?;
    let traits = traits();
    let start = Parameters::new(rig, &recording);
    let states = first_states(&recording, &start)?;
    let mut priors = vec![0.0; PARAMETERS];
    priors.iter_mut().zip(&traits).for_each(|(prior, t)| *prior = t.prior);
    let mut work = Adjustment::new(&recording, start, states, priors);
    work.gauge = Some(layout_gauge(rig));
    let (covariance, _) = work.solve()?;
    let mut verdicts: Vec<Refinement> = (0..REFINED)
        .map(|i| {
            let deviation = covariance[(i, i)].sqrt();
            let shown = deviation < traits[i].limit && deviation < 0.5 * traits[i].prior
                || traits[i].limit.is_infinite();
            match shown && !held.iter().any(|prefix| traits[i].name.starts_with(prefix)) {
                true => Refinement::Refined,
                false => Refinement::Undetermined,
            }
        })
        .collect();
    if verdicts[..12].iter().all(|verdict| *verdict == Refinement::Undetermined) {
        return Err(CalibrationError::Undetermined);
    }
    let mut found = hold(&mut work, &traits, &verdicts)?;
    let used = work.used.iter().filter(|u| **u).count();
    // Per image 8 pixels and 9 motion residuals against 9 unknowns.
    let free = verdicts.iter().filter(|verdict| **verdict == Refinement::Refined).count();
    let reduced = found.1 / ((8 * used) as f64 - free as f64).max(1.0);
    let inflation = reduced.max(1.0).sqrt();
    let mut rows = rows_of(&work, &traits, &verdicts, &found.0, inflation);
    // Twice: what is held then no longer explains what the others must.
    for _ in 0..2 {
        let mut agree: Vec<usize> = vec![];
        for (group, least) in SIGNIFICANT {
            let refined = group.filter(|i| verdicts[*i] == Refinement::Refined);
            let refined: Vec<usize> = refined.collect();
            let square = |i: &usize| (rows[*i].change / rows[*i].deviation).powi(2);
            if refined.iter().map(square).sum::<f64>() < least {
                agree.extend(refined);
            }
        }
        if agree.is_empty() {
            break;
        }
        agree.iter().for_each(|i| verdicts[*i] = Refinement::Agrees);
        found = hold(&mut work, &traits, &verdicts)?;
        let held = rows;
        rows = rows_of(&work, &traits, &verdicts, &found.0, inflation);
        for (row, before) in rows.iter_mut().zip(held) {
            if row.refinement == Refinement::Agrees {
                (row.change, row.deviation) = (before.change, before.deviation);
            }
        }
    }
    if !work.converged {
        return Err(CalibrationError::Diverged);
    }
    Ok(Estimate {
        rig: work.parameters.rig.clone(),
        rows,
        images: (used, work.used.len() - used),
        pixel_rms: work.pixel_rms(),
        reduced,
    })
}

/// Changes and standard deviations, with the covariance of the parameters.
fn rows_of(
    work: &Adjustment<'_>,
    traits: &[Trait],
    verdicts: &[Refinement],
    covariance: &DMatrix<f64>,
    inflation: f64,
) -> Vec<Row> {
    let change = work.parameters.minus(&work.start);
    (traits.iter().zip(verdicts).enumerate())
        .map(|(i, (t, refinement))| Row {
            name: t.name.clone(),
            change: change[i] * t.scale,
            deviation: (covariance[(i, i)].sqrt() * inflation).hypot(t.floor) * t.scale,
            unit: t.unit,
            refinement: *refinement,
        })
        .collect()
}

/// Solves with everything but the refined parameters at the rig file's values. They return to them
/// gradually: all poses move with them, and one stiff step would leave the valley of the cost.
/// Returns the covariance of the parameters and the cost.
fn hold(
    work: &mut Adjustment<'_>,
    traits: &[Trait],
    verdicts: &[Refinement],
) -> Result<(DMatrix<f64>, f64), CalibrationError> {
    let mut outcome = None;
    for stiffness in [0.1, 0.01, 1e-3, 1e-4, 1e-5] {
        for (i, t) in traits.iter().enumerate() {
            if verdicts[i] != Refinement::Refined {
                work.priors[i] = t.prior * stiffness;
            }
        }
        outcome = Some(work.solve()?);
    }
    outcome.ok_or(CalibrationError::Diverged)
}
