//! Plain data exchanged between the nodes.
//!
//! `node_kit::convert` converts them from and to ROS messages.

use crate::{camera::CameraModel, marker::PerColor, stamp::Stamp};
use nalgebra::{Isometry3, Matrix2, Matrix3, UnitQuaternion, Vector2, Vector3};

/// Sample of the IMU, in the frame `imu`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Time of measurement.
    pub stamp: Stamp,
    /// Specific force, m/s²: +9.81 upwards at rest (REP-145).
    pub specific_force: Vector3<f64>,
    /// Angular velocity, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Orientation estimated by the IMU, if it outputs one.
    pub orientation: Option<OrientationSample>,
}

/// Orientation estimated by the IMU itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrientationSample {
    /// Rotation from `imu` to east-north-up; its heading relative to `world` is unknown.
    pub enu_from_imu: UnitQuaternion<f64>,
    /// Covariance of the rotation error about the ENU axes, rad²; `None` if unknown.
    pub covariance: Option<Matrix3<f64>>,
}

/// Pose of the climber, from its encoders.
#[derive(Clone, Debug, PartialEq)]
pub struct ClimberSample {
    /// Time of the encoder sample.
    pub stamp: Stamp,
    /// Transform from `climber` to `world`.
    pub world_from_climber: Isometry3<f64>,
}

/// Joint positions at one instant: `sensor_msgs/JointState` without velocity and effort.
#[derive(Clone, Debug, PartialEq)]
pub struct JointReading {
    /// Time of the encoder sample.
    pub stamp: Stamp,
    /// Joint names.
    pub names: Vec<String>,
    /// Encoder readings in the order of `names`, in units of the joint.
    pub positions: Vec<f64>,
}

/// Origin of a marker's image coordinates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MarkerState {
    /// Measured in this image, and valid for the centroid of the whole square.
    Detected,
    /// Occluded; predicted from the platform's rigid motion (or the other markers' mean flow,
    /// paper, eq. 3) for at most `max_predicted` images.
    Predicted,
    /// Unknown; the coordinates are NaN.
    Lost,
}

/// Observation of one marker in one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerObservation {
    /// Detected, predicted or lost.
    pub state: MarkerState,
    /// Images since the last detection: 0 if detected, [`MarkerObservation::NEVER`] if never.
    pub occluded_frames: u16,
    /// Area centroid of the marker's image, raw (distorted) px, x right, y down; NaN if lost.
    pub centroid: Vector2<f64>,
    /// Covariance of the centroid, px².
    pub covariance: Matrix2<f64>,
    /// Area of the marker's image, px²; 0 unless detected.
    pub area: f32,
}

impl MarkerObservation {
    /// `occluded_frames` of a marker that was never detected.
    pub const NEVER: u16 = u16::MAX;

    /// Observation of a measured marker: centroid, px, its covariance, px², and area, px².
    pub fn detected(centroid: Vector2<f64>, covariance: Matrix2<f64>, area: f64) -> Self {
        let (state, area) = (MarkerState::Detected, area as f32);
        Self { state, occluded_frames: 0, centroid, covariance, area }
    }

    /// Observation of a hidden marker at a predicted centroid, px, with its covariance, px².
    pub fn predicted(
        occluded_frames: u16,
        centroid: Vector2<f64>,
        covariance: Matrix2<f64>,
    ) -> Self {
        Self { state: MarkerState::Predicted, occluded_frames, centroid, covariance, area: 0.0 }
    }

    /// Observation of a lost marker.
    pub fn lost(occluded_frames: u16) -> Self {
        Self {
            state: MarkerState::Lost,
            occluded_frames,
            centroid: Vector2::repeat(f64::NAN),
            covariance: Matrix2::zeros(),
            area: 0.0,
        }
    }
}

/// Observations of all markers in one image.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerObservations {
    /// Middle of the exposure.
    pub stamp: Stamp,
    /// One observation per color, in the order of [`crate::MarkerColor::ALL`].
    pub markers: PerColor<MarkerObservation>,
}

/// One input of the estimator.
#[derive(Clone, Debug, PartialEq)]
pub enum Sample {
    /// IMU sample.
    Imu(ImuSample),
    /// Markers of one image.
    Markers(MarkerObservations),
    /// Pose of the climber.
    Climber(ClimberSample),
    /// Calibration of the camera.
    Camera(CameraModel),
}
