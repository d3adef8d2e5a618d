//! Events that an operator should know of.

use crate::timeline::arrival::Source;
use rig_model::Stamp;
use thiserror::Error;

/// Event that an operator should know of.
#[derive(Clone, Debug, Error, PartialEq)]
#[allow(missing_docs, reason = "the message names each field")]
pub enum Warning {
    /// A number that is not finite or out of the sensor's range.
    #[error("{from} at {stamp}: {what} is not finite or out of range; the sample is rejected")]
    NotFinite { from: Source, stamp: Stamp, what: &'static str },
    /// An input older than the history.
    #[error(
        "{from} at {stamp} is {age_s:.3} s older than the newest IMU sample and is rejected; check \
         latency and clocks, or increase `history`"
    )]
    TooOld { from: Source, stamp: Stamp, age_s: f64 },
    /// No stamp.
    #[error("{from}: the stamp is zero; its publisher must set header.stamp; rejected")]
    NoStamp { from: Source },
    /// The same stamp twice.
    #[error(
        "{from} at {stamp} arrived twice; the second is rejected: look for a second \
         publisher"
    )]
    Duplicate { from: Source, stamp: Stamp },
    /// An input far ahead of all others.
    #[error(
        "{from} at {stamp} is {ahead_s:.3} s ahead of the IMU samples; rejected: \
         synchronize the clocks"
    )]
    Ahead { from: Source, stamp: Stamp, ahead_s: f64 },
    /// An image or encoder reading far from the one before, while there are no IMU samples.
    #[error(
        "{from} at {stamp} is {by_s:.3} s from the message before; rejected until another confirms \
         it: check its clock, or look for a second publisher"
    )]
    Jump { from: Source, stamp: Stamp, by_s: f64 },
    /// Time went backwards (a looped bag, a restarted simulation).
    #[error("time jumped back by {by_s:.3} s; the filter reinitializes")]
    TimeJump { by_s: f64 },
    /// The IMU's clock stepped against that of camera and encoders.
    #[error(
        "the IMU's clock stepped by {by_s:+.3} s against that of camera and encoders; the filter \
         reinitializes: keep both clocks synchronized (docs, Two computers)"
    )]
    ClockStep { by_s: f64 },
    /// No IMU sample for a while.
    #[error(
        "no IMU sample between {from} and {to}; check the IMU's cable and driver and the computer's \
         load"
    )]
    ImuGap { from: Stamp, to: Stamp },
    /// IMU samples have the stamps of their arrival.
    #[error(
        "the IMU samples are stamped on arrival, in bursts of {samples:.1} every {every_s:.3} s, and \
         are treated as equally spaced: stamp each sample when it is taken, or set the serial \
         adapter's latency timer to 1 ms; a second publisher looks the same"
    )]
    ImuBursts { samples: f64, every_s: f64 },
    /// The IMU's own attitude is off by more than it claims.
    #[error(
        "the IMU's own attitude at {stamp} deviates by {:.1}° from that of the markers and is not \
         used: increase the driver's orientation covariance (orientation_stddev.tilt) to what \
         holds during a swing, and check imu.orientation",
        angle_rad.to_degrees()
    )]
    ImuAttitude { stamp: Stamp, angle_rad: f64 },
    /// No IMU samples while images arrive.
    #[error(
        "no IMU sample since {since}; the pose continues from images: check the IMU's cable and \
         driver"
    )]
    ImuLost { since: Stamp },
    /// The filter was initialized.
    #[error("initialized from the image at {stamp}")]
    Initialized { stamp: Stamp },
    /// The camera time offset was initialized.
    #[error("camera time offset {offset_s:+.4} s (image time + offset = IMU time)")]
    TimeOffset { offset_s: f64 },
    /// A shock of the platform between two IMU samples.
    #[error(
        "the images since {since} contradict the prediction: a shock that the IMU missed; process \
         noise is added from the last used image to {stamp}"
    )]
    Shock { since: Stamp, stamp: Stamp },
    /// Most markers contradicted the estimate for several images and were consistent with each
    /// other.
    #[error(
        "the markers contradict the estimate since {since} and are consistent with each other; \
         reinitialized from the image at {stamp}"
    )]
    LockOutRecovered { since: Stamp, stamp: Stamp },
    /// The encoders contradict images and IMU.
    #[error(
        "the encoder reading at {stamp} contradicts the estimate by {distance_m:.3} m; the \
         encoders are not used until they are consistent with it again"
    )]
    EncodersSuspended { stamp: Stamp, distance_m: f64 },
    /// The encoders repeat one reading while the images show that the climber moves, or one stopped
    /// harder than a drive brakes.
    #[error(
        "the encoders repeat one reading since {since}: they stopped harder than a drive brakes, or \
         the images show that the climber moves. They may be frozen and are not used until they are \
         consistent with the estimate again"
    )]
    EncodersFrozen { since: Stamp },
    /// The encoders agree with the estimate again.
    #[error("the encoders are consistent with the estimate again at {stamp} and are used")]
    EncodersResumed { stamp: Stamp },
    /// The encoders have contradicted the estimate for too long and are adopted.
    #[error(
        "the encoders at {stamp} still contradict the estimate, after climber.step_timeout or after \
         they were frozen; they are adopted and the pose reinitializes; check whether they \
         were homed"
    )]
    EncoderStep { stamp: Stamp },
    /// The pose must not be used any more.
    #[error("the pose at {stamp} is lost: {reason}")]
    PoseLost { stamp: Stamp, reason: String },
    /// The state was not finite or beyond its bounds.
    #[error(
        "the estimate at {stamp} diverged: {what}; the filter reinitializes; look for the cause \
         with `volant check`"
    )]
    Diverged { stamp: Stamp, what: &'static str },
}

impl Warning {
    /// Returns where an input that is rejected is from.
    pub const fn origin(&self) -> Option<Source> {
        match self {
            Self::NotFinite { from, .. }
            | Self::TooOld { from, .. }
            | Self::NoStamp { from }
            | Self::Duplicate { from, .. }
            | Self::Ahead { from, .. }
            | Self::Jump { from, .. } => Some(*from),
            _ => None,
        }
    }
}
