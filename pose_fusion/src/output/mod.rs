//! Outputs of the estimators.

pub mod continuity;
#[cfg(feature = "messages")]
pub mod messages;
pub mod odometry;
pub mod prediction;
pub mod rate_limit;
pub mod smoother;
pub mod swing;
mod warning;

pub use swing::Swing;
pub use warning::Warning;

use crate::{health::pose_status::PoseStatus, measurements::Innovation};
use nalgebra::{Isometry3, Matrix6, Vector3, Vector6};
use rig_model::{PerColor, Stamp, score::inverse};

/// One output.
#[derive(Clone, Debug, PartialEq)]
// Nearly every output is odometry, and a box would be an allocation each.
#[allow(clippy::large_enum_variant)]
pub enum Output {
    /// Fused estimate: per IMU sample (`tight`), or per image (`paper`, or without IMU).
    Odometry(Odometry),
    /// Status of the estimate, after each odometry.
    Status(PoseStatus),
    /// Estimate `prediction_horizon` ahead, after each odometry.
    Predicted(Odometry),
    /// The platform relative to the climber, after each odometry of `tight`.
    Swing(Swing),
    /// `world_from_volant` from one image alone, rotation about world-fixed axes.
    VisualPose(PoseEstimate),
    /// Records of the markers of one image.
    MarkerUpdates(MarkerUpdates),
    /// Event that an operator should know of; counted in [`crate::Status`] as well.
    Warning(Warning),
}

/// Fused estimate at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Odometry {
    /// Time.
    pub stamp: Stamp,
    /// Pose of the platform, m.
    pub world_from_volant: Isometry3<f64>,
    /// Covariance of (x, y, z, rotation about the fixed world axes x, y, z); m², m·rad, rad².
    pub pose_covariance: Matrix6<f64>,
    /// Velocity of the platform's origin against the world, in the volant frame, m/s.
    pub linear_velocity: Vector3<f64>,
    /// Angular velocity against the world, in the volant frame, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Covariance of (linear, angular velocity), both in the volant frame.
    pub twist_covariance: Matrix6<f64>,
}

impl Odometry {
    /// Returns the inverse pose `volant_from_world` with its covariance, whose rotation block is
    /// about the axes of the volant frame (the frame that the message is stamped in).
    pub fn fused_pose(&self) -> PoseEstimate {
        let (pose, covariance) = inverse(&self.world_from_volant, &self.pose_covariance);
        PoseEstimate {
            stamp: self.stamp,
            pose,
            covariance: (covariance + covariance.transpose()) * 0.5,
        }
    }

    /// Moves the position, world, m; the covariance contains it.
    pub(crate) fn displace(&mut self, by: &Vector3<f64>) {
        self.world_from_volant.translation.vector += by;
        let mut block = self.pose_covariance.fixed_view_mut::<3, 3>(0, 0);
        block += by * by.transpose();
    }

    /// Adds the distance between encoders and estimate (x, y, m; turn, rad) to the covariance of a
    /// pose that moves with a climber at `climber` (x, y, m; turn, rad).
    pub(crate) fn add_disagreement(&mut self, by: &Vector3<f64>, climber: &Vector3<f64>) {
        let place = self.world_from_volant.translation.vector;
        let arm = Vector3::new(place.x - climber.x, place.y - climber.y, 0.0);
        let moved = Vector3::new(by.x, by.y, 0.0) + Vector3::z().cross(&arm) * by.z;
        let off = Vector6::new(moved.x, moved.y, moved.z, 0.0, 0.0, by.z);
        self.pose_covariance += off * off.transpose();
    }
}

/// Returns the largest standard deviation of the position (`first` 0, m) or rotation (`first` 3,
/// rad) of a pose's covariance.
pub(crate) fn largest_sigma(covariance: &Matrix6<f64>, first: usize) -> f64 {
    let block = covariance.fixed_view::<3, 3>(first, first).into_owned();
    block.symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// Pose with its covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseEstimate {
    /// Time.
    pub stamp: Stamp,
    /// `parent_from_child`.
    pub pose: Isometry3<f64>,
    /// Covariance of (x, y, z, rotation about the parent's fixed axes); m², m·rad, rad².
    pub covariance: Matrix6<f64>,
}

/// Records of the markers of one image, used or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerUpdates {
    /// Stamp of the image.
    pub stamp: Stamp,
    /// Innovations (measured minus predicted centroid, px) and what became of them.
    pub markers: PerColor<Innovation<2>>,
}
