//! The true pose at any instant, between the samples of a recorded truth.

use crate::Stamp;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// Two samples of truth farther apart than this (s) have no truth between them.
const LARGEST_GAP: f64 = 0.1;

/// One sample of the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TruthSample {
    /// When.
    pub stamp: Stamp,
    /// Where.
    pub world_from_volant: Isometry3<f64>,
    /// Velocity in the volant frame, m/s.
    pub linear_velocity: Vector3<f64>,
    /// Rate of turn in the volant frame, rad/s.
    pub angular_velocity: Vector3<f64>,
}

/// The true motion.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth(Vec<TruthSample>);

impl Truth {
    /// From samples in any order; of two with one stamp the first counts, samples that are not
    /// finite are left out.
    pub fn new(mut samples: Vec<TruthSample>) -> Self {
        samples.retain(|s| s.world_from_volant.to_homogeneous().iter().all(|x| x.is_finite()));
        samples.sort_by_key(|s| s.stamp);
        samples.dedup_by_key(|s| s.stamp);
        Self(samples)
    }

    /// First and last stamp.
    pub fn span(&self) -> Option<(Stamp, Stamp)> {
        Some((self.0.first()?.stamp, self.0.last()?.stamp))
    }

    /// The truth at an instant: position by a cubic through the four samples around it (a line at
    /// the ends), rotation on the great circle, velocities on a line. `None` outside, or in a gap.
    pub fn at(&self, stamp: Stamp) -> Option<TruthSample> {
        let after = self.0.partition_point(|s| s.stamp < stamp);
        let b = self.0.get(after)?;
        if b.stamp == stamp {
            return Some(*b);
        }
        let a = self.0.get(after.checked_sub(1)?)?;
        let width = b.stamp.seconds_since(a.stamp);
        if width > LARGEST_GAP {
            return None;
        }
        let t = stamp.seconds_since(a.stamp) / width;
        let position = self.cubic(after, stamp).unwrap_or_else(|| {
            a.world_from_volant.translation.vector.lerp(&b.world_from_volant.translation.vector, t)
        });
        let (qa, qb) = (a.world_from_volant.rotation, b.world_from_volant.rotation);
        // The exponential of the part of the difference: unlike a slerp it is defined for equal
        // ends.
        let rotation = qa * UnitQuaternion::from_scaled_axis((qa.inverse() * qb).scaled_axis() * t);
        Some(TruthSample {
            stamp,
            world_from_volant: Isometry3::from_parts(Translation3::from(position), rotation),
            linear_velocity: a.linear_velocity.lerp(&b.linear_velocity, t),
            angular_velocity: a.angular_velocity.lerp(&b.angular_velocity, t),
        })
    }

    /// Lagrange's polynomial through the samples `after - 2 ..= after + 1`.
    fn cubic(&self, after: usize, stamp: Stamp) -> Option<Vector3<f64>> {
        let nodes = self.0.get(after.checked_sub(2)?..after + 2)?;
        let times: Vec<f64> = nodes.iter().map(|s| s.stamp.seconds_since(stamp)).collect();
        if times[3] - times[0] > 3.0 * LARGEST_GAP {
            return None;
        }
        let mut position = Vector3::zeros();
        for (i, node) in nodes.iter().enumerate() {
            let mut weight = 1.0;
            for j in (0..4).filter(|j| *j != i) {
                weight *= times[j] / (times[j] - times[i]);
            }
            position += node.world_from_volant.translation.vector * weight;
        }
        Some(position)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn swing(t: f64) -> TruthSample {
        TruthSample {
            stamp: Stamp::from_nanos(1_700_000_000_000_000_000).plus_seconds(t),
            world_from_volant: Isometry3::new(
                Vector3::new((6.0 * t).sin(), t * t, 1.0),
                Vector3::new(0.0, 0.5 * (3.0 * t).sin(), 0.0),
            ),
            linear_velocity: Vector3::new(t, 0.0, 0.0),
            angular_velocity: Vector3::zeros(),
        }
    }

    #[test]
    fn a_swing_sampled_at_200_hz_is_known_in_between() {
        let truth = Truth::new((0..400).rev().map(|i| swing(f64::from(i) * 0.005)).collect());
        for t in [0.0, 0.0031, 0.5, 0.7777, 1.9949] {
            let (found, expected) = (truth.at(swing(t).stamp).unwrap(), swing(t));
            let error = found.world_from_volant.translation.vector
                - expected.world_from_volant.translation.vector;
            // At the ends it is a line: x'' h²/8.
            let bound =
                if !(0.005..=1.99).contains(&t) { 36.0 * 0.005 * 0.005 / 8.0 } else { 1e-6 };
            assert!(error.norm() <= bound, "{t}: {}", error.norm());
            let angle =
                found.world_from_volant.rotation.angle_to(&expected.world_from_volant.rotation);
            assert!(angle < 0.5 * 9.0 * 0.005 * 0.005 / 8.0 + 1e-9, "{t}: {angle}");
            assert!((found.linear_velocity.x - t).abs() < 1e-6);
        }
        assert_eq!(truth.at(swing(-0.001).stamp), None);
        assert_eq!(truth.at(swing(2.1).stamp), None);
    }

    #[test]
    fn there_is_no_truth_in_a_gap_and_none_from_nan() {
        let mut nan = swing(0.05);
        nan.world_from_volant.translation.vector.x = f64::NAN;
        let truth = Truth::new(vec![swing(0.0), nan, swing(0.3), swing(0.35)]);
        assert_eq!(truth.at(swing(0.1).stamp), None);
        assert!(truth.at(swing(0.32).stamp).is_some());
    }
}
