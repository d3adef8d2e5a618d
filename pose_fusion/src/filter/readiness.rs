//! What the initialization waits for.

use super::Filter;
use crate::timeline::arrival::{AHEAD, Source};
use rig_model::topics;

/// Messages that come further behind the IMU samples are not just late, s.
const BEHIND: f64 = 1.0;

impl Filter {
    /// Returns which clocks differ.
    fn clocks_apart(&self) -> Option<String> {
        let camera = self.setup.camera_offset;
        let encoders = camera + self.setup.config.clock.climber_offset;
        [(Source::Image, camera), (Source::Encoders, encoders)].into_iter().find_map(
            |(source, offset)| {
                let ahead = self.arrival.ahead_of_imu(source)? + offset;
                let side = if ahead > 0.0 { "after" } else { "before" };
                (!(-BEHIND..=AHEAD).contains(&ahead)).then(|| {
                    format!(
                        "{source} is stamped {:.1} s {side} {}: synchronize the clocks",
                        ahead.abs(),
                        Source::Imu
                    )
                })
            },
        )
    }

    /// Returns the topics without a usable message, which the initialization waits for.
    pub fn absent(&self) -> Vec<&'static str> {
        let camera = self.setup.geometry.is_none().then_some(topics::CAMERA_INFO);
        let imu = self.arrival.newest_imu().is_none().then_some(topics::IMU);
        let climber = self.climber.newest().is_none().then_some(topics::CLIMBER_TRANSFORM);
        [camera, imu, climber].into_iter().flatten().collect()
    }

    /// Returns what the initialization waits for; empty where there is a pose.
    pub fn missing(&self) -> String {
        if self.is_started() {
            return String::new();
        }
        let missing = self.absent();
        if let Some(apart) = self.clocks_apart() {
            apart
        } else if !missing.is_empty() {
            format!("no message on {}", missing.join(", "))
        } else if self.setup.frozen {
            "markers are not used: call ~/freeze with false, or ~/reset".to_owned()
        } else if let Some(force) = self.start.wrong_gravity {
            format!(
                "{}: linear_acceleration is {force:.2} m/s^2 upward on average, not {:.2}: its \
                 unit (not g), sign, orientation, gravity removed?",
                topics::IMU,
                self.setup.config.gravity
            )
        } else if self.climber.leaps_now() {
            format!(
                "{}: the readings leap further than a climber moves: encoder, scale, second \
                 publisher?",
                topics::CLIMBER_TRANSFORM
            )
        } else if self.start.ambiguity.is_some() {
            "three markers allow several poses: waiting for the fourth marker or for motion"
                .to_owned()
        } else {
            "no image with three markers that fit together".to_owned()
        }
    }
}
