//! Several poses that three markers allow (up to four, Gao et al. 2003): the right one turns from
//! image to image as the gyroscope does. Equations: `docs/src/equations.md`, "Initialization".

use nalgebra::UnitQuaternion;
use rig_model::Stamp;

/// The others are excluded when they fit worse by this (χ²).
const CLEAR: f64 = 9.0;
/// The likeliest one is taken after this time, s.
const LONGEST: f64 = 0.8;
/// Images further apart than this are not compared, s.
const LARGEST_GAP: f64 = 0.4;
/// Error of a turn by the gyroscope between two images: bias and time offset, rad (1 sigma).
const TURN: f64 = 0.03;

/// Pose that an image allows.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Attitude of the IMU.
    pub world_from_imu: UnitQuaternion<f64>,
    /// Variance of its angle, rad².
    pub variance: f64,
    /// Squared residuals of the pixels in units of their variance.
    pub pixel_cost: f64,
    /// The same of pixels and "up" together.
    pub cost: f64,
}

/// First of several images that allow several poses.
#[derive(Clone, Debug)]
pub struct Ambiguity {
    first: Stamp,
    last: Stamp,
    /// Turn of the IMU since then, `first_from_last`.
    turned: UnitQuaternion<f64>,
    /// Poses of the first image that later ones have not excluded.
    poses: Vec<Candidate>,
}

impl Ambiguity {
    /// Compares the poses that an image at an instant allows, the likeliest first, with those of
    /// the images before; `turn_since` returns by how much the IMU has turned since an instant
    /// (`then_from_now`). Returns the attitude of the right one, `world_from_imu`, or what is left
    /// to compare the next image with.
    pub fn resolve(
        before: Option<Self>,
        at: Stamp,
        poses: Vec<Candidate>,
        turn_since: impl Fn(Stamp) -> UnitQuaternion<f64>,
    ) -> Result<Option<UnitQuaternion<f64>>, Self> {
        let near = |before: &Self| (0.0..LARGEST_GAP).contains(&at.seconds_since(before.last));
        let Some(mut before) = before.filter(near) else {
            let is_clear = match poses.as_slice() {
                [best, other, ..] => other.cost - best.cost > CLEAR,
                _ => true,
            };
            let turned = UnitQuaternion::identity();
            let first = Self { first: at, last: at, turned, poses };
            return if is_clear { Ok(first.likeliest()) } else { Err(first) };
        };
        let turn = turn_since(before.last);
        match before.choose(at, &turn, &poses) {
            Some(place) => Ok(Some(poses[place].world_from_imu)),
            None => Err(before),
        }
    }

    fn likeliest(&self) -> Option<UnitQuaternion<f64>> {
        self.poses.first().map(|pose| pose.world_from_imu)
    }

    /// Compares the poses of a later image at an instant, before which the IMU has turned by `turn`
    /// (`last_from_now`). Returns the place of the right one, once it is clear or time is over.
    fn choose(
        &mut self,
        at: Stamp,
        turn: &UnitQuaternion<f64>,
        poses: &[Candidate],
    ) -> Option<usize> {
        (self.last, self.turned) = (at, self.turned * turn);
        // For each pose of the first image its cost with the best of these, and the place of that.
        let with = |first: &Candidate| {
            let predicted = first.world_from_imu * self.turned;
            let costs = poses.iter().map(|now| {
                let off = predicted.angle_to(&now.world_from_imu);
                let variance = TURN * TURN + first.variance + now.variance;
                first.cost + now.pixel_cost + off * off / variance
            });
            costs.zip(0..).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, 0))
        };
        let pairs: Vec<(f64, usize)> = self.poses.iter().map(with).collect();
        let (best, place) = pairs.iter().copied().min_by(|a, b| a.0.total_cmp(&b.0))?;
        let mut kept = pairs.iter().map(|(cost, _)| *cost <= best + CLEAR);
        self.poses.retain(|_| kept.next() == Some(true));
        let over = at.seconds_since(self.first) >= LONGEST;
        (best.is_finite() && (over || self.poses.len() == 1)).then_some(place)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn the_pose_that_turns_as_the_gyroscope_does_is_chosen() {
        let at = |k: i64| Stamp::from_nanos(40_000_000 * k);
        let lean = |x: f64| UnitQuaternion::from_scaled_axis(Vector3::new(x, 0.0, 0.0));
        let candidate = |x: f64, cost: f64| Candidate {
            world_from_imu: lean(x),
            variance: 1e-4,
            pixel_cost: 0.0,
            cost,
        };
        // The platform leans by 0.1 rad, turning by `rate`; the mirrored pose fits "up" better.
        let chosen = |rate: f64| {
            let poses = |k: i64| {
                let x = 0.1 - rate * 0.04 * k as f64;
                vec![candidate(x, 1.0), candidate(-x, 0.5)]
            };
            let mut before = None;
            (0..40).find_map(|k| {
                let turned = |_| lean(-rate * 0.04);
                match Ambiguity::resolve(before.take(), at(k), poses(k), turned) {
                    Ok(right) => Some((k, right?.scaled_axis().x > 0.0)),
                    Err(left) => {
                        before = Some(left);
                        None
                    }
                }
            })
        };
        let (image, leans) = chosen(0.3).unwrap();
        assert!(leans && (5..20).contains(&image), "{image}");
        assert_eq!(chosen(0.0), Some((20, false)), "the likeliest after 0.8 s");
        let poses = |k| vec![candidate(0.1, 0.0), candidate(-0.1, k)];
        let none = |_| UnitQuaternion::identity();
        let open = Ambiguity::resolve(None, at(0), poses(1.0), none).unwrap_err();
        let long_ago = Ambiguity::resolve(Some(open.clone()), at(20), poses(1.0), none);
        assert!(long_ago.is_err(), "too far apart to compare");
        assert_eq!(Ambiguity::resolve(None, at(0), poses(20.0), none).unwrap(), Some(lean(0.1)));
        let empty = Ambiguity::resolve(Some(open.clone()), at(1), Vec::new(), none);
        assert!(empty.is_err());
        let one = Ambiguity::resolve(Some(open), at(1), vec![candidate(0.1, 0.0)], none);
        assert_eq!(one.unwrap(), Some(lean(0.1)), "the other one is excluded");
    }
}
