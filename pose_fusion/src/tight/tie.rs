//! Is the climber's clock the camera's? Filters side by side tell, and until they do both answers are in the covariance.
//!
//! Mostly one computer stamps images and encoders: then `d = 0` exactly (see [`super::state`]). Where it is not so, `d` may be
//! anything within some [`Prior::sigma`]. Three filters take `d` as `c − h`, `c` and `c + h`. For a constant that is off, a
//! linear filter's estimate is linear in it and minus twice the logarithm of its likelihood is a parabola: so the three give
//! the likelihood of every `d` (the parabola through the three), and the estimate that a filter with any `d` would have made
//! (Lagrange's interpolation, which takes the climber's acceleration with it).
//!
//! How likely `d = 0` is after all data is told by the same parabola (Dickey 1971, "The weighted likelihood ratio"): the
//! Bayes factor is the free posterior's density at 0 over the prior's. What is said is then the estimate with `d = 0` while
//! that is likely, the one with the best `d` once it is not, and always with the second moments of both answers.
//!
//! A free `d` alone would cost accuracy where nothing is wrong (the climber's clock shows itself only where the climber
//! accelerates: to some ms within ten seconds, 1 mm at 0.3 m/s), and `d = 0` alone would lie where the clocks differ.

use crate::output::Odometry;
use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};

/// Distance between the three offsets, s.
pub const BESIDE: f64 = 0.025;
/// So much of the evidence counts: quantised readings are not as white as the filters take them. (With half of it one
/// simulated run of five left d = 0 for seconds though it was right, with a quarter none of ten.)
const SHARPNESS: f64 = 0.25;

/// An offset that is known worse than this (1 sigma, s) is in the covariance and moves no estimate.
const KNOWN: f64 = 0.012;

/// What is thought before the three filters' first datum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Probability that climber and camera have one clock.
    pub tied: f64,
    /// Where they have not: the likeliest offset, s.
    pub mean: f64,
    /// And its standard deviation, s.
    pub sigma: f64,
}

/// What is thought of the offset after the data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Belief {
    /// Probability that it is 0 exactly.
    pub tied: f64,
    /// Else: the likeliest, s.
    pub mean: f64,
    /// And its variance, s².
    pub variance: f64,
}

impl Prior {
    /// After evidence (minus twice the logarithm of the likelihood) of `centre − BESIDE`, `centre`, `centre + BESIDE`.
    pub fn after(&self, centre: f64, evidence: [f64; 3]) -> Belief {
        let [low, middle, high] = evidence;
        let bend = SHARPNESS * (high + low - 2.0 * middle) / (2.0 * BESIDE * BESIDE);
        let slope = SHARPNESS * (high - low) / (2.0 * BESIDE);
        let before = self.sigma.powi(-2);
        // Without a bend there is nothing but noise in the slope.
        let (precision, pull) = if bend > 0.0 && bend.is_finite() {
            (before + bend, self.mean * before + centre * bend - slope / 2.0)
        } else {
            (before, self.mean * before)
        };
        let (mean, variance) = (pull / precision, 1.0 / precision);
        let density = |mean: f64, variance: f64| (-mean * mean / (2.0 * variance)).exp() / variance.sqrt();
        let tied = self.tied * density(mean, variance.max(1e-8));
        let free = (1.0 - self.tied) * density(self.mean, self.sigma * self.sigma);
        let sum = tied + free;
        Belief { tied: if sum > 0.0 { tied / sum } else { 0.0 }, mean, variance }
    }

    /// Without any evidence.
    pub fn belief(&self) -> Belief {
        Belief { tied: self.tied, mean: self.mean, variance: self.sigma * self.sigma }
    }
}

impl Belief {
    /// Share of `d = 0` in what is said: all of it until it is refuted and the other offset is known to some ms.
    fn share(&self) -> f64 {
        let refuted = 1.0 - ((self.tied - 0.001) / 0.02).clamp(0.0, 1.0);
        let known = ((KNOWN - self.variance.sqrt()) / (0.5 * KNOWN)).clamp(0.0, 1.0);
        1.0 - refuted * known
    }

    /// Mean and standard deviation of both answers together, s.
    pub fn moments(&self) -> (f64, f64) {
        let mean = (1.0 - self.share()) * self.mean;
        let free = self.variance + (self.mean - mean).powi(2);
        (mean, (self.tied * mean * mean + (1.0 - self.tied) * free).sqrt())
    }

    /// As seen from a filter that takes the offset to be `centre`.
    #[must_use]
    pub fn about(&self, centre: f64) -> Belief {
        Belief { mean: self.mean - centre, ..*self }
    }

    /// Widens an estimate made with `d = 0`, where nothing but the way the platform goes with the climber is known: `motion`
    /// is that velocity and rate of turn (world).
    pub fn widen(&self, odometry: &mut Odometry, motion: &Vector6<f64>) {
        let variance = (1.0 - self.tied) * (self.variance + self.mean * self.mean);
        odometry.pose_covariance += motion * motion.transpose() * variance;
    }

    /// The estimate of both answers, from those of the three filters at one instant.
    pub fn mix(&self, centre: f64, [low, middle, high]: [&Odometry; 3]) -> Odometry {
        let curve = Curve::new(low, middle, high);
        let x = |offset: f64| (offset - centre).clamp(-3.0 * BESIDE, 3.0 * BESIDE);
        let (tied, free) = (curve.at(x(0.0)), curve.at(x(self.mean)));
        let share = self.share();
        let mean = Both {
            pose: tied.pose * share + free.pose * (1.0 - share),
            twist: tied.twist * share + free.twist * (1.0 - share),
        };
        let slope = curve.slope(x(self.mean));
        let square = |of: fn(&Both) -> Vector6<f64>| -> Matrix6<f64> {
            let (t, f, s) = (of(&tied) - of(&mean), of(&free) - of(&mean), of(&slope));
            t * t.transpose() * self.tied
                + (f * f.transpose() + s * s.transpose() * self.variance) * (1.0 - self.tied)
        };
        let mut said = middle.clone();
        let pose = &middle.world_from_volant;
        said.world_from_volant = Isometry3::from_parts(
            Translation3::from(pose.translation.vector + mean.pose.fixed_rows::<3>(0)),
            UnitQuaternion::from_scaled_axis(mean.pose.fixed_rows::<3>(3).into_owned()) * pose.rotation,
        );
        said.linear_velocity += mean.twist.fixed_rows::<3>(0);
        said.angular_velocity += mean.twist.fixed_rows::<3>(3);
        said.pose_covariance += square(|b| b.pose);
        said.twist_covariance += square(|b| b.twist);
        said
    }
}

/// By how much pose (world axes) and twist differ from the middle filter's.
#[derive(Clone, Copy)]
struct Both {
    pose: Vector6<f64>,
    twist: Vector6<f64>,
}

/// The parabola through the three estimates, by the offset's distance from the middle one.
struct Curve {
    first: Both,
    second: Both,
}

impl Curve {
    fn new(low: &Odometry, middle: &Odometry, high: &Odometry) -> Self {
        let away = |o: &Odometry| {
            let (a, b) = (&o.world_from_volant, &middle.world_from_volant);
            let six = |u: Vector3<f64>, v: Vector3<f64>| Vector6::new(u.x, u.y, u.z, v.x, v.y, v.z);
            Both {
                pose: six(
                    a.translation.vector - b.translation.vector,
                    (a.rotation * b.rotation.inverse()).scaled_axis(),
                ),
                twist: six(
                    o.linear_velocity - middle.linear_velocity,
                    o.angular_velocity - middle.angular_velocity,
                ),
            }
        };
        let (low, high) = (away(low), away(high));
        let first = |l: Vector6<f64>, h: Vector6<f64>| (h - l) / (2.0 * BESIDE);
        let second = |l: Vector6<f64>, h: Vector6<f64>| (h + l) / (2.0 * BESIDE * BESIDE);
        Self {
            first: Both { pose: first(low.pose, high.pose), twist: first(low.twist, high.twist) },
            second: Both { pose: second(low.pose, high.pose), twist: second(low.twist, high.twist) },
        }
    }

    fn at(&self, x: f64) -> Both {
        Both {
            pose: self.first.pose * x + self.second.pose * (x * x),
            twist: self.first.twist * x + self.second.twist * (x * x),
        }
    }

    fn slope(&self, x: f64) -> Both {
        Both {
            pose: self.first.pose + self.second.pose * (2.0 * x),
            twist: self.first.twist + self.second.twist * (2.0 * x),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_model::Stamp;

    const PRIOR: Prior = Prior { tied: 0.95, mean: 0.0, sigma: 0.05 };

    /// A platform that is carried along a bent way, seen with the climber's clock off by `offset`.
    fn seen(offset: f64) -> Odometry {
        let (speed, bend, turn) = (0.3, 0.2, 0.1);
        Odometry {
            stamp: Stamp::from_nanos(0),
            world_from_volant: Isometry3::from_parts(
                Translation3::new(1.0 - speed * offset + bend * offset * offset / 2.0, 0.5, 1.0),
                UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 0.4 - turn * offset)),
            ),
            pose_covariance: Matrix6::identity() * 1e-8,
            linear_velocity: Vector3::new(0.3 - bend * offset, 0.0, 0.0),
            angular_velocity: Vector3::zeros(),
            twist_covariance: Matrix6::identity() * 1e-8,
        }
    }

    fn mixed(belief: &Belief) -> Odometry {
        let three = [-BESIDE, 0.0, BESIDE].map(seen);
        belief.mix(0.0, [&three[0], &three[1], &three[2]])
    }

    fn parabola(best: f64, sigma: f64) -> [f64; 3] {
        [-BESIDE, 0.0, BESIDE].map(|d| 7.0 + ((d - best) / sigma).powi(2) / SHARPNESS)
    }

    #[test]
    fn the_data_decide_and_without_data_nothing_is_decided() {
        assert_eq!(PRIOR.after(0.0, [3.0; 3]), PRIOR.belief());
        let agree = PRIOR.after(0.0, parabola(0.001, 0.004));
        assert!(agree.tied > 0.99 && (agree.variance.sqrt() - 0.004).abs() < 1e-4, "{agree:?}");
        let differ = PRIOR.after(0.0, parabola(0.04, 0.004));
        assert!(differ.tied < 1e-6 && (differ.mean - 0.04).abs() < 5e-4, "{differ:?}");
        let open = PRIOR.after(0.0, parabola(0.03, 0.025));
        assert!((0.5..0.99).contains(&open.tied), "{open:?}");
    }

    #[test]
    fn the_estimate_is_that_of_a_filter_with_the_offset_that_is_believed() {
        let alone = seen(0.0);
        let same = mixed(&Belief { tied: 1.0, mean: 0.01, variance: 1e-4 });
        assert_eq!(same, alone);
        let other = mixed(&Belief { tied: 0.0, mean: 0.06, variance: 1e-10 });
        let wanted = seen(0.06);
        let (a, b) = (other.world_from_volant, wanted.world_from_volant);
        assert!((a.translation.vector - b.translation.vector).norm() < 1e-9);
        assert!(a.rotation.angle_to(&b.rotation) < 1e-9);
        assert!((other.linear_velocity - wanted.linear_velocity).norm() < 1e-9);
    }

    #[test]
    fn the_covariance_holds_both_answers() {
        let belief = Belief { tied: 0.95, mean: 0.0, variance: 0.0025 };
        let said = mixed(&belief);
        let expected = 1e-8 + 0.05 * (0.3f64 * 0.05).powi(2);
        assert!((said.pose_covariance[(0, 0)] / expected - 1.0).abs() < 1e-6);
        let mut alone = seen(0.0);
        belief.widen(&mut alone, &Vector6::new(0.3, 0.0, 0.0, 0.0, 0.0, 0.1));
        assert!((alone.pose_covariance - said.pose_covariance).amax() < 1e-9);
    }
}
