//! Encoders: exchanged or reversed rails, rails in millimeters, a reversed turn, and a camera
//! turned by a right angle.
//!
//! The adjustment with a free matrix between rail readings and world axes is nearly linear: it
//! converges from the identity to any exchange or reversal.

use super::{
    Corrected,
    findings::Finding,
    groups::Cause,
    select::{self, MISFIT},
};
use crate::{
    CalibrationError,
    adjustment::Adjustment,
    initial::first_states,
    parameters::{CLIMBER_CLOCK, Parameters, RAILS, TURN_SCALE},
    recording::{Recording, heading},
};
use nalgebra::{DMatrix, Isometry3, Matrix2, Translation3, UnitQuaternion, Vector3};

/// Standard deviation of the matrix' entries and of the turn's factor, and the largest one with
/// which they are known.
const WIDE: f64 = 2.0;
const KNOWN: f64 = 0.25;
/// Largest distance of an entry from 0 or ±1.
const NEAR: f64 = 0.4;
/// Scale of the rails below which they are not in meters.
const OTHER_UNIT: f64 = 0.2;
/// Standard deviation of the climber's clock, s.
const CLOCK: f64 = 0.3;

/// Examines and corrects signs and order of the encoders; returns whether anything is wrong.
pub(crate) fn examine(
    state: &mut Corrected,
    recording: &Recording,
) -> Result<bool, CalibrationError> {
    let Some(first) = Solved::of(state, recording)? else { return Ok(false) };
    let scale = first.parameters.rails.determinant().abs().sqrt();
    if first.known(RAILS.start) && first.known(RAILS.start + 3) && scale < OTHER_UNIT {
        let finding = Finding::wrong(
            "climber.rail.unit",
            format!(
                "the rails' readings are not in meters: the climber drives {scale:.2e} of what \
                 they report"
            ),
            "multiply `scale.rail_x` and `scale.rail_y` of climber_driver by it, or let the \
             encoders' driver publish m (sensor_msgs/JointState, REP-103); then check again",
        );
        state.findings.push(Finding { blocks: true, ..finding });
        return Ok(false);
    }
    // A large turn is not linear: with the wrong sign the adjustment may end beside the solution.
    let mut reversed = first.known(TURN_SCALE) && (first.parameters.turn_scale + 1.0).abs() < NEAR;
    if !reversed && first.misfit > MISFIT {
        let mut other = state.clone();
        change(&mut other, |place, turn| (place, -turn));
        let mut turned = Recording::new(&other.samples)?;
        turned.shots = recording.shots.clone();
        let second = Solved::of(&other, &turned)?;
        reversed = second.is_some_and(|s| s.misfit < 0.5 * first.misfit);
    }
    if reversed {
        state.findings.push(Finding::wrong(
            "climber.turn",
            "the joint `turn` is reversed: the climber turns the other way than it reports",
            "change the sign of `turn` in climber_driver's parameters",
        ));
        change(state, |place, turn| (place, -turn));
        // The rails' directions were estimated with the wrong turn.
        return Ok(true);
    }
    let at = RAILS.start;
    Ok((at..at + 4).all(|i| first.known(i)) && rails(state, &first.parameters.rails))
}

/// Estimate with free encoders.
struct Solved {
    parameters: Parameters,
    covariance: DMatrix<f64>,
    /// Squared residual per degree of freedom.
    misfit: f64,
}

impl Solved {
    fn of(state: &Corrected, recording: &Recording) -> Result<Option<Self>, CalibrationError> {
        let start = Parameters::new(&state.rig, recording);
        let states = first_states(recording, &start)?;
        let freed = [Cause::Focal, Cause::LayoutScale];
        let mut priors = select::priors(start.camera.distortion(), &freed, false);
        priors[RAILS].fill(WIDE);
        priors[TURN_SCALE] = WIDE;
        priors[CLIMBER_CLOCK] = CLOCK;
        let freedom = 8.0 * states.len() as f64;
        let mut work = Adjustment::new(recording, start, states, priors);
        work.iterations = 15;
        let solved = work.solve().ok().zip(work.data_cost());
        Ok(solved.map(|((covariance, _), cost)| Self {
            parameters: work.parameters,
            covariance,
            misfit: cost / freedom,
        }))
    }

    fn known(&self, i: usize) -> bool {
        self.covariance[(i, i)].sqrt() < KNOWN
    }
}

/// Interprets the matrix and corrects it.
fn rails(state: &mut Corrected, matrix: &Matrix2<f64>) -> bool {
    let nearest = matrix.map(|m| m.round().clamp(-1.0, 1.0));
    let signed = nearest * nearest.transpose() == Matrix2::identity();
    if !signed || nearest == Matrix2::identity() || (matrix - nearest).amax() > NEAR {
        return false;
    }
    if nearest.determinant() > 0.0 {
        // The world's x axis may point anywhere: rather than the rails, the camera is turned.
        let turn = nearest[(1, 0)].atan2(nearest[(0, 0)]);
        let camera = &mut state.rig.climber_from_camera;
        camera.rotation =
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -turn) * camera.rotation;
        let also = if nearest[(0, 0)] < -0.5 {
            "both rails are reversed"
        } else {
            "the rails are exchanged and one is reversed"
        };
        state.findings.push(Finding::wrong(
            "camera.orientation",
            format!(
                "camera.orientation is turned by {:.0}° about the vertical (or {also})",
                turn.to_degrees()
            ),
            "drive the climber along +x: the platform must leave the image as camera.orientation \
             says; correct it in the rig file",
        ));
        return true;
    }
    let (key, text) = match (nearest[(0, 0)] as i32, nearest[(1, 1)] as i32) {
        (-1, 1) => ("climber.rail_x", "the joint `rail_x` is reversed"),
        (1, -1) => ("climber.rail_y", "the joint `rail_y` is reversed"),
        _ if nearest[(0, 1)] > 0.0 => {
            ("climber.rail_x", "the joints `rail_x` and `rail_y` are exchanged")
        }
        _ => ("climber.rail_x", "the joints `rail_x` and `rail_y` are exchanged and reversed"),
    };
    state.findings.push(Finding::wrong(
        key,
        format!("{text}: the platform moves otherwise than the encoders report"),
        "correct the joint's name or sign in climber_driver's parameters",
    ));
    change(state, |place, turn| {
        let xy = nearest * place.xy();
        (Vector3::new(xy.x, xy.y, place.z), turn)
    });
    true
}

/// Changes position and turn of every climber pose.
fn change(state: &mut Corrected, f: impl Fn(Vector3<f64>, f64) -> (Vector3<f64>, f64)) {
    for sample in &mut state.samples.climber {
        let pose = &sample.world_from_climber;
        let (place, turn) = f(pose.translation.vector, heading(&pose.rotation));
        sample.world_from_climber = Isometry3::from_parts(
            Translation3::from(place),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn),
        );
    }
}
