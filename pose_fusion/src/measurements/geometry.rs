//! Geometry of the rig in the form that the updates need.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rig_model::{CameraModel, MarkerLayout, Rig};

/// Where camera, IMU and markers are mounted.
#[derive(Clone, Debug)]
pub struct Geometry {
    /// Camera model.
    pub camera: CameraModel,
    /// Markers in the volant frame.
    pub markers: MarkerLayout,
    /// `volant` from `imu`.
    pub volant_from_imu: Isometry3<f64>,
    /// `imu` from `volant`.
    pub imu_from_volant: Isometry3<f64>,
    /// `climber` from `camera_optical`.
    pub climber_from_camera: Isometry3<f64>,
    /// Time from the exposure of the first row of an image to that of the last, s.
    pub readout: f64,
}

impl Geometry {
    /// Returns the geometry of a rig with a camera that exposes all rows at once.
    pub fn new(rig: &Rig, camera: CameraModel) -> Self {
        Self {
            camera,
            markers: rig.markers.clone(),
            volant_from_imu: rig.imu.volant_from_imu,
            imu_from_volant: rig.imu.volant_from_imu.inverse(),
            climber_from_camera: rig.climber_from_camera,
            readout: 0.0,
        }
    }

    /// Returns by how much later than the middle of the image a row is exposed, s.
    pub fn delay_of_row(&self, row: f64) -> f64 {
        self.readout * (row / f64::from(self.camera.size().1) - 0.5)
    }
}

/// Part of the climber's pose that its encoders do not measure: height, roll and pitch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClimberHeightTilt {
    /// Height of the climber's frame, m.
    pub height: f64,
    /// `world_from_climber` without the turn about the vertical.
    pub tilt: UnitQuaternion<f64>,
}

impl ClimberHeightTilt {
    /// Splits a pose into (x, y, turn) and the rest, so that
    /// `pose = T(x, y, height) · Rz(turn) · tilt` (swing–twist); `None` of a number not finite.
    pub fn split(pose: &Isometry3<f64>) -> Option<(Vector3<f64>, Self)> {
        let q = pose.rotation;
        let turn = 2.0 * q.k.atan2(q.w);
        let about_z = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
        let t = pose.translation.vector;
        let finite = t.iter().chain(&q.coords).all(|x| x.is_finite());
        let rest = Self { height: t.z, tilt: about_z.inverse() * q };
        finite.then_some((Vector3::new(t.x, t.y, turn), rest))
    }

    /// Returns `world_from_climber` of (x, y, turn) and the rest.
    pub fn join(&self, climber: &Vector3<f64>) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(climber.x, climber.y, self.height),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), climber.z) * self.tilt,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn split_and_join_are_inverse() {
        let pose = Isometry3::from_parts(
            Translation3::new(0.3, -0.2, 2.8),
            UnitQuaternion::from_euler_angles(0.02, -0.03, 2.9),
        );
        let (climber, rest) = ClimberHeightTilt::split(&pose).unwrap();
        let back = rest.join(&climber);
        assert!((back.translation.vector - pose.translation.vector).norm() < 1e-12);
        assert!(back.rotation.angle_to(&pose.rotation) < 1e-9);
    }
}
