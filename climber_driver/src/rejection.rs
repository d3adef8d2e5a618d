//! Why a reading was rejected.

use crate::config::Axis;
use rig_model::Stamp;
use thiserror::Error;

/// A rejected reading; the last accepted one remains valid.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Rejection {
    /// The message's arrays `name` and `position` differ in length.
    #[error(
        "joint_states: {names} names but {positions} positions; the publisher must fill both alike"
    )]
    LengthMismatch {
        /// Number of names.
        names: usize,
        /// Number of positions.
        positions: usize,
    },
    /// None of many messages had a configured joint.
    #[error(
        "joint_states: the messages have {found}, but none of {configured}; \
         set the parameters joints.rail_x, joints.rail_y and joints.turn to the names in the \
         messages"
    )]
    OtherJoints {
        /// Joint names in the last message.
        found: String,
        /// Configured joint names.
        configured: String,
    },
    /// One configured joint is missing while another one is present.
    #[error(
        "joint_states: the joint `{joint}` ({axis}) is missing; \
         publish all three joints in one message, or set the parameter joints.{axis} to its name"
    )]
    MissingJoint {
        /// Configured joint name.
        joint: String,
        /// Axis that the joint measures.
        axis: Axis,
    },
    /// A joint occurs twice in one message.
    #[error("joint_states: the joint `{joint}` occurs twice in one message; name each joint once")]
    DuplicateJoint {
        /// Joint name.
        joint: String,
    },
    /// A position is NaN or infinite.
    #[error("joint_states: `{joint}` is {value}; check the encoder")]
    NotFinite {
        /// Joint name.
        joint: String,
        /// The position in the message.
        value: f64,
    },
    /// The stamp is zero.
    #[error("joint_states: the stamp is zero; its publisher must set header.stamp")]
    NoStamp,
    /// The stamp is not later than the last accepted one.
    #[error(
        "joint_states: stamp {stamp} is not after the last accepted one, {last}; \
         send each reading once and in order"
    )]
    NotNewer {
        /// Stamp of this reading.
        stamp: Stamp,
        /// Stamp of the last accepted reading.
        last: Stamp,
    },
    /// The reading is older than `max_age` on receipt.
    #[error(
        "joint_states: {age:.3} s old on arrival, more than max_age = {limit} s; \
         check network and clocks"
    )]
    Stale {
        /// Receipt − stamp, s.
        age: f64,
        /// `max_age`, s.
        limit: f64,
    },
    /// The stamp lies more than `max_ahead` after the receipt.
    #[error(
        "joint_states: stamped {ahead:.3} s after its receipt, more than max_ahead = {limit} s; \
         check the two clocks"
    )]
    FromTheFuture {
        /// Stamp − receipt, s.
        ahead: f64,
        /// `max_ahead`, s.
        limit: f64,
    },
    /// An axis moved faster than the crane can.
    #[error(
        "joint_states: {axis} jumped by {jump:.4} {} in {seconds:.3} s, \
         faster than `max_speed.{}` = {limit} {}/s; check the encoder, or raise the limit",
        axis.unit(),
        axis.limit_name(),
        axis.unit()
    )]
    Jump {
        /// The axis.
        axis: Axis,
        /// Change since the last accepted reading, m (rad).
        jump: f64,
        /// Time within which it changed, s.
        seconds: f64,
        /// Speed limit of the axis, m/s (rad/s).
        limit: f64,
    },
}

impl Rejection {
    /// Short name under which rejections are counted.
    pub const fn kind(&self) -> &'static str {
        match self {
            Self::LengthMismatch { .. } => "length mismatch",
            Self::OtherJoints { .. } => "other joints",
            Self::MissingJoint { .. } => "missing joint",
            Self::DuplicateJoint { .. } => "duplicate joint",
            Self::NotFinite { .. } => "not finite",
            Self::NoStamp => "no stamp",
            Self::NotNewer { .. } => "not newer",
            Self::Stale { .. } => "stale",
            Self::FromTheFuture { .. } => "from the future",
            Self::Jump { .. } => "jump",
        }
    }
}
