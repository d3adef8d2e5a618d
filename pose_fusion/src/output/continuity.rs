//! Continuity of the published position: a correction of centimeters (a shock, a new time offset),
//! which a controller would answer with a jerk, is spread over several messages. The covariance
//! contains the distance that is left.

use super::Odometry;
use nalgebra::Isometry3;
use rig_model::Stamp;

/// Largest step of the position from one message to the next beside the motion, m (required: 3 mm).
const STEP: f64 = 0.002;
/// The step between messages further apart than this is not limited, s: two and a half periods of
/// the slowest IMU.
const SEQUENCE: f64 = 0.05;
/// A larger correction is a reinitialization, which a slow approach would only hide, m.
const REINITIALIZED: f64 = 0.2;

/// The last message.
#[derive(Clone, Debug, Default)]
pub struct Continuity {
    last: Option<(Stamp, Isometry3<f64>)>,
}

impl Continuity {
    /// Discards the last message: the next one is published as it is.
    pub fn reset(&mut self) {
        self.last = None;
    }

    /// Takes a message as it is: at the rate of images alone the velocity is not known well enough
    /// to tell a correction from the motion, and a limited position would lag behind.
    pub fn follow(&mut self, odometry: Odometry) -> Odometry {
        self.last = Some((odometry.stamp, odometry.world_from_volant));
        odometry
    }

    /// Limits the step from the last message to this one.
    pub fn limit(&mut self, mut odometry: Odometry) -> Odometry {
        let velocity = odometry.world_from_volant.rotation * odometry.linear_velocity;
        if let Some((stamp, pose)) = &self.last {
            let dt = odometry.stamp.seconds_since(*stamp);
            let expected = pose.translation.vector + velocity * dt;
            let step = odometry.world_from_volant.translation.vector - expected;
            let distance = step.norm();
            if (0.0..SEQUENCE).contains(&dt) && (STEP..REINITIALIZED).contains(&distance) {
                let left = step * (1.0 - STEP / distance);
                odometry.displace(&-left);
            }
        }
        self.follow(odometry)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix6, UnitQuaternion, Vector3};

    fn at(ms: i64, x: f64) -> Odometry {
        Odometry {
            stamp: Stamp::from_nanos(ms * 1_000_000),
            world_from_volant: Isometry3::from_parts(
                Vector3::new(x, 0.0, 1.0).into(),
                UnitQuaternion::identity(),
            ),
            pose_covariance: Matrix6::identity() * 1e-6,
            linear_velocity: Vector3::new(0.5, 0.0, 0.0),
            angular_velocity: Vector3::zeros(),
            twist_covariance: Matrix6::zeros(),
        }
    }

    #[test]
    fn a_correction_is_spread_over_messages_and_the_covariance_contains_what_is_left() {
        let mut continuity = Continuity::default();
        let x = |o: &Odometry| o.world_from_volant.translation.x;
        let mut last = continuity.limit(at(0, 0.0));
        for k in 1..20 {
            let truth = 0.5 * 0.01 * k as f64 + 0.02;
            let now = continuity.limit(at(10 * k, truth));
            assert!((x(&now) - x(&last) - 0.005).abs() < STEP + 1e-9);
            let left = truth - x(&now);
            assert!(left * left <= now.pose_covariance[(0, 0)], "{k}");
            assert_eq!(left < 1e-9, k >= 10, "{k} {left}");
            last = now;
        }
        let far = continuity.limit(at(210, 5.0));
        assert_eq!(x(&far), 5.0);
        let after_a_lost_sample = continuity.limit(at(250, 5.03));
        assert!((x(&after_a_lost_sample) - 5.022).abs() < 1e-9);
        let at_image_rate = continuity.follow(at(283, 5.05));
        assert_eq!(x(&at_image_rate), 5.05);
        assert_eq!(x(&continuity.limit(at(293, 5.056))), 5.056);
    }
}
