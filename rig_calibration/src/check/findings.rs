//! The report: a table of estimates, and what is wrong in words.

use super::{
    Corrected,
    groups::{Cause, GROUPS, Group},
    select::{MISFIT, Outcome},
};
use crate::{
    climber,
    parameters::{CAMERA_CLOCK, Parameters},
};
use nalgebra::DVector;
use rig_model::MarkerColor;
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

/// Composes the report; `change` is the estimate's difference to the files.
pub(crate) fn report(
    state: &Corrected,
    file: &Parameters,
    outcome: &Outcome,
    change: &DVector<f64>,
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
        for i in group.indexes() {
            let (further, deviation) = outcome.alone[i];
            let freed = freed.is_some() || group.always_free();
            let value = total(i) + if freed { 0.0 } else { further };
            let significant = value.abs() > SIGNIFICANT * deviation;
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
            findings.push(finding(group, worst, file, &total, &alternatives));
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

fn name(cause: Cause) -> &'static str {
    match cause {
        Cause::CameraTilt | Cause::CameraYaw => "camera.orientation",
        Cause::CameraPlace => "camera.position",
        Cause::ImuTurn => "imu.orientation",
        Cause::ImuPlace => "imu.position",
        Cause::Marker(i) => {
            ["markers.red", "markers.green", "markers.blue", "markers.yellow"][i.min(3)]
        }
        Cause::Focal => "camera_info: focal length",
        Cause::Principal => "camera_info: principal point",
        Cause::Distortion => "camera_info: distortion",
        Cause::LayoutScale => "markers: scale",
        Cause::RailX => "climber.rail_x scale",
        Cause::RailY => "climber.rail_y scale",
        Cause::TurnScale => "climber.turn scale",
        Cause::GyroScale => "gyroscope scale",
        Cause::AccelerometerScale => "accelerometer scale",
        Cause::ClimberClock => "climber clock",
        Cause::ImuClock => "imu clock",
        Cause::Readout => "clock.image_readout",
    }
}

/// Sentence and remedy of a cause.
fn finding(
    group: &Group,
    verdict: Verdict,
    file: &Parameters,
    total: &dyn Fn(usize) -> f64,
    alternatives: &[Cause],
) -> Finding {
    let of = |k: usize| total(group.first + k) * group.unit.1;
    let percent = || format!("{:+.1} %", 100.0 * total(group.first).exp_m1());
    let vector = || {
        let parts: Vec<String> =
            (0..group.count.min(3)).map(|k| format!("{:+.1}", of(k))).collect();
        format!("({}) {}", parts.join(", "), group.unit.0)
    };
    let (mut text, remedy) = match group.cause {
        Cause::CameraTilt => (
            format!("camera.orientation is tilted by {} about the climber's x and y", vector()),
            "run `volant calibrate rig`, or level the camera",
        ),
        Cause::CameraYaw => (
            format!(
                "camera.orientation is turned by {:+.1}° about the vertical, or the zero of the joint `turn` is off by it",
                of(0)
            ),
            "correct camera.orientation in the rig file, or `zero.turn` of climber_driver",
        ),
        Cause::CameraPlace => (
            format!("camera.position is off by {}", vector()),
            "measure the camera's place on the climber from the axis of its turn",
        ),
        Cause::ImuTurn => (
            format!("imu.orientation is off by {} about the platform's x, y, z", vector()),
            "run `volant calibrate rig`, or mount the IMU parallel to the platform",
        ),
        Cause::ImuPlace => (
            format!("imu.position is off by {}", vector()),
            "measure from the platform's origin to the IMU, in meters",
        ),
        Cause::Marker(i) => (
            format!("the {} marker is off by {}", MarkerColor::ALL[i.min(3)], vector()),
            "measure this marker's place on the platform again",
        ),
        Cause::Focal => (
            format!(
                "camera_info: the focal length is off: it would be right changed by {}",
                percent()
            ),
            "run `volant calibrate camera`; was camera_info made for another resolution or lens?",
        ),
        Cause::Principal => (
            format!("camera_info: the principal point is off by {}", vector()),
            "run `volant calibrate camera`; are the images cropped?",
        ),
        Cause::Distortion => (
            "camera_info: the distortion coefficients do not fit the images".to_owned(),
            "run `volant calibrate camera`; the order is k1, k2, p1, p2, k3 (plumb_bob) or k1, k2, \
             k3, k4 (equidistant)",
        ),
        Cause::LayoutScale => (
            format!(
                "the marker layout has the wrong size: it would be right changed by {}",
                percent()
            ),
            "measure the distances between the markers again; was the sheet printed to scale?",
        ),
        Cause::RailX | Cause::RailY | Cause::TurnScale => {
            let joint = match group.cause {
                Cause::RailX => "rail_x",
                Cause::RailY => "rail_y",
                _ => "turn",
            };
            (
                format!(
                    "the scale of the joint `{joint}` is off: true motion is {:.4} of its reading",
                    1.0 + total(group.first)
                ),
                "correct the joint's scale in climber_driver's parameters (`volant calibrate climber`)",
            )
        }
        Cause::GyroScale | Cause::AccelerometerScale => (
            format!("the {} is off by {}", name(group.cause), vector()),
            "check the IMU's unit and range; have it calibrated",
        ),
        Cause::ClimberClock => (
            format!(
                "the encoders' stamps are {:+.1} ms from the images', and clock.climber_offset is \
                 {} s",
                -(of(0) + group.unit.1 * file.climber_clock),
                file.climber_clock
            ),
            "stamp the encoders when they are sampled, or correct clock.climber_offset",
        ),
        Cause::ImuClock => (
            format!("the IMU's stamps are {:+.1} ms from the images'", of(0)),
            "synchronize the clocks, or stamp the images at mid-exposure",
        ),
        Cause::Readout => {
            let readout = file.readout + total(group.first);
            if readout.abs() < group.sizes[0] {
                let text = format!(
                    "the images show no rolling shutter, but clock.image_readout is {} s",
                    file.readout
                );
                (text, "set clock.image_readout of pose_fusion to 0")
            } else {
                let text = format!(
                    "the camera has a rolling shutter: it takes {readout:.4} s from the first row to \
                     the last, and clock.image_readout is {} s",
                    file.readout
                );
                (text, "set clock.image_readout of pose_fusion to it, or use a global shutter")
            }
        }
    };
    if !alternatives.is_empty() {
        let names: Vec<&str> = alternatives.iter().map(|c| name(*c)).collect();
        text = format!("{text} (or {})", names.join(", "));
    }
    Finding { verdict, ..Finding::wrong(name(group.cause), text, remedy) }
}
