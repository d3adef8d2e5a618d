//! Calibration of the climber's encoders from a jog over a platform that rests on the floor.
//!
//! The markers are then fixed in the world, and the images show where the climber is against the
//! platform. The world's x axis is the direction of one rail, its y axis that of the other, z is
//! up. The rail nearest to the climber's own x axis at the start of the recording is x: start with
//! the climber turned to within 45° of where its turn is zero. What the images do not show is
//! reported as unobservable: an axis that did not move, and, without the platform's position in the
//! world, the readings at the world's origin and the height.

mod assign;
mod fit;
#[cfg(test)]
mod tests;

use crate::recording::all_detected;
use nalgebra::{Isometry3, Vector2, Vector3};
use rig_model::{
    CameraModel, JointReading, MarkerObservations, PerColor, Rig, Stamp,
    planar_pose::{self, TiltPrior},
};
use thiserror::Error;

/// Axes of the climber in the order of [`ClimberCalibration::axes`].
pub const AXES: [&str; 3] = ["rail_x", "rail_y", "turn"];

/// Fewest images with all four markers.
const FEWEST: usize = 60;
/// Images that are evaluated, spread evenly over the recording.
const MOST: usize = 600;
/// Largest gap between readings that is interpolated, s.
const GAP: f64 = 0.3;
/// Largest number of steps of the fit.
const ROUNDS: usize = 40;
/// Largest RMS of the pixel residuals, px: several times that of a rig file measured with a tape.
const RESIDUAL: f64 = 4.0;

/// What a recording of a jog holds.
#[derive(Clone, Debug)]
pub struct Jog<'a> {
    /// The camera.
    pub camera: &'a CameraModel,
    /// The rig: marker layout and camera mounting.
    pub rig: &'a Rig,
    /// Marker observations.
    pub markers: &'a [MarkerObservations],
    /// Readings of the encoders.
    pub joints: &'a [JointReading],
    /// Names to prefer where two joints measure the same axis.
    pub preferred: [&'a str; 3],
    /// Position of the platform's origin in the world while it rests, m.
    pub platform: Option<Vector3<f64>>,
}

/// Why a recording does not calibrate the encoders, with numbers and the remedy.
#[derive(Clone, Debug, Error)]
#[error("{0}")]
pub struct ClimberError(String);

impl ClimberError {
    fn few_images(count: usize) -> Self {
        Self(format!(
            "only {count} images show all four markers while readings arrive; record the visible \
             platform and joint_states for ten seconds at least"
        ))
    }

    /// No joint follows a motion; `joint` explains most of it, `percent`.
    fn no_joint(motion: &str, joint: &str, percent: f64) -> Self {
        Self(format!(
            "the images show that the climber {motion}, but no joint in joint_states follows it \
             (the best one, `{joint}`, explains {percent:.0} %); is its encoder connected, and \
             did the platform rest?"
        ))
    }

    fn diverged() -> Self {
        Self("the fit does not converge; check the camera and the markers in the rig file".into())
    }
}

/// A value and its standard deviation.
pub type Value = (f64, f64);

/// Calibration of one joint: `axis = scale · (reading − zero)`.
#[derive(Clone, Debug, PartialEq)]
pub struct AxisCalibration {
    /// Name in joint_states.
    pub joint: String,
    /// Meters (radians) per unit of the reading.
    pub scale: Value,
    /// Reading at the world's origin; `None` where the recording does not show it.
    pub zero: Option<Value>,
}

/// Result of a jog.
#[derive(Clone, Debug, PartialEq)]
pub struct ClimberCalibration {
    /// Axes x, y and turn; `None` for one that did not move.
    pub axes: [Option<AxisCalibration>; 3],
    /// Height of the climber's frame above the world's origin, m.
    pub height: Option<Value>,
    /// Camera against the rig file, each `None` where the jog does not show it: x and y of
    /// `camera.position`, m.
    pub camera_offset: Option<[Value; 2]>,
    /// Rotation of the camera about the climber's x and y, rad.
    pub camera_tilt: Option<[Value; 2]>,
    /// Time to add to an image's stamp for that of the readings, s.
    pub time_offset: Value,
    /// Number of images.
    pub images: usize,
    /// RMS of the pixel residuals per axis, px.
    pub pixel_rms: f64,
}

/// An image with its readings.
struct Shot {
    time: f64,
    pixels: [Vector2<f64>; 4],
    /// Pose of the platform in the climber's frame, from this image alone.
    climber_from_volant: Isometry3<f64>,
}

/// Readings of one joint over time.
struct Series {
    name: String,
    /// Time (s since the first reading) and reading.
    points: Vec<(f64, f64)>,
}

impl Series {
    /// Interpolates the reading; `None` in a gap.
    fn at(&self, time: f64) -> Option<f64> {
        let after = self.points.partition_point(|p| p.0 < time).clamp(1, self.points.len() - 1);
        let (a, b) = (self.points[after - 1], self.points[after]);
        let near = |p: (f64, f64)| (p.0 - time).abs() < GAP;
        (near(a) && near(b)).then(|| a.1 + (b.1 - a.1) * (time - a.0) / (b.0 - a.0))
    }
}

/// Determines joint names, signs, scales, zeros and height from a jog.
///
/// # Errors
/// Too few images, no axis that moves, a motion that no joint follows, or a fit that does not
/// converge or leaves large residuals.
pub fn calibrate_climber(jog: &Jog<'_>) -> Result<ClimberCalibration, ClimberError> {
    calibrate_within(jog, ROUNDS)
}

fn calibrate_within(jog: &Jog<'_>, rounds: usize) -> Result<ClimberCalibration, ClimberError> {
    let images = images(jog.markers);
    let (mut series, start) = series(jog.joints);
    let covered =
        |s: &Series| images.iter().filter(|o| s.at(o.stamp.seconds_since(start)).is_some()).count();
    // A joint that is published rarely or in part is another device's, and costs no images.
    let most = series.iter().map(covered).max().unwrap_or(0);
    series.retain(|s| 2 * covered(s) >= most);
    let shots = shots(jog, &images, &series, start);
    if shots.len() < FEWEST {
        return Err(ClimberError::few_images(shots.len()));
    }
    let assigned = assign::assign(&shots, &series, &jog.preferred)?;
    fit::fit(jog, &shots, &series, &assigned, rounds)
}

/// Readings per joint that varies, and the stamp of the first message.
fn series(joints: &[JointReading]) -> (Vec<Series>, Stamp) {
    let mut joints: Vec<&JointReading> = joints.iter().collect();
    joints.sort_by_key(|j| j.stamp);
    let start = joints.first().map(|j| j.stamp).unwrap_or_default();
    let mut series: Vec<Series> = vec![];
    for message in joints {
        let time = message.stamp.seconds_since(start);
        for (name, &position) in message.names.iter().zip(&message.positions) {
            let known = series.iter().position(|s| s.name == *name);
            let index = known.unwrap_or_else(|| {
                series.push(Series { name: name.clone(), points: vec![] });
                series.len() - 1
            });
            let points = &mut series[index].points;
            if position.is_finite() && points.last().is_none_or(|last| last.0 < time) {
                points.push((time, position));
            }
        }
    }
    series.retain(|s| s.points.len() > 1 && s.points.iter().any(|p| p.1 != s.points[0].1));
    (series, start)
}

/// Images that show all four markers, sorted by time, at most [`MOST`].
fn images(markers: &[MarkerObservations]) -> Vec<&MarkerObservations> {
    let mut seen: Vec<_> = markers.iter().filter(|o| all_detected(o)).collect();
    seen.sort_by_key(|o| o.stamp);
    let step = seen.len().div_ceil(MOST).max(1);
    seen.into_iter().step_by(step).collect()
}

/// Images during which every joint has readings.
fn shots(
    jog: &Jog<'_>,
    images: &[&MarkerObservations],
    series: &[Series],
    start: Stamp,
) -> Vec<Shot> {
    // The platform rests, and the camera looks down as the rig file says: this decides between the
    // two poses that fit an image of four points in a plane.
    let tilt = TiltPrior {
        up_in_volant: Vector3::z(),
        up_in_camera: jog.rig.climber_from_camera.rotation.inverse() * Vector3::z(),
        sigma: 0.005,
    };
    let shots = images.iter().filter_map(|o| {
        let time = o.stamp.seconds_since(start);
        series.iter().all(|s| s.at(time).is_some()).then_some(())?;
        let measured = PerColor(o.markers.0.map(|m| Some((m.centroid, m.covariance))));
        let layout = &jog.rig.markers;
        let poses = planar_pose::candidates(layout, jog.camera, &measured, Some(&tilt));
        Some(Shot {
            time,
            pixels: o.markers.0.map(|m| m.centroid),
            climber_from_volant: jog.rig.climber_from_camera * poses.first()?.camera_from_volant,
        })
    });
    shots.collect()
}
