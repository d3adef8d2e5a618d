//! What travels between the nodes, as plain data: the core's side of every topic. The ROS message's side and the
//! conversion between them live in `node_kit::convert`.

use crate::{marker::PerColor, stamp::Stamp};
use nalgebra::{Isometry3, Matrix2, Matrix3, UnitQuaternion, Vector2, Vector3};

/// One sample of the inertial unit, in its own axes (`imu`).
#[derive(Clone, Debug, PartialEq)]
pub struct ImuSample {
    /// When it was measured.
    pub stamp: Stamp,
    /// Specific force, m/s²: +9.81 upwards at rest (REP-145).
    pub specific_force: Vector3<f64>,
    /// Rate of turn, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// The unit's own estimate of its attitude, where it gives one.
    pub orientation: Option<OrientationSample>,
}

/// The attitude that an inertial unit computes by itself.
#[derive(Clone, Debug, PartialEq)]
pub struct OrientationSample {
    /// East-north-up from the unit's axes; the heading is unknown against `world`.
    pub enu_from_imu: UnitQuaternion<f64>,
    /// Covariance of the rotation error about the ENU axes, rad²; `None` where the message left it unknown.
    pub covariance: Option<Matrix3<f64>>,
}

/// Where the climber is, from its encoders.
#[derive(Clone, Debug, PartialEq)]
pub struct ClimberSample {
    /// When the encoders were read.
    pub stamp: Stamp,
    /// `world` from `climber`.
    pub world_from_climber: Isometry3<f64>,
}

/// How an image coordinate of a marker came to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MarkerState {
    /// Measured in this image, and only if the measurement tells the whole square's centroid.
    Detected,
    /// Occluded; placed by the flow of the others (the paper's eq. 3), for six images at most.
    Predicted,
    /// Not known; the coordinates are NaN.
    Lost,
}

/// One marker in one image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerObservation {
    /// Measured, predicted or lost.
    pub state: MarkerState,
    /// Images since it was last detected: 0 when detected, [`MarkerObservation::NEVER`] if it never was.
    pub occluded_frames: u16,
    /// Area centroid of the marker's image, raw (distorted) pixels, (x right, y down); NaN when lost.
    pub centroid: Vector2<f64>,
    /// Covariance of the centroid, px².
    pub covariance: Matrix2<f64>,
    /// Area of the marker's image, px²; 0 unless detected.
    pub area: f32,
}

impl MarkerObservation {
    /// `occluded_frames` of a marker that was never seen.
    pub const NEVER: u16 = u16::MAX;

    /// A marker of which nothing is known.
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

/// All markers of the rig in one image.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerObservations {
    /// Middle of the image's exposure.
    pub stamp: Stamp,
    /// One per colour, in the order of [`crate::MarkerColor::ALL`].
    pub markers: PerColor<MarkerObservation>,
}
