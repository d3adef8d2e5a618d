//! Initial states of the bundle adjustment from single images.

use crate::{CalibrationError, parameters::Parameters, problem::State, recording::Recording};
use nalgebra::{Isometry3, Vector3};
use rig_model::{PerColor, planar_pose};

/// Estimates a pose per image, with "up" from the mean specific force around it, and velocities by
/// differences.
///
/// # Errors
/// No pose fits the first image, or most poses are behind the camera.
pub(super) fn first_states(
    recording: &Recording,
    p: &Parameters,
) -> Result<Vec<State>, CalibrationError> {
    let mut poses: Vec<Isometry3<f64>> = Vec::with_capacity(recording.shots.len());
    let mut in_front = 0;
    let mounting = p.rig.imu.volant_from_imu.rotation;
    for shot in &recording.shots {
        let near = |t: f64| (t - shot.time - p.camera_clock).abs() < 0.02;
        let force: Vector3<f64> = recording.imu.iter().filter(|s| near(s.0)).map(|s| s.1).sum();
        let climber = p.world_from_climber(recording, shot.time);
        let world_from_camera = climber * p.rig.climber_from_camera;
        let tilt = force.try_normalize(1e-3).map(|up| planar_pose::TiltPrior {
            up_in_volant: mounting * up,
            up_in_camera: world_from_camera.rotation.inverse() * Vector3::z(),
            sigma: 0.15,
        });
        let measured =
            PerColor(std::array::from_fn(|i| Some((shot.pixels[i], shot.covariances[i]))));
        let found = planar_pose::candidates(&p.layout, &p.camera, &measured, tilt.as_ref());
        let pose = match found.first() {
            Some(best) => world_from_camera * best.camera_from_volant,
            None => *poses.last().ok_or(CalibrationError::NoPose)?,
        };
        in_front += usize::from((world_from_camera.inverse() * pose).translation.z > 0.0);
        poses.push(pose);
    }
    let arm = p.rig.imu.volant_from_imu.translation.vector;
    let place = |k: usize| poses[k].translation.vector + poses[k].rotation * arm;
    let last = poses.len() - 1;
    if in_front * 2 <= poses.len() {
        return Err(CalibrationError::Behind);
    }
    Ok((0..poses.len())
        .map(|k| {
            let (a, b) = (k.saturating_sub(1), (k + 1).min(last));
            let velocity =
                (place(b) - place(a)) / (recording.shots[b].time - recording.shots[a].time);
            State { pose: poses[k], velocity }
        })
        .collect())
}
