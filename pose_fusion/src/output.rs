//! What the filter says: the types that leave [`crate::Fusion`].

use nalgebra::{Isometry3, Matrix2, Matrix3, Matrix6, Vector2, Vector3};
use rig_model::{MarkerColor, Stamp};
use std::fmt;
use thiserror::Error;

/// One thing that the filter says.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // odometry is what nearly always comes, and a box would be an allocation each
pub enum Output {
    /// The fused estimate; with `tight` one for each inertial sample and with its stamp, with `paper` one for each image.
    Odometry(Odometry),
    /// `world_from_volant` from one image alone, rotation about world-fixed axes.
    VisualPose(PoseEstimate),
    /// What became of one marker of one image.
    MarkerUpdate(MarkerUpdateRecord),
    /// Something that an operator should know; counted in [`crate::Status`] as well.
    Warning(Warning),
}

/// The fused estimate at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Odometry {
    /// The instant.
    pub stamp: Stamp,
    /// The platform's pose, m.
    pub world_from_volant: Isometry3<f64>,
    /// Covariance of (x, y, z, rotation about the fixed world axes x, y, z); m², m·rad, rad².
    pub pose_covariance: Matrix6<f64>,
    /// Velocity of the platform's origin against the world, in the volant frame, m/s.
    pub linear_velocity: Vector3<f64>,
    /// Rate of turn against the world, in the volant frame, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Covariance of (linear, angular velocity), both in the volant frame.
    pub twist_covariance: Matrix6<f64>,
}

impl Odometry {
    /// The same estimate as the platform sees it: `volant_from_world` with its covariance, whose rotation block is
    /// about the axes of the volant frame (the frame that the message is stamped in).
    ///
    /// With `R_true = Exp(δ) R`, `p_true = p + ε` (δ, ε in world axes) the inverse pose has, to first order,
    /// `δ' = −Rᵀ δ` and `ε' = −Rᵀ ε − Rᵀ [p]× δ`.
    pub fn fused_pose(&self) -> PoseEstimate {
        let pose = self.world_from_volant.inverse();
        let rt: Matrix3<f64> = *pose.rotation.to_rotation_matrix().matrix();
        let p = self.world_from_volant.translation.vector;
        let mut jacobian = Matrix6::zeros();
        jacobian.fixed_view_mut::<3, 3>(0, 0).copy_from(&-rt);
        jacobian.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-rt * p.cross_matrix()));
        jacobian.fixed_view_mut::<3, 3>(3, 3).copy_from(&-rt);
        let covariance = jacobian * self.pose_covariance * jacobian.transpose();
        PoseEstimate { stamp: self.stamp, pose, covariance: (covariance + covariance.transpose()) * 0.5 }
    }
}

/// A pose with its covariance.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseEstimate {
    /// The instant.
    pub stamp: Stamp,
    /// `parent_from_child`.
    pub pose: Isometry3<f64>,
    /// Covariance of (x, y, z, rotation about the parent's fixed axes); m², m·rad, rad².
    pub covariance: Matrix6<f64>,
}

/// What became of a marker in an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MarkerOutcome {
    /// It updated the state.
    Used,
    /// The tracker did not measure it in this image (predicted or lost).
    NotDetected,
    /// Its innovation is too unlikely on its own.
    Gated,
    /// It contradicts the other markers of the image.
    Inconsistent,
    /// The predicted marker is outside of what the lens model covers.
    NotPredictable,
    /// Nothing to compare it with yet.
    NotInitialised,
    /// The image is older than the history, or was seen already.
    Refused,
    /// The filter is frozen: compared, but not used.
    Frozen,
}

impl MarkerOutcome {
    /// A short name for messages and logs.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Used => "used",
            Self::NotDetected => "not detected",
            Self::Gated => "gated",
            Self::Inconsistent => "contradicts the others",
            Self::NotPredictable => "outside the lens model",
            Self::NotInitialised => "filter not initialised",
            Self::Refused => "refused",
            Self::Frozen => "frozen",
        }
    }
}

impl fmt::Display for MarkerOutcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What became of one marker of one image, used or not.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerUpdateRecord {
    /// The image's stamp.
    pub stamp: Stamp,
    /// Which marker.
    pub color: MarkerColor,
    /// Measured minus predicted centroid, px; NaN where there is none.
    pub innovation: Vector2<f64>,
    /// Covariance of the innovation, px²; NaN where there is none.
    pub covariance: Matrix2<f64>,
    /// Normalised innovation squared (2 degrees of freedom); NaN where there is none.
    pub nis: f64,
    /// Used, or why not.
    pub outcome: MarkerOutcome,
}

/// Something that an operator should know.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Warning {
    /// A number that is not finite or cannot be.
    #[error("{source_name} at {stamp}: {what} is not a usable number; the sample is refused")]
    NotFinite {
        /// Which input.
        source_name: &'static str,
        /// Its stamp.
        stamp: Stamp,
        /// Which field.
        what: &'static str,
    },
    /// An input older than what was already processed and than the history reaches.
    #[error(
        "{source_name} at {stamp} is {age_s:.3} s older than the newest inertial sample; the history does not reach back so far, it is refused"
    )]
    TooOld {
        /// Which input.
        source_name: &'static str,
        /// Its stamp.
        stamp: Stamp,
        /// How much older than the newest inertial sample.
        age_s: f64,
    },
    /// The same stamp twice.
    #[error("{source_name} at {stamp} came twice; the second is refused")]
    Duplicate {
        /// Which input.
        source_name: &'static str,
        /// Its stamp.
        stamp: Stamp,
    },
    /// An input from the future of all others.
    #[error(
        "{source_name} at {stamp} is {ahead_s:.3} s ahead of the inertial samples; refused: check that the clocks agree"
    )]
    Ahead {
        /// Which input.
        source_name: &'static str,
        /// Its stamp.
        stamp: Stamp,
        /// How far ahead.
        ahead_s: f64,
    },
    /// Time went backwards (a looped bag, a restarted simulation): everything starts anew.
    #[error("time jumped back by {by_s:.3} s; the filter starts anew")]
    TimeJump {
        /// How far.
        by_s: f64,
    },
    /// No inertial sample for a while.
    #[error("no inertial sample between {from} and {to}; the gap is bridged with the last one")]
    InertialGap {
        /// The last before the gap.
        from: Stamp,
        /// The first after it.
        to: Stamp,
    },
    /// The filter started.
    #[error("started at {stamp}")]
    Initialised {
        /// The image it started from.
        stamp: Stamp,
    },
    /// Most markers contradicted the estimate for several images and agreed with each other: restarted from them.
    #[error(
        "the markers agreed with each other but not with the estimate since {since}; started anew from the image at {stamp}"
    )]
    LockOutRecovered {
        /// The first image that was refused.
        since: Stamp,
        /// The image it started from.
        stamp: Stamp,
    },
    /// The estimate is no longer worth much: no marker for too long.
    #[error("no marker since {since}: position uncertain by {position_sigma_m:.3} m (1 sigma, largest axis)")]
    VisionLost {
        /// The last image that was used.
        since: Stamp,
        /// Largest standard deviation of the position.
        position_sigma_m: f64,
    },
    /// Numerical trouble; the state is dropped.
    #[error("the estimate at {stamp} is not finite any more; the filter starts anew")]
    Diverged {
        /// When.
        stamp: Stamp,
    },
}

impl Warning {
    /// A short name of the kind, to throttle and to count by.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::NotFinite { .. } => "not_finite",
            Self::TooOld { .. } => "too_old",
            Self::Duplicate { .. } => "duplicate",
            Self::Ahead { .. } => "ahead",
            Self::TimeJump { .. } => "time_jump",
            Self::InertialGap { .. } => "inertial_gap",
            Self::Initialised { .. } => "initialised",
            Self::LockOutRecovered { .. } => "lock_out_recovered",
            Self::VisionLost { .. } => "vision_lost",
            Self::Diverged { .. } => "diverged",
        }
    }
}
