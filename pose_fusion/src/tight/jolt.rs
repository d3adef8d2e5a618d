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

/// So many images are kept open; a filter that is alone closes none.
const OPEN: usize = 64;
/// A filter that has gone on by so much since an image will say nothing of it any more, s.
const PASSED: f64 = 0.5;

/// What images say for or against a filter, less what they say because of a jolt.
///
/// Filters with different clocks weigh an image at different moments, and where images come late some cannot weigh it at all. An image
/// that fits adds a lot to all of them alike (some -37), so only what all have weighed may count: the others stay open.
#[derive(Clone, Debug)]
pub struct Evidence {
    /// Minus twice the logarithm of the likelihood of the images that count, up to what all filters have in common.
    pub sum: f64,
    /// What an image usually adds.
    usual: Option<f64>,
    /// The newest ones: image, when it was taken on this filter's time line, and what it added beyond the usual.
    newest: [Option<(Stamp, Stamp, f64)>; 4],
    /// Images that not all have weighed yet, and what this filter says of each; `None`: nothing.
    open: VecDeque<(Stamp, Option<f64>)>,
    newest_image: Option<Stamp>,
}

impl Default for Evidence {
    fn default() -> Self {
        let open = VecDeque::with_capacity(OPEN);
        Self { sum: 0.0, usual: None, newest: [None; 4], open, newest_image: None }
    }
}

impl Evidence {
    /// Takes in what an image says that was taken `at` on this filter's time line.
    pub fn take(&mut self, image: Stamp, at: Stamp, surprise: f64, shaken: bool) {
        let usual = *self.usual.get_or_insert(surprise);
        if shaken {
            self.say(image, Some(surprise.min(usual)));
            return;
        }
        self.say(image, Some(surprise));
        // A jolt that is not known yet moves it little.
        self.usual = Some(usual + (surprise - usual).min(10.0) / 10.0);
        self.newest.rotate_left(1);
        self.newest[3] = Some((image, at, (surprise - usual).max(0.0)));
    }

    /// This filter will say nothing of an image.
    pub fn pass(&mut self, image: Stamp) {
        if self.said(image).is_none() {
            self.say(image, None);
        }
    }

    fn say(&mut self, image: Stamp, says: Option<f64>) {
        if self.open.len() == OPEN {
            self.open.pop_front();
        }
        self.open.push_back((image, says));
        self.newest_image = Some(self.newest_image.map_or(image, |newest| newest.max(image)));
    }

    /// A jolt came to light that began then: what images have said against the filter since is taken back.
    pub fn take_back(&mut self, since: Stamp) {
        for newest in &mut self.newest {
            if let Some((image, _, excess)) = newest.take_if(|(_, at, _)| *at >= since) {
                match self.open.iter_mut().find(|(open, _)| *open == image) {
                    Some((_, says)) => *says = says.map(|says| says - excess),
                    None => self.sum -= excess,
                }
            }
        }
        self.sum += PRICE;
    }

    /// How much more than another it has against it, by the images that count and those that both have weighed.
    pub fn against(&self, other: &Self) -> f64 {
        let both = self.open.iter().filter_map(|(image, says)| Some((*says)? - other.said(*image)??));
        self.sum - other.sum + both.sum::<f64>()
    }

    /// The images that are open.
    pub fn open(&self) -> impl Iterator<Item = Stamp> {
        self.open.iter().map(|(image, _)| *image)
    }

    /// What it says of an image that is open: `Some(None)` where that is nothing, `None` where it has not said it yet.
    pub fn said(&self, image: Stamp) -> Option<Option<f64>> {
        self.open.iter().find(|(open, _)| *open == image).map(|(_, says)| *says)
    }

    /// Whether it will not say anything of an image any more, because it is long past it.
    pub fn is_past(&self, image: Stamp) -> bool {
        self.said(image).is_none()
            && self.newest_image.is_some_and(|newest| newest.seconds_since(image) > PASSED)
    }

    /// An image is open no more; what is said of it `counts` or is forgotten.
    pub fn close(&mut self, image: Stamp, counts: bool) {
        let Some(place) = self.open.iter().position(|(open, _)| *open == image) else { return };
        if let (Some((_, Some(says))), true) = (self.open.remove(place), counts) {
            self.sum += says;
        }
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
            calm.take(at(33 * k), at(33 * k), -48.0, false);
            jolted.take(at(33 * k), at(33 * k), -48.0, false);
            if k < 18 {
                // The last two are still open where the jolt comes to light.
                calm.close(at(33 * k), true);
                jolted.close(at(33 * k), true);
            }
        }
        // The image before the reading that tells of it, then one that knows.
        jolted.take(at(660), at(660), 300.0, false);
        jolted.take_back(at(650));
        jolted.take(at(690), at(690), 200.0, true);
        calm.take(at(660), at(660), -48.0, false);
        calm.take(at(690), at(690), -48.0, false);
        let close = |evidence: &mut Evidence| {
            let open: Vec<Stamp> = evidence.open().collect();
            open.into_iter().for_each(|image| evidence.close(image, true));
        };
        close(&mut calm);
        close(&mut jolted);
        assert!((jolted.sum - calm.sum - PRICE).abs() < 2.0, "{jolted:?} {calm:?}");
        jolted.take(at(900), at(900), 100.0, false);
        close(&mut jolted);
        assert!(jolted.sum > calm.sum + 100.0);
    }

    #[test]
    fn only_images_that_count_count() {
        let at = |ms: i64| Stamp::from_nanos(1_000_000_000 + ms * 1_000_000);
        let mut evidence = Evidence::default();
        for k in 0..4 {
            evidence.take(at(33 * k), at(33 * k), -40.0, false);
        }
        evidence.pass(at(140));
        evidence.pass(at(33));
        assert_eq!(
            (evidence.said(at(33)), evidence.said(at(140)), evidence.said(at(170))),
            (Some(Some(-40.0)), Some(None), None)
        );
        assert!(!evidence.is_past(at(70)));
        let mut other = Evidence::default();
        other.take(at(33), at(33), -30.0, false);
        other.take(at(66), at(66), -50.0, false);
        other.pass(at(99));
        assert_eq!(evidence.against(&other), 0.0);
        other.take(at(0), at(0), 10.0, false);
        assert_eq!((evidence.against(&other), other.against(&evidence)), (-50.0, 50.0));
        evidence.close(at(0), true);
        evidence.close(at(33), false);
        evidence.close(at(140), true);
        assert_eq!((evidence.sum, evidence.open().count()), (-40.0, 2));
        evidence.pass(at(700));
        assert!(evidence.is_past(at(70)) && !evidence.is_past(at(66)) && !evidence.is_past(at(300)));
        for k in 0..1000 {
            evidence.take(at(1000 + k), at(1000 + k), -40.0, false);
        }
        assert_eq!(evidence.open().count(), OPEN);
    }
}
