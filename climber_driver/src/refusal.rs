//! Why a reading was not believed.

use crate::config::Axis;
use rig_model::Stamp;
use thiserror::Error;

/// A reading that was refused: the climber's pose stays what it was.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Refusal {
    /// Names and positions do not belong together.
    #[error("joint_states: {names} names but {positions} positions; the publisher must fill both alike")]
    LengthMismatch {
        /// How many names.
        names: usize,
        /// How many positions.
        positions: usize,
    },
    /// A joint of ours is not among the names, though another of ours is.
    #[error(
        "joint_states: the joint `{joint}` ({axis}) is missing; set the parameter joints.{axis} to its name"
    )]
    MissingJoint {
        /// The name looked for.
        joint: String,
        /// The axis that it tells.
        axis: Axis,
    },
    /// A joint stands in the message twice.
    #[error("joint_states: the joint `{joint}` stands in one message twice; name each joint once")]
    DuplicateJoint {
        /// The name.
        joint: String,
    },
    /// NaN or infinity.
    #[error("joint_states: `{joint}` is {value}; check the encoder")]
    NotFinite {
        /// The joint.
        joint: String,
        /// What stood there.
        value: f64,
    },
    /// Not younger than the last one.
    #[error(
        "joint_states: stamped {stamp}, which is not after the last accepted one, {last}; send each reading once and in order"
    )]
    NotNewer {
        /// Of this reading.
        stamp: Stamp,
        /// Of the last accepted one.
        last: Stamp,
    },
    /// Too old on arrival.
    #[error(
        "joint_states: {age:.3} s old on arrival, more than max_age = {limit} s; check network and clocks"
    )]
    Stale {
        /// Receipt − stamp, s.
        age: f64,
        /// The limit, s.
        limit: f64,
    },
    /// From the future.
    #[error(
        "joint_states: stamped {ahead:.3} s after its receipt, more than max_ahead = {limit} s; check the two clocks"
    )]
    FromTheFuture {
        /// Stamp − receipt, s.
        ahead: f64,
        /// The limit, s.
        limit: f64,
    },
    /// Faster than the crane can move.
    #[error(
        "joint_states: {axis} jumped by {jump:.4} {} in {seconds:.3} s, faster than max_speed.{axis} = {limit}; check the encoder",
        axis.unit()
    )]
    Jump {
        /// The axis.
        axis: Axis,
        /// Change since the last accepted reading, m (rad).
        jump: f64,
        /// Time since the last accepted reading, s.
        seconds: f64,
        /// The axis' speed limit, m/s (rad/s).
        limit: f64,
    },
}

impl Refusal {
    /// A short name to count by.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::LengthMismatch { .. } => "length mismatch",
            Self::MissingJoint { .. } => "missing joint",
            Self::DuplicateJoint { .. } => "duplicate joint",
            Self::NotFinite { .. } => "not finite",
            Self::NotNewer { .. } => "not newer",
            Self::Stale { .. } => "stale",
            Self::FromTheFuture { .. } => "from the future",
            Self::Jump { .. } => "jump",
        }
    }
}
