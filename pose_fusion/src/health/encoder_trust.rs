//! Trust in the encoders.
//!
//! Policy: a reading that no climber can have reached is excluded, and the encoders are suspended:
//! the climber then moves freely and is measured by images and IMU. Three consistent readings in a
//! row restore trust. Readings that contradict the estimate for `climber.step_timeout` are adopted
//! (the drive was homed, or a wheel slipped): the filter reinitializes with them, and the world
//! frame moves with the encoders. Until then the pose keeps its frame. Who of the two is wrong is
//! not known: after [`DISPUTED`] the published covariance contains the distance between them.
//! Encoders that are known to be frozen are not adopted before they move again. Readings that were
//! equal, leapt no further than a climber drives meanwhile and go on moving were frozen unnoticed:
//! they are adopted after [`MOVED_ON`].

use crate::input::climber_track::faults::STOOD;
use nalgebra::Vector3;
use rig_model::Stamp;

/// Readings that contradict the estimate for longer than this cast doubt on it, s.
const DISPUTED: f64 = 0.3;

/// Consistent readings in a row that restore trust.
const CONSISTENT: u32 = 3;
/// Readings that do not change must be consistent for this time, s: frozen ones agree while the
/// climber comes by.
const UNCHANGED: f64 = 1.0;
/// Readings that were frozen and contradict the estimate for this time afterwards are right, s: the
/// climber drove on unseen.
const RELEASED: f64 = 0.1;
/// Readings that resumed with a leap were frozen if they still move after this time, s …
const MOVED_ON: f64 = 0.2;
/// … and before this one: a climber that stood, and whose encoders were reset, may set off later.
const SET: f64 = 0.3;
/// A reading is consistent below this NIS (one degree of freedom; 3 sigma).
const GATE: f64 = 9.0;

/// What to do with a reading while the encoders are suspended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Leave it excluded.
    Exclude,
    /// Trust is restored: use it.
    Resume,
    /// The encoders have contradicted for too long: reinitialize with them.
    Adopt,
}

/// Why the encoders are suspended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// They and the estimate contradict each other; which of the two is wrong is not known.
    Contradiction,
    /// Their readings leapt further than a climber moves.
    Leap,
    /// One stopped harder than a drive brakes: it is frozen, or the climber ran into something.
    Stop,
    /// They are frozen while the climber drives: the estimate is right.
    Frozen,
    /// They changed after they were equal, by no more than a climber drives meanwhile.
    MovedOn,
}

/// Whether the encoders are trusted.
#[derive(Clone, Debug, Default)]
pub struct EncoderTrust {
    suspended: Option<(Stamp, Cause)>,
    consistent: u32,
    consistent_since: Option<Stamp>,
    /// Newest reading minus estimate: x, y (m), turn (rad).
    residual: Vector3<f64>,
    newest: Option<Stamp>,
    /// First reading that moves again after they were frozen.
    released: Option<Stamp>,
    /// Last time that readings which stand were tried without.
    tried: Option<Stamp>,
}

impl EncoderTrust {
    /// Returns whether the encoders are suspended.
    pub fn is_suspended(&self) -> bool {
        self.suspended.is_some()
    }

    /// Returns why the encoders are suspended.
    pub fn cause(&self) -> Option<Cause> {
        self.suspended.map(|(_, cause)| cause)
    }

    /// Suspends the encoders at a reading. Suspended ones keep their cause unless they are frozen.
    pub fn suspend(&mut self, at: Stamp, cause: Cause) {
        let suspended = self.suspended.get_or_insert((at, cause));
        if cause == Cause::Frozen {
            suspended.1 = cause;
        }
        (self.consistent, self.consistent_since) = (0, None);
    }

    /// Returns by how much encoders and estimate contradict each other, x, y (m) and turn (rad),
    /// once it is not known which is wrong.
    pub fn dispute(&self) -> Option<Vector3<f64>> {
        let (since, cause) = self.suspended?;
        let lasts = self.newest?.seconds_since(since);
        (lasts > DISPUTED && cause != Cause::Frozen).then_some(self.residual)
    }

    /// Judges a new reading at `at` with this NIS and residual (x, y, m; turn, rad) while the
    /// encoders are suspended; `standing`: the newest readings are equal, `moves`: the estimate of
    /// the climber moves. `timeout` in s.
    pub fn judge(
        &mut self,
        at: Stamp,
        nis: f64,
        residual: &Vector3<f64>,
        (standing, moves): (bool, bool),
        timeout: f64,
    ) -> Verdict {
        let Some((since, cause)) = &mut self.suspended else { return Verdict::Resume };
        (self.newest, self.residual) = (Some(at), *residual);
        let since = *since;
        if standing && moves && at.seconds_since(since) > DISPUTED {
            *cause = Cause::Frozen;
        }
        if *cause == Cause::Frozen && !standing {
            // No longer frozen; wrong until they are adopted or consistent.
            *cause = Cause::Stop;
            self.released = Some(at);
        }
        let (frozen, moved_on) = (*cause == Cause::Frozen, *cause == Cause::MovedOn);
        if nis < GATE {
            self.consistent += 1;
            self.consistent_since.get_or_insert(at);
        } else {
            (self.consistent, self.consistent_since) = (0, None);
        }
        let lasts = self.consistent_since.map_or(0.0, |since| at.seconds_since(since));
        let contradicts = at.seconds_since(since);
        // The state may be too uncertain by now for readings to contradict it.
        let were_frozen = moved_on && !standing && (MOVED_ON..SET).contains(&contradicts);
        let outlasts = contradicts > timeout
            || self.released.is_some_and(|released| at.seconds_since(released) > RELEASED);
        if self.consistent >= CONSISTENT && (!standing || lasts > UNCHANGED) {
            self.reset();
            Verdict::Resume
        } else if !frozen && (were_frozen || self.consistent == 0 && outlasts) {
            self.reset();
            Verdict::Adopt
        } else {
            Verdict::Exclude
        }
    }

    /// Trusts the encoders again, after a reinitialization.
    pub fn reset(&mut self) {
        *self = Self { tried: self.tried, ..Self::default() };
    }

    /// Suspends encoders that have stood since `since` while the prediction contradicts the images,
    /// to see whether they are what is wrong. Returns false where they are suspended, have stood
    /// for less than [`STOOD`], or have stood through such a trial.
    pub fn tries_without(&mut self, since: Stamp, at: Stamp) -> bool {
        let tries = !self.is_suspended()
            && at.seconds_since(since) > STOOD
            // A clock that was set back leaves a trial in the future.
            && self.tried.is_none_or(|tried| tried < since || tried > at);
        if tries {
            self.tried = Some(at);
            self.suspend(at, Cause::Frozen);
        }
        tries
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_consistent_readings_restore_trust_and_a_lasting_step_is_adopted() {
        let at = |ms: i64| Stamp::from_nanos(ms * 1_000_000);
        let off = Vector3::new(0.5, 0.0, 0.0);
        let mut trust = EncoderTrust::default();
        trust.suspend(at(0), Cause::Contradiction);
        let verdicts = [1.0, 1.0, 500.0, 1.0, 1.0]
            .map(|nis| trust.judge(at(20), nis, &off, (false, false), 3.0));
        assert_eq!(verdicts, [Verdict::Exclude; 5]);
        assert_eq!(trust.judge(at(60), 1.0, &off, (false, false), 3.0), Verdict::Resume);
        assert!(!trust.is_suspended());
        trust.suspend(at(70), Cause::Contradiction);
        let frozen: Vec<Verdict> =
            (0..60).map(|k| trust.judge(at(80 + 20 * k), 1.0, &off, (true, false), 3.0)).collect();
        assert_eq!(frozen.iter().position(|v| *v == Verdict::Resume), Some(51));
        trust.suspend(at(100), Cause::Contradiction);
        trust.suspend(at(2000), Cause::Contradiction);
        assert_eq!(trust.judge(at(2100), 1e6, &off, (false, false), 3.0), Verdict::Exclude);
        assert_eq!(trust.dispute(), Some(off));
        trust.suspend(at(2200), Cause::Frozen);
        assert_eq!(trust.dispute(), None);
        // A climber that stands is adopted, one that moves has frozen encoders.
        let mut stopped = EncoderTrust::default();
        stopped.suspend(at(0), Cause::Contradiction);
        let mut moving = stopped.clone();
        assert_eq!(stopped.judge(at(4000), 1e6, &off, (true, false), 3.0), Verdict::Adopt);
        assert_eq!(moving.judge(at(200), 1e6, &off, (true, true), 3.0), Verdict::Exclude);
        assert_eq!(moving.judge(at(400), 1e6, &off, (true, true), 3.0), Verdict::Exclude);
        assert_eq!(moving.judge(at(4000), 1e6, &off, (true, false), 3.0), Verdict::Exclude);
        // Readings that resumed with a leap and move are adopted early, those of a reset are not.
        let mut moved_on = EncoderTrust::default();
        moved_on.suspend(at(0), Cause::MovedOn);
        let mut set = moved_on.clone();
        let first_adopted = |trust: &mut EncoderTrust, standing: bool| {
            let mut verdicts =
                (1..200).map(|k| trust.judge(at(20 * k), 500.0, &off, (standing, false), 3.0));
            verdicts.position(|v| v == Verdict::Adopt).map(|k| 20 * (k + 1))
        };
        assert_eq!(first_adopted(&mut moved_on, false), Some(200));
        assert_eq!(first_adopted(&mut set, true), Some(3020));
        // Frozen readings are never adopted; those that move again are right.
        assert_eq!(trust.judge(at(9000), 1e6, &off, (true, false), 3.0), Verdict::Exclude);
        assert_eq!(trust.judge(at(9020), 1e6, &off, (false, false), 30.0), Verdict::Exclude);
        assert_eq!(trust.judge(at(9140), 1e6, &off, (false, false), 30.0), Verdict::Adopt);
        // Readings that stand are tried without once.
        assert!(
            !trust.tries_without(at(9900), at(10_000)) && trust.tries_without(at(9500), at(10_000))
        );
        trust.reset();
        assert!(
            !trust.tries_without(at(9500), at(12_000))
                && trust.tries_without(at(11_000), at(12_000))
        );
        trust.reset();
        assert!(trust.tries_without(at(5000), at(6000)), "the clock was set back");
    }
}
