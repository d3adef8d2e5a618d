//! A climber that starts with a jerk, or runs into its end stop.
//!
//! The climber is taken to go on as it went, with a jerk of small white noise: right while it drives, and wrong by orders of
//! magnitude for the tenth of a second in which a drive is switched on or a stop is hit. A reading that comes out so far from what was
//! expected is therefore believed, and not the model: the time since the reading before the last one is run again with as much noise as explains the reading. The
//! images in between are weighed anew with it; otherwise they would contradict a climber that is thought to be known, and an
//! unknown clock would seem to be off.
//!
//! White jerk of density `q` moves the climber within `τ` by `√(q τ⁵/20)`; a residual `r` asks for `q = 20 r²/τ⁵`.

use nalgebra::Vector3;
use rig_model::Stamp;
use std::collections::VecDeque;

/// A reading is a jolt where its normalised innovation squared (one degree of freedom) is above this.
pub const JOLT: f64 = 25.0;
/// What one speaks against a filter among others, as minus twice a logarithm: all feel a real one about alike, and a filter
/// with a wrong clock has one at every reading.
pub const PRICE: f64 = 4.0;
/// So long after one the images still are no evidence, s.
const AFTER: f64 = 0.05;
/// No climber is accelerated by more than so much: m/s², and rad/s². What a reading asks for beyond is its own fault.
const ACCELERATION: f64 = 30.0;
/// So many are remembered; one is over after the history's length.
const REMEMBERED: usize = 16;

/// What a reading said beyond the expected: x, y (m) and turn (rad).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Innovation {
    /// Measured minus expected.
    pub residual: Vector3<f64>,
    /// Squared, in units of its variance.
    pub nis: Vector3<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Jolt {
    from: Stamp,
    to: Stamp,
    density: Vector3<f64>,
}

/// The jolts of the history.
#[derive(Clone, Debug)]
pub struct Jolts(VecDeque<Jolt>);

impl Default for Jolts {
    fn default() -> Self {
        Self(VecDeque::with_capacity(REMEMBERED))
    }
}

impl Jolts {
    /// Notes that a reading stamped `to` on the inertial unit's time line was one, since `from`. False where it is none, or known already.
    pub fn note(&mut self, from: Stamp, to: Stamp, innovation: &Innovation) -> bool {
        let span = to.seconds_since(from);
        if innovation.nis.max() <= JOLT || span <= 0.0 || self.0.iter().any(|j| j.to == to) {
            return false;
        }
        let density = Vector3::from_fn(|axis, _| {
            if innovation.nis[axis] <= JOLT {
                return 0.0;
            }
            let residual = innovation.residual[axis].abs().min(ACCELERATION * span * span / 2.0);
            20.0 * residual * residual / span.powi(5)
        });
        if self.0.len() == REMEMBERED {
            self.0.pop_front();
        }
        self.0.push_back(Jolt { from, to, density });
        true
    }

    /// What they add to the jerk's density in a step that ends at `end`.
    pub fn density(&self, end: Stamp) -> Vector3<f64> {
        self.0.iter().filter(|j| j.from < end && end <= j.to).map(|j| j.density).sum()
    }

    /// Whether the climber is in one, or was just before.
    pub fn shaken(&self, at: Stamp) -> bool {
        self.0.iter().any(|j| j.from <= at && at.seconds_since(j.to) <= AFTER)
    }
}

/// What images say for or against a filter, less what they say because of a jolt.
#[derive(Clone, Debug, Default)]
pub struct Evidence {
    /// Minus twice the logarithm of the likelihood, up to what all filters have in common.
    pub sum: f64,
    /// What an image usually adds.
    usual: Option<f64>,
    /// What the newest added beyond that, and when.
    newest: [Option<(Stamp, f64)>; 4],
}

impl Evidence {
    /// Takes in what an image says.
    pub fn take(&mut self, at: Stamp, surprise: f64, shaken: bool) {
        let usual = *self.usual.get_or_insert(surprise);
        if shaken {
            self.sum += surprise.min(usual);
            return;
        }
        self.sum += surprise;
        // A jolt that is not known yet moves it little.
        self.usual = Some(usual + (surprise - usual).min(10.0) / 10.0);
        self.newest.rotate_left(1);
        self.newest[3] = Some((at, (surprise - usual).max(0.0)));
    }

    /// A jolt came to light that began then: what images have said against the filter since is taken back.
    pub fn take_back(&mut self, since: Stamp) {
        for newest in &mut self.newest {
            if let Some((_, excess)) = newest.take_if(|(at, _)| *at >= since) {
                self.sum -= excess;
            }
        }
        self.sum += PRICE;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_noise_of_a_jolt_explains_its_reading_once_and_only_on_its_axis() {
        let mut jolts = Jolts::default();
        let at = |ms: i64| Stamp::from_nanos(1_000_000_000 + ms * 1_000_000);
        let innovation =
            Innovation { residual: Vector3::new(0.002, 1e-4, 0.0), nis: Vector3::new(400.0, 2.0, 0.0) };
        assert!(jolts.note(at(0), at(40), &innovation));
        assert!(!jolts.note(at(0), at(40), &innovation), "run again, it is no news");
        let q = jolts.density(at(20));
        assert_eq!((q.y, q.z), (0.0, 0.0));
        assert!(((q.x * 0.04f64.powi(5) / 20.0).sqrt() - 0.002).abs() < 1e-12);
        assert_eq!(jolts.density(at(0)).x, 0.0);
        assert_eq!(jolts.density(at(41)).x, 0.0);
        // Half a metre within 40 ms is no jolt of a crane but a broken reading.
        let broken = Innovation { residual: Vector3::repeat(0.5), nis: Vector3::repeat(1e6) };
        assert!(jolts.note(at(40), at(80), &broken));
        assert!((jolts.density(at(80)).x * 0.04f64.powi(5) / 20.0).sqrt() < 0.025);
        assert!(!jolts.note(
            at(80),
            at(120),
            &Innovation { residual: Vector3::zeros(), nis: Vector3::zeros() }
        ));
        for k in 0..100 {
            jolts.note(at(200 + k), at(201 + k), &innovation);
        }
        assert_eq!(jolts.0.len(), REMEMBERED);
    }

    #[test]
    fn what_an_image_says_against_a_filter_because_of_a_jolt_does_not_count() {
        let at = |ms: i64| Stamp::from_nanos(1_000_000_000 + ms * 1_000_000);
        let (mut calm, mut jolted) = (Evidence::default(), Evidence::default());
        for k in 0..20 {
            calm.take(at(33 * k), -48.0, false);
            jolted.take(at(33 * k), -48.0, false);
        }
        // The image before the reading that tells of it, then one that knows.
        jolted.take(at(660), 300.0, false);
        jolted.take_back(at(650));
        jolted.take(at(690), 200.0, true);
        calm.take(at(660), -48.0, false);
        calm.take(at(690), -48.0, false);
        assert!((jolted.sum - calm.sum - PRICE).abs() < 2.0, "{jolted:?} {calm:?}");
        jolted.take(at(900), 100.0, false);
        assert!(jolted.sum > calm.sum + 100.0);
    }
}
