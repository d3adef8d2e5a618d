//! Events that an operator should know of.

use crate::timeline::arrival::Source;
use rig_model::Stamp;
use thiserror::Error;

/// Event that an operator should know of.
#[derive(Clone, Debug, Error, PartialEq)]
#[allow(missing_docs, reason = "the message explains each variant and names its fields")]
pub enum Warning {
    #[error("{from} at {stamp}: {what} is not finite or out of range; the sample is rejected")]
    NotFinite { from: Source, stamp: Stamp, what: &'static str },
    #[error(
        "{from} at {stamp} is {age_s:.3} s older than the newest IMU sample and is rejected; check \
         latency and clocks, or increase `history`"
    )]
    TooOld { from: Source, stamp: Stamp, age_s: f64 },
    #[error(
        "{} at {stamp} is {behind_s:.3} s behind the images and is rejected: synchronize the clocks \
         of IMU and camera",
        Source::Imu
    )]
    BehindImages { stamp: Stamp, behind_s: f64 },
    #[error(
        "{from} at {stamp} is {ahead_s:.1} s after the newest IMU sample or image and is rejected: \
         check both, and the clocks"
    )]
    NotKept { from: Source, stamp: Stamp, ahead_s: f64 },
    #[error("{from}: the stamp is zero; its publisher must set header.stamp; rejected")]
    NoStamp { from: Source },
    #[error("{from} at {stamp} arrived twice; the second is rejected: look for a second publisher")]
    Duplicate { from: Source, stamp: Stamp },
    #[error(
        "{from} at {stamp} is {ahead_s:.3} s ahead of the IMU samples; rejected: \
         synchronize the clocks"
    )]
    Ahead { from: Source, stamp: Stamp, ahead_s: f64 },
    #[error(
        "{from} at {stamp} is {by_s:.3} s from the message before; rejected until another confirms \
         it: check its clock, or look for a second publisher"
    )]
    Jump { from: Source, stamp: Stamp, by_s: f64 },
    #[error("time jumped back by {by_s:.3} s; the filter reinitializes")]
    TimeJump { by_s: f64 },
    #[error(
        "the IMU's clock stepped by {by_s:+.3} s against that of camera and encoders, and the \
         time offset with it (unless `clock.camera` is 0): keep the clocks synchronized"
    )]
    ClockStep { by_s: f64 },
    #[error(
        "no IMU sample between {from} and {to}; check the IMU's cable and driver and the computer's \
         load"
    )]
    ImuGap { from: Stamp, to: Stamp },
    #[error(
        "the IMU samples are stamped on arrival, in bursts of {samples:.1} every {every_s:.3} s, and \
         are treated as equally spaced: stamp each sample when it is taken, or set the serial \
         adapter's latency timer to 1 ms; a second publisher looks the same"
    )]
    ImuBursts { samples: f64, every_s: f64 },
    #[error(
        "the IMU's own attitude at {stamp} deviates by {:.1}° from that of the markers and is not \
         used: increase the driver's orientation covariance (orientation_stddev.tilt) to what \
         holds during a swing, and check imu.orientation",
        angle_rad.to_degrees()
    )]
    ImuAttitude { stamp: Stamp, angle_rad: f64 },
    #[error(
        "no IMU sample since {since}; the pose continues from images: check the IMU's cable and \
         driver"
    )]
    ImuLost { since: Stamp },
    #[error("initialized from the image at {stamp}")]
    Initialized { stamp: Stamp },
    #[error("camera time offset {offset_s:+.4} s (image time + offset = IMU time)")]
    TimeOffset { offset_s: f64 },
    #[error(
        "the images since {since} contradict the prediction: a shock that the IMU missed; process \
         noise is added from the last used image to {stamp}"
    )]
    Shock { since: Stamp, stamp: Stamp },
    #[error(
        "the markers contradict the estimate since {since} and are consistent with each other; \
         reinitialized from the image at {stamp}"
    )]
    LockOutRecovered { since: Stamp, stamp: Stamp },
    #[error(
        "the encoder reading at {stamp} contradicts the estimate by {}; the encoders are not used \
         until they are consistent with it again",
        contradiction(*distance_m, *turn_rad)
    )]
    EncodersSuspended { stamp: Stamp, distance_m: f64, turn_rad: f64 },
    #[error(
        "the encoders repeat one reading since {since}, and the images show that the climber moves: \
         they may be stuck, and are not used until they are consistent with the estimate again"
    )]
    EncodersStuck { since: Stamp },
    #[error("the encoders are consistent with the estimate again at {stamp} and are used")]
    EncodersResumed { stamp: Stamp },
    #[error(
        "the encoders at {stamp} still contradict the estimate, after climber.step_timeout or after \
         they were stuck; they are adopted and the pose reinitializes; check whether they \
         were homed"
    )]
    EncoderStep { stamp: Stamp },
    #[error("the pose at {stamp} is lost: {reason}")]
    PoseLost { stamp: Stamp, reason: String },
    #[error(
        "the estimate at {stamp} diverged: {what}; the filter reinitializes; look for the cause \
         with `volant check`"
    )]
    Diverged { stamp: Stamp, what: &'static str },
}

/// Describes by how much an encoder reading contradicts the estimate: its distance, or its turn
/// where the rails agree to a millimeter.
fn contradiction(distance_m: f64, turn_rad: f64) -> String {
    if distance_m < 1e-3 {
        format!("its turn alone, {turn_rad:.3} rad (is it published in radians?)")
    } else {
        format!("{distance_m:.3} m")
    }
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
            | Self::NotKept { from, .. }
            | Self::Jump { from, .. } => Some(*from),
            Self::BehindImages { .. } => Some(Source::Imu),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_contradiction_of_the_turn_is_no_distance() {
        let text = |distance_m| {
            let stamp = Stamp::default();
            Warning::EncodersSuspended { stamp, distance_m, turn_rad: 0.31 }.to_string()
        };
        assert!(text(0.25).contains("by 0.250 m;"), "{}", text(0.25));
        assert!(text(1e-5).contains("by its turn alone, 0.310 rad (is"), "{}", text(1e-5));
    }
}
