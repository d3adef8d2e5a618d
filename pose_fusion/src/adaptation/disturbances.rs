//! Disturbances: intervals in which platform or climber move unlike their model (a blow, an end
//! stop). They are re-propagated with as much process noise as explains the residual. Equations:
//! `docs/src/equations.md`, "Encoders" and "Adaptation".

use crate::{
    ekf::propagation::ProcessNoise, measurements::Innovation, measurements::encoders::CONTRADICTION,
};
use nalgebra::Vector3;
use rig_model::Stamp;
use std::collections::VecDeque;

/// Number of disturbances remembered; each is over when it leaves the history.
const REMEMBERED: usize = 32;
/// After a disturbance of the climber images do not count as contradictions, s.
pub const CLIMBER_SETTLING: f64 = 0.05;
/// Largest acceleration that a disturbance of the climber explains, m/s² and rad/s².
const LARGEST_ACCELERATION: f64 = 30.0;

/// Additional process noise in an interval.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Disturbance {
    from: Stamp,
    to: Stamp,
    jerk: Vector3<f64>,
    force: f64,
    rate: f64,
}

impl Disturbance {
    /// Whether this is one of the climber that lasts at `at` or ended within `span` seconds before.
    fn jerks_climber(&self, at: Stamp, span: f64) -> bool {
        self.jerk != Vector3::zeros() && self.from <= at && at.seconds_since(self.to) <= span
    }
}

/// The newest disturbances.
#[derive(Clone, Debug)]
pub struct Disturbances(VecDeque<Disturbance>);

impl Default for Disturbances {
    fn default() -> Self {
        Self(VecDeque::with_capacity(REMEMBERED))
    }
}

impl Disturbances {
    /// Adds the jerk that explains an encoder reading at `to`, since `from`. Returns false where
    /// the reading needs none or has its disturbance already.
    pub fn add_jerk(&mut self, from: Stamp, to: Stamp, innovation: &Innovation<3>) -> bool {
        let span = to.seconds_since(from);
        if innovation.nis <= CONTRADICTION
            || span <= 0.0
            || self.0.iter().any(|d| d.to == to && d.jerk != Vector3::zeros())
        {
            return false;
        }
        let jerk = Vector3::from_fn(|axis, _| {
            let residual = innovation.residual[axis];
            if residual * residual <= CONTRADICTION * innovation.covariance[(axis, axis)] {
                return 0.0;
            }
            let residual = residual.abs().min(LARGEST_ACCELERATION * span * span / 2.0);
            20.0 * residual * residual / span.powi(5)
        });
        self.push(Disturbance { from, to, jerk, force: 0.0, rate: 0.0 });
        true
    }

    /// Adds a disturbance of the platform that moves it by `distance` (m) and `angle` (rad) between
    /// `from` and `to`.
    pub fn add_shock(&mut self, from: Stamp, to: Stamp, distance: f64, angle: f64) {
        let span = to.seconds_since(from).max(1e-3);
        let force = 3.0 * distance * distance / span.powi(3);
        let rate = angle * angle / span;
        self.push(Disturbance { from, to, jerk: Vector3::zeros(), force, rate });
    }

    fn push(&mut self, disturbance: Disturbance) {
        if self.0.len() == REMEMBERED {
            self.0.pop_front();
        }
        self.0.push_back(disturbance);
    }

    /// Adds the disturbances of a step that ends at `end` to its process noise.
    pub fn add_to(&self, noise: &mut ProcessNoise, end: Stamp) {
        for d in self.0.iter().filter(|d| d.from < end && end <= d.to) {
            noise.jerk += d.jerk;
            noise.force += d.force;
            noise.rate += d.rate;
        }
    }

    /// Returns whether the climber is disturbed at `at`, or was within `span` seconds before.
    pub fn is_climber_disturbed(&self, at: Stamp, span: f64) -> bool {
        self.0.iter().any(|d| d.jerks_climber(at, span))
    }

    /// Forgets the disturbances of the climber that reach into the `span` seconds before `at`, and
    /// returns when the first of them began.
    pub fn forget_climber(&mut self, at: Stamp, span: f64) -> Option<Stamp> {
        let from = self.0.iter().filter(|d| d.jerks_climber(at, span)).map(|d| d.from).min();
        self.0.retain(|d| !d.jerks_climber(at, span));
        from
    }

    /// Forgets the shocks of the platform that end after `from`: something else was wrong.
    pub fn forget_shocks(&mut self, from: Stamp) {
        self.0.retain(|d| d.force == 0.0 || d.to <= from);
    }

    /// Returns whether a shock of the platform ends at `to`.
    pub fn has_shock(&self, to: Stamp) -> bool {
        self.0.iter().any(|d| d.force > 0.0 && d.to == to)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurements::Outcome;
    use nalgebra::Matrix3;

    fn innovation(residual: Vector3<f64>, sigma: f64) -> Innovation<3> {
        Innovation {
            residual,
            covariance: Matrix3::identity() * sigma * sigma,
            nis: residual.map(|r| (r / sigma).powi(2)).max(),
            outcome: Outcome::Used,
        }
    }

    #[test]
    fn the_jerk_explains_its_reading_once_and_on_its_axis_only() {
        let mut disturbances = Disturbances::default();
        let at = |ms: i64| Stamp::from_nanos(1_000_000_000 + ms * 1_000_000);
        let density = |d: &Disturbances, ms: i64| {
            let mut noise = ProcessNoise::default();
            d.add_to(&mut noise, at(ms));
            noise
        };
        let one = innovation(Vector3::new(0.002, 1e-4, 0.0), 1e-4);
        assert!(disturbances.add_jerk(at(0), at(40), &one));
        assert!(!disturbances.add_jerk(at(0), at(40), &one), "the reading has its disturbance");
        let q = density(&disturbances, 20).jerk;
        assert_eq!((q.y, q.z), (0.0, 0.0));
        assert!(((q.x * 0.04f64.powi(5) / 20.0).sqrt() - 0.002).abs() < 1e-12);
        assert_eq!(density(&disturbances, 0).jerk.x, 0.0);
        assert_eq!(density(&disturbances, 41).jerk.x, 0.0);
        assert!(!disturbances.add_jerk(at(80), at(120), &innovation(Vector3::zeros(), 1.0)));
        let disturbed =
            [80, 100].map(|ms| disturbances.is_climber_disturbed(at(ms), CLIMBER_SETTLING));
        assert_eq!(disturbed, [true, false]);
        disturbances.add_shock(at(200), at(260), 0.005, 0.02);
        let noise = density(&disturbances, 250);
        assert!(((noise.force * 0.06f64.powi(3) / 3.0).sqrt() - 0.005).abs() < 1e-12);
        assert!(((noise.rate * 0.06).sqrt() - 0.02).abs() < 1e-12);
        assert!(disturbances.has_shock(at(260)) && !disturbances.has_shock(at(250)));
        for k in 0..100 {
            disturbances.add_shock(at(300 + k), at(301 + k), 0.1, 0.1);
        }
        assert_eq!(disturbances.0.len(), REMEMBERED);
    }
}
