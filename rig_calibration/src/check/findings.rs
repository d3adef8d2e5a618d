//! The report: a table of estimates, and what is wrong in words.

use super::{
    Corrected,
    groups::{Cause, GROUPS, Group},
    select::{MISFIT, Outcome},
    sentences::{finding, name},
};
use crate::{
    climber,
    parameters::{CAMERA_CLOCK, Parameters},
};
use nalgebra::DVector;
use std::fmt;

/// Judgement of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// The recording does not show it.
    Unobservable,
    /// The recording agrees with the files.
    Ok,
    /// It differs, by little.
    Suspect,
    /// It differs.
    Wrong,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Unobservable => "unobservable",
            Self::Ok => "ok",
            Self::Suspect => "suspect",
            Self::Wrong => "wrong",
        })
    }
}

/// One estimated value.
#[derive(Clone, Debug)]
pub struct CheckRow {
    /// What it is, with its axis.
    pub name: String,
    /// The unit of the numbers.
    pub unit: &'static str,
    /// Value in the files.
    pub file: f64,
    /// Estimate; not finite where the recording does not show it.
    pub estimate: f64,
    /// Its standard deviation; infinite where the recording does not show it.
    pub deviation: f64,
    /// The judgement.
    pub verdict: Verdict,
}

/// One thing that is wrong, in words.
#[derive(Clone, Debug)]
pub struct Finding {
    /// The parameter, key or topic.
    pub key: String,
    /// Wrong or suspect.
    pub verdict: Verdict,
    /// What is wrong.
    pub text: String,
    /// What to do.
    pub remedy: String,
    /// Whether nothing else can be estimated before it is corrected.
    pub blocks: bool,
}

impl Finding {
    pub(crate) fn wrong(key: &str, text: impl Into<String>, remedy: impl Into<String>) -> Self {
        let (text, remedy) = (text.into(), remedy.into());
        Self { key: key.to_owned(), verdict: Verdict::Wrong, text, remedy, blocks: false }
    }
}

/// Result of a check.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// Estimates.
    pub rows: Vec<CheckRow>,
    /// What is wrong, worst first.
    pub findings: Vec<Finding>,
    /// Images used, and rejected ones.
    pub images: (usize, usize),
    /// RMS of the pixel residuals per axis, px.
    pub pixel_rms: f64,
    /// Squared residual per degree of freedom (at most 1 where the model fits).
    pub reduced: f64,
}

impl Report {
    /// Whether anything is wrong.
    pub fn is_wrong(&self) -> bool {
        self.findings.iter().any(|f| f.verdict == Verdict::Wrong)
    }
}

/// A deviation is significant beyond this number of standard deviations.
const SIGNIFICANT: f64 = 3.5;

/// Largest tilt of the carriage in a recording, and the one that the filter's parameters declare,
/// rad.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Tilts {
    pub largest: f64,
    pub declared: f64,
}

/// Composes the report; `change` is the estimate's difference to the files.
pub(crate) fn report(
    state: &Corrected,
    file: &Parameters,
    outcome: &Outcome,
    change: &DVector<f64>,
    tilts: Tilts,
) -> Report {
    let mut findings = state.findings.clone();
    // A model that does not fit has no right values.
    let fits = outcome.noise <= MISFIT;
    let worst_possible = if fits { Verdict::Wrong } else { Verdict::Suspect };
    let mut rows = vec![];
    let total = |i: usize| {
        let known = if i == CAMERA_CLOCK { state.imu_clock } else { 0.0 };
        change[i] + known
    };
    for group in &GROUPS {
        let freed = outcome.explanations.iter().find(|e| e.cause == group.cause);
        let mut worst = Verdict::Unobservable;
        let declared = group.cause == Cause::Carriage && tilts.declared >= tilts.largest;
        for i in group.indexes() {
            let (further, deviation) = outcome.alone[i];
            let freed = freed.is_some() || group.always_free();
            let value = total(i) + if freed { 0.0 } else { further };
            let significant = value.abs() > SIGNIFICANT * deviation && !declared;
            let scale = group.scale(i, file.camera.distortion());
            let verdict = match value.abs() / scale {
                v if freed && significant && v > group.sizes[1] => worst_possible,
                v if freed && significant && v > group.sizes[0] => Verdict::Suspect,
                _ if group.detectable() * deviation > group.sizes[1] * scale => {
                    Verdict::Unobservable
                }
                _ => Verdict::Ok,
            };
            worst = worst.max(verdict);
            rows.push(row(group, i, file, value, deviation, verdict));
        }
        let named = state.findings.iter().any(|f| f.key == name(group.cause));
        if worst >= Verdict::Suspect && !named {
            let alternatives = freed.map(|e| e.alternatives.clone()).unwrap_or_default();
            findings.push(finding(group, worst, file, &total, &alternatives, tilts));
        }
    }
    rows.extend(
        ["camera.position z", "climber.height", "climber.rail_x zero", "climber.rail_y zero"].map(
            |name| CheckRow {
                name: name.to_owned(),
                unit: "mm",
                file: f64::NAN,
                estimate: f64::NAN,
                deviation: f64::INFINITY,
                verdict: Verdict::Unobservable,
            },
        ),
    );
    if !fits && findings.iter().all(|f| f.verdict != Verdict::Wrong) {
        let text = format!(
            "the recording does not fit the files, and no single cause explains it (squared \
             residual per degree of freedom {:.1})",
            outcome.noise
        );
        let remedy = "record again with a calmer motion; check that nothing was moved meanwhile";
        findings.push(Finding {
            verdict: Verdict::Suspect,
            ..Finding::wrong("recording", text, remedy)
        });
    }
    findings.sort_by_key(|f| std::cmp::Reverse(f.verdict));
    Report {
        rows,
        findings,
        images: outcome.images,
        pixel_rms: outcome.pixel_rms,
        reduced: outcome.noise,
    }
}

/// A climber axis (x, y, turn) whose readings do not follow the motion.
pub(crate) fn deaf(axis: usize) -> Finding {
    let joint = climber::AXES[axis.min(2)];
    Finding {
        blocks: true,
        ..Finding::wrong(
            &format!("climber.{joint}"),
            format!(
                "the joint `{joint}` does not follow the climber's motion: its reading is stuck \
                 or of another axis"
            ),
            "look at the encoder's cable and at the joint's name in climber_driver's parameters",
        )
    }
}

const AXES: [&str; 3] = ["x", "y", "z"];

pub(super) fn row(
    group: &Group,
    i: usize,
    file: &Parameters,
    change: f64,
    deviation: f64,
    verdict: Verdict,
) -> CheckRow {
    let k = i - group.first;
    let axis = AXES[k.min(2)];
    let (unit, scale) = group.unit;
    let (name, unit, value, change, deviation) = match group.cause {
        Cause::Focal => {
            let f = file.camera.focal_lengths().x;
            let deviation = f * change.exp() * deviation;
            ("camera_info: fx".to_owned(), "px", f, f * change.exp_m1(), deviation)
        }
        Cause::LayoutScale => {
            let (change, deviation) = (change.exp_m1() * scale, change.exp() * deviation * scale);
            (name(group.cause).to_owned(), unit, 100.0, change, deviation)
        }
        _ => {
            let file = file_value(group.cause, k, file) * scale;
            let name = match group.cause {
                Cause::CameraYaw => "camera.orientation about z".to_owned(),
                Cause::CameraTilt | Cause::ImuTurn => format!("{} about {axis}", name(group.cause)),
                Cause::Principal => format!("camera_info: c{axis}"),
                Cause::Distortion => format!("camera_info: d[{k}]"),
                cause if group.count == 1 => name(cause).to_owned(),
                cause => format!("{} {axis}", name(cause)),
            };
            (name, unit, file, change * scale, deviation * scale)
        }
    };
    CheckRow { name, unit, file: value, estimate: value + change, deviation, verdict }
}

/// Value in the files, SI; 0 for what the files hold as a rotation or imply.
fn file_value(cause: Cause, k: usize, file: &Parameters) -> f64 {
    match cause {
        Cause::CameraPlace => file.rig.climber_from_camera.translation.vector[k],
        Cause::ImuPlace => file.rig.imu.volant_from_imu.translation.vector[k],
        Cause::Marker(m) => file.rig.markers.centers.0[m][k],
        Cause::Principal => file.camera.principal_point()[k],
        Cause::Distortion => file.camera.distortion().coefficients()[k],
        Cause::RailX
        | Cause::RailY
        | Cause::TurnScale
        | Cause::GyroScale
        | Cause::AccelerometerScale => 1.0,
        Cause::ClimberClock => file.climber_clock,
        Cause::Readout => file.readout,
        _ => 0.0,
    }
}
