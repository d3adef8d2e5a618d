//! Bundle adjustment: first with all parameters free under weak priors, to detect which the motion
//! determines, then with the others held.

use crate::{
    CalibrationError,
    adjustment::Adjustment,
    initial::first_states,
    parameters::{PARAMETERS, Parameters},
    problem::{CLIMBER_NOISE, layout_gauge},
    recording::Recording,
};
use rig_model::Rig;

/// Number of parameters that are refined; the others keep the files' values.
const REFINED: usize = 32;

/// One refined parameter.
#[derive(Clone, Debug)]
pub struct Row {
    /// Name, with its axis.
    pub name: String,
    /// Change against the rig file: degrees or millimeters (milliseconds for clocks, SI for
    /// biases).
    pub change: f64,
    /// Standard deviation in the same unit.
    pub deviation: f64,
    /// The unit.
    pub unit: &'static str,
    /// Whether the motion determines it; otherwise the rig file's value is kept.
    pub determined: bool,
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
    /// RMS of the pixel residuals per axis before and after, px.
    pub pixel_rms: (f64, f64),
    /// Whitened squared residual per degree of freedom (ideal 1).
    pub reduced: f64,
}

/// Name, unit, factor from SI to the unit, standard deviation of the prior, and standard deviation
/// below which a parameter counts as determined (SI).
struct Trait {
    name: String,
    unit: &'static str,
    scale: f64,
    prior: f64,
    limit: f64,
}

fn traits() -> Vec<Trait> {
    let deg = 1f64.to_radians();
    let mut list = Vec::with_capacity(REFINED);
    let mut three = |what: &str, unit, scale, prior, limit| {
        for axis in ["x", "y", "z"] {
            list.push(Trait { name: format!("{what} {axis}"), unit, scale, prior, limit });
        }
    };
    three("camera rotation about climber", "deg", 1.0 / deg, 5.0 * deg, 0.3 * deg);
    three("camera position along climber", "mm", 1e3, 0.1, 0.005);
    three("imu rotation about volant", "deg", 1.0 / deg, 10.0 * deg, 0.3 * deg);
    three("imu position along volant", "mm", 1e3, 0.05, 0.005);
    for color in ["red", "green", "blue", "yellow"] {
        three(&format!("marker {color}"), "mm", 1e3, 0.005, 0.001);
    }
    three("accelerometer bias", "m/s2", 1.0, 0.3, f64::INFINITY);
    three("gyroscope bias", "deg/s", 1.0 / deg, 0.02, f64::INFINITY);
    for clock in ["camera clock against imu", "climber clock against camera"] {
        list.push(Trait {
            name: clock.to_owned(),
            unit: "ms",
            scale: 1e3,
            prior: 0.03,
            limit: f64::INFINITY,
        });
    }
    list
}

/// Refines a rig with a recording, but for the parameters whose names begin with one of `held`.
///
/// # Errors
/// No pose fits the recording, or its motion determines neither mounting.
pub fn refine_rig(
    recording: &Recording,
    rig: &Rig,
    held: &[&str],
) -> Result<Estimate, CalibrationError> {
    let traits = traits();
    let start = Parameters::new(rig, recording);
    let states = first_states(recording, &start)?;
    let mut priors = vec![0.0; PARAMETERS];
    priors.iter_mut().zip(&traits).for_each(|(prior, t)| *prior = t.prior);
    let mut work = Adjustment::new(recording, start, states, priors, CLIMBER_NOISE);
    work.gauge = Some(layout_gauge(rig));
    let before = work.pixel_rms();
    let (covariance, _) = work.solve()?;
    let determined: Vec<bool> = (0..REFINED)
        .map(|i| {
            let deviation = covariance[(i, i)].sqrt();
            let shown = deviation < traits[i].limit && deviation < 0.5 * traits[i].prior
                || traits[i].limit.is_infinite();
            shown && !held.iter().any(|prefix| traits[i].name.starts_with(prefix))
        })
        .collect();
    if !determined[..12].iter().any(|d| *d) {
        return Err(CalibrationError::Undetermined);
    }
    // Undetermined parameters return to the rig file's values gradually: all poses move with them,
    // and one stiff step would leave the valley of the cost.
    let mut outcome = None;
    for stiffness in [0.1, 0.01, 1e-3, 1e-4, 1e-5] {
        for i in (0..REFINED).filter(|i| !determined[*i]) {
            work.priors[i] = traits[i].prior * stiffness;
        }
        outcome = Some(work.solve()?);
    }
    let (covariance, cost) = outcome.ok_or(CalibrationError::Diverged)?;
    let used = work.used.iter().filter(|u| **u).count();
    // Per image 8 pixels and 9 motion residuals against 9 unknowns.
    let freedom = (8 * used) as f64 - determined.iter().filter(|d| **d).count() as f64;
    let reduced = cost / freedom.max(1.0);
    let inflation = reduced.max(1.0).sqrt();
    let change = work.parameters.minus(&work.start);
    let rows = traits
        .iter()
        .enumerate()
        .map(|(i, t)| Row {
            name: t.name.clone(),
            change: change[i] * t.scale,
            deviation: covariance[(i, i)].sqrt() * inflation * t.scale,
            unit: t.unit,
            determined: determined[i],
        })
        .collect();
    Ok(Estimate {
        rig: work.parameters.rig.clone(),
        rows,
        images: (used, work.used.len() - used),
        pixel_rms: (before, work.pixel_rms()),
        reduced,
    })
}
