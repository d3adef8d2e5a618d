//! State of the published pose: whether a controller may use it, and why not.

use crate::config::StatusConfig;
use rig_model::Stamp;
use std::borrow::Cow;

/// Why the pose comes from images alone where no IMU sample is accepted.
pub const NO_IMU_SAMPLE: &str = "no usable IMU sample";
/// Reason of a pose that images contradict again and again.
pub const CONTRADICTED_REASON: &str = "images contradict the IMU or the encoders: check units, \
                            signs, orientations and frames (`volant check` names the cause)";
/// Reason of a pose that images have not confirmed yet.
pub const NEW_REASON: &str = "a new pose, which images have not confirmed yet";
/// Reason of a pose without images that they contradicted shortly before.
pub const UNCONFIRMED_REASON: &str =
    "no image used, and the last ones contradicted the IMU or the encoders";

/// What carries the pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum PoseState {
    /// No pose yet, or one that the images after its first have not confirmed.
    Initializing = 0,
    /// Images and IMU samples are used.
    Tracking = 1,
    /// No image was used for `status.max_image_age`; IMU samples carry the pose.
    Coasting = 2,
    /// No usable IMU samples; the pose comes from images.
    VisionOnly = 3,
    /// The pose must not be used.
    Lost = 4,
}

/// Status published with every odometry.
#[derive(Clone, Debug, PartialEq)]
pub struct PoseStatus {
    /// Stamp of the odometry.
    pub stamp: Stamp,
    /// What carries the pose.
    pub state: PoseState,
    /// The pose may be used: tracking, coasting or vision only, with both sigmas in limits.
    pub valid: bool,
    /// Largest standard deviation of the position, m.
    pub position_sigma: f64,
    /// Largest standard deviation of the rotation, rad.
    pub rotation_sigma: f64,
    /// Time since the newest used image, s; infinite if none.
    pub image_age: f64,
    /// Time since the newest IMU sample, s; infinite if none.
    pub imu_age: f64,
    /// Time since the newest used encoder reading, s; infinite if none.
    pub climber_age: f64,
    /// Markers used of that image.
    pub markers_used: u8,
    /// Camera time offset, s (image time + offset = IMU time).
    pub time_offset: f64,
    /// Why the state is not tracking or the pose not valid; empty otherwise.
    pub reason: String,
}

impl PoseStatus {
    /// Returns the status where there is no pose yet; camera time offset in s.
    pub fn initializing(stamp: Stamp, time_offset: f64, reason: String) -> Self {
        Self {
            stamp,
            state: PoseState::Initializing,
            valid: false,
            position_sigma: f64::INFINITY,
            rotation_sigma: f64::INFINITY,
            image_age: f64::INFINITY,
            imu_age: f64::INFINITY,
            climber_age: f64::INFINITY,
            markers_used: 0,
            time_offset,
            reason,
        }
    }

    /// Returns the status of a lost pose, or of one that is not judged yet; ages of image, IMU
    /// sample and encoder reading, and camera time offset, s.
    pub fn lost(stamp: Stamp, ages: [f64; 3], time_offset: f64, reason: String) -> Self {
        let [image_age, imu_age, climber_age] = ages;
        Self {
            state: PoseState::Lost,
            image_age,
            imu_age,
            climber_age,
            ..Self::initializing(stamp, time_offset, reason)
        }
    }

    /// Fills in state, validity and reason from the ages and sigmas. `without_imu` is why the pose
    /// comes from images alone and for how long it has, s, if it does; `unusable` is the state and
    /// the reason of a pose that must not be used whatever its sigmas.
    pub fn judged(
        mut self,
        config: &StatusConfig,
        without_imu: Option<(&str, f64)>,
        unusable: Option<(PoseState, Cow<'static, str>)>,
    ) -> Self {
        // A sigma that is no number is beyond every limit.
        let beyond = |sigma: f64, limit: f64| sigma.is_nan() || sigma > limit;
        let beyond_position = beyond(self.position_sigma, config.max_position_sigma);
        let beyond_rotation = beyond(self.rotation_sigma, config.max_rotation_sigma);
        let lost = beyond(self.position_sigma, config.lost_position_sigma);
        let mirrored = without_imu.filter(|_| self.markers_used < 4);
        self.state = if let Some((state, _)) = unusable {
            state
        } else if lost || mirrored.is_some() {
            PoseState::Lost
        } else if without_imu.is_some() {
            PoseState::VisionOnly
        } else if self.image_age > config.max_image_age {
            PoseState::Coasting
        } else {
            PoseState::Tracking
        };
        let usable = !matches!(self.state, PoseState::Initializing | PoseState::Lost);
        self.valid = usable && !beyond_position && !beyond_rotation;
        let lasting = |what: &str, age: f64| {
            if age.is_finite() { format!("{what} for {age:.2} s") } else { what.to_owned() }
        };
        self.reason = match (unusable, mirrored, without_imu) {
            (Some((_, why)), ..) => why.into_owned(),
            (_, Some((why, _)), _) => {
                format!("{why}, and fewer than four markers: they fit two tilts")
            }
            (.., Some((why, age))) if self.state == PoseState::VisionOnly => lasting(why, age),
            _ if self.image_age > config.max_image_age && self.state != PoseState::Tracking => {
                lasting("no image used", self.image_age)
            }
            _ if lost && !beyond_position => format!(
                "position sigma {:.3} m above lost_position {} m",
                self.position_sigma, config.lost_position_sigma
            ),
            _ => String::new(),
        };
        for (beyond, what, sigma, limit, name) in [
            (beyond_position, "position", self.position_sigma, config.max_position_sigma, "m"),
            (beyond_rotation, "rotation", self.rotation_sigma, config.max_rotation_sigma, "rad"),
        ] {
            if beyond {
                let join = if self.reason.is_empty() { "" } else { "; " };
                self.reason += &format!(
                    "{join}{what} sigma {sigma:.3} {name} above status.max_{what}_sigma {limit} {name}"
                );
            }
        }
        self
    }
}

/// Time between two status messages without odometry, s.
pub const STATUS_PERIOD: f64 = 0.1;

/// Schedules the status at 10 Hz of data time, given the stamp of the last one.
#[derive(Clone, Debug, Default)]
pub struct StatusTimer(pub Option<Stamp>);

impl StatusTimer {
    /// Returns whether a status is due at an instant, and notes it: a period after the last one,
    /// and after a jump of time.
    pub fn is_due(&mut self, now: Stamp) -> bool {
        let since = self.0.map_or(f64::INFINITY, |last| now.seconds_since(last));
        let due = !(0.0..STATUS_PERIOD).contains(&since);
        self.0 = if due { Some(now) } else { self.0 };
        due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(change: impl FnOnce(&mut PoseStatus), without_imu: bool) -> PoseStatus {
        let mut status = PoseStatus::initializing(Stamp::from_nanos(0), 0.0, String::new());
        (status.position_sigma, status.rotation_sigma) = (0.001, 0.001);
        (status.image_age, status.imu_age, status.climber_age) = (0.04, 0.0, 0.01);
        status.markers_used = 4;
        change(&mut status);
        let without_imu = without_imu.then_some((NO_IMU_SAMPLE, status.imu_age));
        status.judged(&StatusConfig::default(), without_imu, None)
    }

    #[test]
    fn each_state_has_its_reason() {
        use PoseState::{Coasting, Lost, Tracking, VisionOnly};
        type Case = (fn(&mut PoseStatus), bool, PoseState, bool, &'static str);
        let cases: [Case; 7] = [
            (|_| {}, false, Tracking, true, ""),
            (|s| s.image_age = 0.4, false, Coasting, true, "0.40 s"),
            (|s| s.imu_age = 0.3, true, VisionOnly, true, "IMU"),
            (|s| s.markers_used = 3, true, Lost, false, "two tilts"),
            (|s| s.markers_used = 3, false, Tracking, true, ""),
            (|s| s.rotation_sigma = 0.3, false, Tracking, false, "status.max_rotation_sigma"),
            (|s| (s.position_sigma, s.image_age) = (0.5, 3.0), false, Lost, false, "for 3.00 s"),
        ];
        for (change, vision_only, state, valid, reason) in cases {
            let status = judged(change, vision_only);
            assert_eq!((status.state, status.valid), (state, valid), "{status:?}");
            assert!(status.reason.contains(reason), "{status:?}");
            assert_eq!(status.reason.is_empty(), reason.is_empty(), "{status:?}");
        }
        let tracking = judged(|_| {}, false);
        assert!(!judged(|s| s.position_sigma = f64::NAN, false).valid);
        let never = judged(|s| s.imu_age = f64::INFINITY, true);
        assert_eq!(never.reason, "no usable IMU sample");
        let config = StatusConfig { max_position_sigma: 1.0, ..StatusConfig::default() };
        let lost = PoseStatus { position_sigma: 0.5, ..tracking.clone() };
        let lost = lost.judged(&config, None, None);
        assert!(lost.state == PoseState::Lost && lost.reason.contains("lost_position"), "{lost:?}");
        for (state, reason) in [(Lost, CONTRADICTED_REASON), (PoseState::Initializing, NEW_REASON)]
        {
            let unusable = Some((state, reason.into()));
            let status = tracking.clone().judged(&StatusConfig::default(), None, unusable);
            assert_eq!((status.state, status.valid), (state, false));
            assert_eq!(status.reason, reason);
        }
    }
}
