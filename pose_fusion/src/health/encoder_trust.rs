//! Trust in the encoders.
//!
//! Policy: a reading that no climber can have reached is excluded, and the encoders are suspended:
//! the climber then moves freely and is measured by images and IMU, and loosely by readings that
//! move. Three consistent readings in a row restore trust. Readings that contradict the estimate
//! for `climber.step_timeout` are adopted (the drive was homed, or a wheel slipped): the filter
//! reinitializes with them, and the world frame moves with the encoders. Until then the pose keeps
//! its frame. Which of the two is wrong is not known: after `DISAGREES` the published covariance
//! contains the distance between them; where the encoders seem to be stuck, only until they have
//! seemed so for `STUCK_CONFIRMED` and images and IMU have shown motion. Encoders that are stuck are
//! not adopted before they move again; after `UNRESOLVED` the pose is not valid. Stuck ones that
//! move again, to where a climber can have moved since, and go on moving on all axes that moved, are
//! right: they are adopted after `RETURNED`.

use super::encoder_directions::EncoderDirections;
use nalgebra::Vector3;
use rig_model::Stamp;

/// Readings that contradict the estimate for longer than this cast doubt on it, s.
const DISAGREES: f64 = 0.3;

/// Encoders that seem to be stuck count as stuck once nothing has contradicted that for this time,
/// s.
const STUCK_CONFIRMED: f64 = 0.7;

/// Encoders that are suspended for longer than this leave the pose to the IMU for too long, s.
pub const UNRESOLVED: f64 = 5.0;

/// Consistent readings in a row that restore trust.
const CONSISTENT: u32 = 3;
/// Time for which standing readings must be consistent, s: a climber that drives may pass the
/// position of stuck ones.
const UNCHANGED: f64 = 1.0;
/// Stuck readings that move again and contradict for this long are right, s.
const RETURNED: f64 = 0.2;
/// This long after encoders were suspended, images should not contradict the prediction any
/// more, s.
const EXPLAINED: f64 = 0.2;
/// A reading is consistent below this NIS (one degree of freedom; 3 sigma).
const CONSISTENT_NIS: f64 = 9.0;
/// Readings that still stand after the climber was shown to move are consistent within this
/// distance, m and rad, however uncertain the estimate has become without them.
const CONSISTENT_DISTANCE: f64 = 0.05;

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
    /// They were stuck and move again: wrong until they are adopted or consistent.
    Unstuck,
    /// They are stuck while the climber drives: the estimate is right.
    Stuck,
}

/// What is seen of the encoders at a reading.
#[derive(Clone, Copy, Debug, Default)]
pub struct EncoderEvidence {
    /// The newest readings are equal, or those of an axis that may be stuck.
    pub standing: bool,
    /// An axis has stood since about when the encoders were suspended: it may be stuck.
    pub axis_stopped: bool,
    /// By the estimate the climber moves along an axis that stands.
    pub moves: bool,
    /// Images and IMU show that the climber moves along an axis that stands.
    pub shown: bool,
    /// The reading is the first that differs after equal ones, and a climber can have moved there.
    pub moves_on: bool,
}

/// Whether the encoders are trusted.
#[derive(Clone, Debug, Default)]
pub struct EncoderTrust {
    suspended: Option<(Stamp, Cause)>,
    /// Since when the encoders have seemed to be stuck.
    stuck_since: Option<Stamp>,
    consistent: u32,
    consistent_since: Option<Stamp>,
    /// Newest reading minus estimate: x, y (m), turn (rad).
    residual: Vector3<f64>,
    newest: Option<Stamp>,
    /// First reading of stuck encoders that moves again.
    returned: Option<Stamp>,
    /// Last time that the filter was tried without encoders that stand, or found them not stuck.
    tried: Option<Stamp>,
    /// Images and IMU have shown since the suspension that the climber moves along standing axes.
    shown: bool,
    /// Since when each axis stood that may be stuck, where the oldest state has followed it.
    pub followed: Option<[Option<Stamp>; 3]>,
    /// Whether images and IMU show the directions that the encoders report.
    pub directions: EncoderDirections,
}

impl EncoderTrust {
    /// Returns whether the encoders are suspended.
    pub fn is_suspended(&self) -> bool {
        self.suspended.is_some()
    }

    /// Returns since when the encoders have been suspended, IMU time.
    pub fn suspended_since(&self) -> Option<Stamp> {
        self.suspended.map(|(since, _)| since)
    }

    /// Returns whether the encoders have been suspended for so long that the pose must not be used:
    /// they may be stuck, or the IMU leads the estimate astray.
    pub fn is_unresolved(&self, at: Stamp) -> bool {
        self.suspended_since().is_some_and(|since| at.seconds_since(since) > UNRESOLVED)
    }

    /// Returns why the encoders are suspended.
    pub fn cause(&self) -> Option<Cause> {
        self.suspended.map(|(_, cause)| cause)
    }

    /// Suspends the encoders at a reading; suspended ones keep their cause. `returns`: they were
    /// stuck unnoticed, and move again.
    pub fn suspend(&mut self, at: Stamp, cause: Cause, returns: bool) {
        self.suspended.get_or_insert((at, cause));
        self.returned = returns.then_some(at);
        (self.consistent, self.consistent_since) = (0, None);
    }

    /// Returns by how much encoders and estimate contradict each other, x, y (m) and turn (rad),
    /// while it is not known which is wrong.
    pub fn disagreement(&self) -> Option<Vector3<f64>> {
        let (since, cause) = self.suspended?;
        let lasts = |since: Stamp| self.newest.map_or(0.0, |newest| newest.seconds_since(since));
        let disagrees = match cause {
            Cause::Stuck => {
                !self.shown || self.stuck_since.is_none_or(|since| lasts(since) < STUCK_CONFIRMED)
            }
            Cause::Unstuck => true,
            Cause::Contradiction | Cause::Leap => lasts(since) > DISAGREES,
        };
        disagrees.then_some(self.residual)
    }

    /// Judges a new reading at `at` with this NIS and residual (x, y, m; turn, rad) while the
    /// encoders are suspended. `timeout` in s.
    pub fn judge(
        &mut self,
        at: Stamp,
        nis: f64,
        residual: &Vector3<f64>,
        seen: EncoderEvidence,
        timeout: f64,
    ) -> Verdict {
        let Some((since, cause)) = &mut self.suspended else { return Verdict::Resume };
        (self.newest, self.residual) = (Some(at), *residual);
        let contradicts = at.seconds_since(*since);
        if seen.standing {
            self.returned = None;
            if (seen.moves || seen.shown) && contradicts > DISAGREES && *cause != Cause::Stuck {
                *cause = Cause::Stuck;
                self.stuck_since = Some(at);
            }
        } else if *cause == Cause::Stuck {
            *cause = Cause::Unstuck;
            self.returned = seen.moves_on.then_some(at);
        }
        self.shown |= seen.shown;
        let stuck = *cause == Cause::Stuck || seen.standing && self.shown;
        let near = residual.amax() < CONSISTENT_DISTANCE;
        let may_stand = !seen.shown && (near || !self.shown);
        if nis < CONSISTENT_NIS && (may_stand || !seen.standing) {
            self.consistent += 1;
            self.consistent_since.get_or_insert(at);
        } else {
            (self.consistent, self.consistent_since) = (0, None);
        }
        let lasts = self.consistent_since.map_or(0.0, |since| at.seconds_since(since));
        let due = if seen.standing { UNCHANGED } else { 0.0 };
        let returned = !seen.axis_stopped
            && self.returned.is_some_and(|since| at.seconds_since(since) > RETURNED);
        if self.consistent >= CONSISTENT && lasts > due {
            self.reset();
            Verdict::Resume
        } else if !stuck && self.consistent == 0 && (returned || contradicts > timeout) {
            self.reset();
            Verdict::Adopt
        } else {
            Verdict::Exclude
        }
    }

    /// Trusts the encoders again, after a reinitialization.
    pub fn reset(&mut self) {
        *self = Self {
            tried: self.tried,
            directions: std::mem::take(&mut self.directions),
            ..Self::default()
        };
    }

    /// Returns whether encoders that have stood since `since` may be stuck: not where they are
    /// suspended, or stood already when they were tried without.
    pub fn may_suspect(&self, since: Stamp, at: Stamp) -> bool {
        // A clock that was set back leaves a trial in the future.
        let tried = self.tried.is_some_and(|tried| (since..=at).contains(&tried));
        !self.is_suspended() && (!tried || self.directions.unreported() != [false; 3])
    }

    /// Notes that encoders which stand are tried without.
    pub fn note_trial(&mut self, at: Stamp) {
        self.tried = Some(at);
    }

    /// Trusts encoders again that have not leapt, where images contradict the prediction without
    /// them as well: something else is wrong. Returns whether it does.
    pub fn restore_after_contradiction(&mut self, at: Stamp) -> bool {
        let suspected = self.suspended.is_some_and(|(since, cause)| {
            cause != Cause::Leap && at.seconds_since(since) > EXPLAINED
        }) && self.directions.unreported() == [false; 3];
        if suspected {
            self.tried = Some(at);
            self.reset();
        }
        suspected
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CONTRADICTING: EncoderEvidence = EncoderEvidence {
        standing: false,
        axis_stopped: false,
        moves: false,
        shown: false,
        moves_on: false,
    };
    const RETURNS: EncoderEvidence = EncoderEvidence { moves_on: true, ..CONTRADICTING };
    const STANDS: EncoderEvidence = EncoderEvidence { standing: true, ..CONTRADICTING };
    const STUCK: EncoderEvidence = EncoderEvidence { moves: true, ..STANDS };

    #[test]
    fn three_consistent_readings_restore_trust_and_a_lasting_step_is_adopted() {
        let at = |ms: i64| Stamp::from_nanos(ms * 1_000_000);
        let off = Vector3::new(0.5, 0.0, 0.0);
        let mut trust = EncoderTrust::default();
        trust.suspend(at(0), Cause::Contradiction, false);
        let verdicts = [1.0, 1.0, 500.0, 1.0, 1.0]
            .map(|nis| trust.judge(at(20), nis, &off, CONTRADICTING, 3.0));
        assert_eq!(verdicts, [Verdict::Exclude; 5]);
        assert_eq!(trust.judge(at(60), 1.0, &off, CONTRADICTING, 3.0), Verdict::Resume);
        assert!(!trust.is_suspended());
        trust.suspend(at(70), Cause::Contradiction, false);
        let resumes = |trust: &EncoderTrust, residual: &Vector3<f64>, seen: EncoderEvidence| {
            let mut trust = trust.clone();
            let verdict = |k: i64| trust.judge(at(80 + 20 * k), 1.0, residual, seen, 3.0);
            (0..60i64).map(verdict).position(|verdict| verdict == Verdict::Resume)
        };
        let near = Vector3::new(0.04, 0.0, 0.0);
        assert_eq!(resumes(&trust, &off, STANDS), Some(51));
        // However uncertain the estimate is, readings that still stand after images and IMU have
        // shown motion are consistent near it only, and are not adopted.
        let shown = EncoderEvidence { shown: true, ..STANDS };
        assert_eq!(resumes(&trust, &near, shown), None);
        let mut moved = trust.clone();
        assert_eq!(moved.judge(at(90), 500.0, &off, shown, 3.0), Verdict::Exclude);
        assert_eq!(resumes(&moved, &off, STANDS), None);
        assert_eq!(resumes(&moved, &near, STANDS), Some(51));
        assert_eq!(moved.judge(at(9000), 500.0, &off, STANDS, 3.0), Verdict::Exclude);
        trust.suspend(at(100), Cause::Contradiction, false);
        trust.suspend(at(2000), Cause::Contradiction, false);
        assert_eq!(trust.judge(at(2100), 1e6, &off, CONTRADICTING, 3.0), Verdict::Exclude);
        assert_eq!(trust.disagreement(), Some(off));
        assert_eq!(trust.judge(at(2200), 1e6, &off, STUCK, 30.0), Verdict::Exclude);
        assert_eq!(trust.disagreement(), Some(off), "not confirmed yet");
        assert_eq!(trust.judge(at(3000), 1e6, &off, STUCK, 30.0), Verdict::Exclude);
        assert_eq!(trust.disagreement(), Some(off), "images and IMU have shown no motion");
        assert_eq!(trust.judge(at(3020), 1e6, &off, shown, 30.0), Verdict::Exclude);
        assert_eq!(trust.disagreement(), None);
        // A climber that stands is adopted, one that moves has stuck encoders.
        let mut stopped = EncoderTrust::default();
        stopped.suspend(at(0), Cause::Contradiction, false);
        let mut moving = stopped.clone();
        assert_eq!(stopped.judge(at(4000), 1e6, &off, STANDS, 3.0), Verdict::Adopt);
        assert_eq!(moving.judge(at(200), 1e6, &off, STUCK, 3.0), Verdict::Exclude);
        assert_eq!(moving.judge(at(400), 1e6, &off, STUCK, 3.0), Verdict::Exclude);
        assert_eq!(moving.judge(at(4000), 1e6, &off, STANDS, 3.0), Verdict::Exclude);
        // Readings that return from a fault and move are adopted early, those of a reset are not.
        let first_adopted = |returns: bool, stands: i64| {
            let mut trust = EncoderTrust::default();
            trust.suspend(at(0), Cause::Contradiction, returns);
            (1..200).map(|k| 20 * k).find(|&ms| {
                let seen = EncoderEvidence { standing: ms > stands, ..CONTRADICTING };
                trust.judge(at(ms), 500.0, &off, seen, 3.0) == Verdict::Adopt
            })
        };
        assert_eq!(first_adopted(true, 9000), Some(220));
        assert_eq!(first_adopted(true, 60), Some(3020), "set while the climber stood");
        assert_eq!(first_adopted(false, 9000), Some(3020));
        // Stuck readings are never adopted; those that move again are right.
        assert_eq!(trust.judge(at(9000), 1e6, &off, STANDS, 3.0), Verdict::Exclude);
        let mut unclear = trust.clone();
        assert_eq!(unclear.judge(at(9020), 1e6, &off, CONTRADICTING, 30.0), Verdict::Exclude);
        assert_eq!(unclear.judge(at(9240), 1e6, &off, CONTRADICTING, 30.0), Verdict::Exclude);
        assert_eq!(trust.judge(at(9020), 1e6, &off, RETURNS, 30.0), Verdict::Exclude);
        // Not while an axis stands that moved before.
        let stopped = EncoderEvidence { axis_stopped: true, ..CONTRADICTING };
        assert_eq!(trust.judge(at(9230), 1e6, &off, stopped, 30.0), Verdict::Exclude);
        assert_eq!(trust.judge(at(9240), 1e6, &off, CONTRADICTING, 30.0), Verdict::Adopt);
        // What contradicts without them as well is not theirs, unless they have leapt.
        for (cause, restored) in
            [(Cause::Contradiction, true), (Cause::Stuck, true), (Cause::Leap, false)]
        {
            let mut suspect = EncoderTrust::default();
            suspect.suspend(at(5000), cause, false);
            assert!(!suspect.restore_after_contradiction(at(5100)));
            assert_eq!(suspect.restore_after_contradiction(at(5300)), restored);
            assert!(!suspect.may_suspect(at(5200), at(5400)));
            assert_eq!(suspect.may_suspect(at(5350), at(5400)), restored);
        }
        // Readings that stand are tried without once.
        assert!(trust.may_suspect(at(9500), at(10_000)));
        trust.suspend(at(10_000), Cause::Stuck, false);
        trust.note_trial(at(10_000));
        assert!(!trust.may_suspect(at(11_000), at(12_000)));
        trust.reset();
        assert!(!trust.may_suspect(at(9500), at(12_000)));
        assert!(trust.may_suspect(at(11_000), at(12_000)));
        assert!(trust.may_suspect(at(5000), at(6000)), "the clock was set back");
    }
}
