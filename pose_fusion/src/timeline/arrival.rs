//! Arrival of the inputs: order, gaps and jumps of the IMU's stamps, and IMU samples that stay
//! away.

use crate::ekf::propagation::ImuReading;
use rig_model::{Stamp, topics};
use std::fmt;

/// Further ahead of the IMU samples than this, a message is rejected, s.
pub const AHEAD: f64 = 0.5;
/// An IMU stamp further from its predecessor than this must be confirmed by others, s.
pub const JUMP: f64 = 1.0;
/// IMU samples are held up for less than this, s.
const HELD_UP: f64 = 10.0;
/// A sample further ahead may have a wrong stamp, s; other messages or the next one confirm it.
const STRAY: f64 = 0.2;
/// Number of consecutive samples that confirm a jump.
const JUMP_CONFIRMED: u32 = 3;
/// Number of consecutive late samples, each with a later stamp than the one before, that show a
/// clock that was set back: samples that are merely out of order fill gaps between others.
const REPEATED: u32 = 4;
/// Smallest backward step of a clock that can be distinguished from jitter of the stamps, s.
const SHORTEST_STEP: f64 = 0.03;
/// Advance of other messages, at least [`MESSAGES`], from which the IMU is lost, s.
const SILENCE: f64 = 0.1;
const MESSAGES: u32 = 4;
/// Rate at which what other messages were ahead of the IMU samples at most is forgotten, s/s.
const FADES: f64 = 0.05;
/// After this long without IMU samples a pose is initialized from images alone, s.
const ABSENCE: f64 = 0.5;

/// What an IMU sample is by its stamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ImuArrival {
    /// First sample.
    First,
    /// Next sample, this many seconds after the previous one.
    Next(f64),
    /// As old as the newest one, or older.
    NotNewer,
    /// Far from the others and not confirmed: this many seconds ahead (negative: back).
    Unconfirmed(f64),
    /// Confirmed jump back by this many seconds.
    Back(f64),
}

/// Newest stamps.
#[derive(Clone, Debug, Default)]
pub struct Arrival {
    newest_imu: Option<(Stamp, ImuReading)>,
    jump: Option<(Stamp, u32)>,
    /// First and newest of the late samples in a row that fill no gap, and their number.
    repeated: Option<(Stamp, Stamp, u32)>,
    /// Images and encoder readings since the newest IMU sample, by [`Source`].
    others: [Since; 2],
    frontier: Option<Stamp>,
}

/// Messages of one source since the newest IMU sample; stamps of sources are not compared.
#[derive(Clone, Copy, Debug, Default)]
struct Since {
    first: Option<Stamp>,
    count: u32,
    /// Newest message, before the newest IMU sample as well.
    newest: Option<Stamp>,
    /// A message that jumped, which no other has followed yet.
    jumped: Option<Stamp>,
    /// How far the last message was ahead of the newest IMU sample when it came, s.
    ahead: Option<f64>,
    /// The most since the newest IMU sample, and the usual most before it, s.
    most: Option<f64>,
    usual: Option<f64>,
}

impl Since {
    /// Counts a message that continues the ones before; a duplicate is not counted. A jump must be
    /// confirmed by a second message; until then returns by how many seconds the message jumps.
    fn note(&mut self, stamp: Stamp) -> Option<f64> {
        let from = |before: Option<Stamp>| before.map(|before| stamp.seconds_since(before));
        match from(self.newest) {
            Some(step) if step.abs() <= JUMP => {
                self.jumped = None;
                if step <= 0.0 {
                    return None;
                }
                self.count += 1;
            }
            Some(step) if !from(self.jumped).is_some_and(|s| s > 0.0 && s < JUMP) => {
                self.jumped = Some(stamp);
                return Some(step);
            }
            // The source's clock has stepped.
            _ => (self.jumped, self.count, self.usual) = (None, 1, None),
        }
        // Messages that were held up and arrive together do not show that the IMU is silent.
        let is_usual = self.usual.zip(self.ahead).is_some_and(|(usual, ahead)| ahead <= usual);
        if is_usual && !self.is_longer_than(SILENCE) {
            self.count = 1;
        }
        self.newest = Some(stamp);
        if self.count == 1 {
            self.first = Some(stamp);
        }
        None
    }

    /// Notes an IMU sample, this many seconds after the one before.
    fn note_imu(&mut self, step: f64) {
        let is_silent = self.is_longer_than(SILENCE);
        self.count = 0;
        let most = self.most.take();
        let before = self.usual.map(|usual| usual - FADES * step);
        // While nothing is known of the usual, messages that arrive together look like silence.
        let short = |most: &f64| self.usual.is_none() && *most < SILENCE;
        self.usual = match most.filter(|most| !is_silent || short(most)) {
            // The IMU's clock has stepped.
            _ if !(0.0..=STRAY).contains(&step) => None,
            Some(most) => Some(before.map_or(most, |before| before.max(most))),
            None => before,
        };
    }

    fn is_longer_than(&self, seconds: f64) -> bool {
        let elapsed =
            self.newest.zip(self.first).map_or(0.0, |(newest, first)| newest.seconds_since(first));
        self.count >= MESSAGES && elapsed > seconds
    }
}

/// Source of an input; displayed as its topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// Images.
    Image,
    /// Encoder readings.
    Encoders,
    /// IMU samples.
    Imu,
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Image => topics::MARKERS,
            Self::Encoders => topics::CLIMBER_TRANSFORM,
            Self::Imu => topics::IMU,
        })
    }
}

impl Arrival {
    /// Classifies the stamp of an IMU sample.
    pub fn classify(&mut self, stamp: Stamp) -> ImuArrival {
        let Some((newest, _)) = self.newest_imu else { return ImuArrival::First };
        let ahead = stamp.seconds_since(newest);
        if !(-JUMP..=STRAY).contains(&ahead) {
            let count = match self.jump {
                // The same sample twice is no further one.
                Some((last, count)) if stamp == last => count,
                Some((last, count)) if stamp > last && stamp.seconds_since(last) < JUMP => {
                    count + 1
                }
                _ => 1,
            };
            self.jump = Some((stamp, count));
            // Images have gone on to there without the IMU: they confirm it.
            let followed = self.is_imu_silent()
                && self.frontier.is_some_and(|end| stamp.seconds_since(end).abs() < JUMP);
            let needed = if ahead.abs() > JUMP { JUMP_CONFIRMED } else { 2 };
            return match (followed || count >= needed, ahead) {
                (true, ahead) if ahead > 0.0 => ImuArrival::Next(ahead),
                (true, ahead) if count >= needed => ImuArrival::Back(-ahead),
                _ => ImuArrival::Unconfirmed(ahead),
            };
        }
        self.jump = None;
        if ahead > 0.0 { ImuArrival::Next(ahead) } else { ImuArrival::NotNewer }
    }

    /// Notes a late IMU sample; `fills_gap`: samples are missing where its stamp belongs. Returns
    /// by how many seconds the IMU's clock was set back, where samples repeat the time of former
    /// ones.
    pub fn late_imu(&mut self, stamp: Stamp, fills_gap: bool) -> Option<f64> {
        self.repeated = match self.repeated {
            _ if fills_gap => None,
            Some((first, last, count)) if stamp > last => Some((first, stamp, count + 1)),
            _ => Some((stamp, stamp, 1)),
        };
        let (first, ..) = self.repeated.filter(|(.., count)| *count >= REPEATED)?;
        let by_s = self.newest_imu?.0.seconds_since(first);
        (by_s > SHORTEST_STEP).then_some(by_s)
    }

    /// Notes the newest IMU sample.
    pub fn imu(&mut self, stamp: Stamp, reading: ImuReading) {
        let step = self.newest_imu.map_or(0.0, |(before, _)| stamp.seconds_since(before));
        self.newest_imu = Some((stamp, reading));
        self.others.iter_mut().for_each(|since| since.note_imu(step));
        // Images whose clock jumped may have moved the end further than a stall holds up samples.
        let near = self.frontier.filter(|end| end.seconds_since(stamp) < HELD_UP);
        self.frontier = near.max(Some(stamp));
        (self.jump, self.repeated) = (None, None);
    }

    /// Notes the stamp of an image or encoder reading. While there are no IMU samples to compare it
    /// with, returns by how many seconds it jumps from the one before, until a second message
    /// confirms that.
    pub fn other(&mut self, source: Source, stamp: Stamp) -> Option<f64> {
        let since = &mut self.others[source as usize];
        since.ahead = self.newest_imu.map(|(newest, _)| stamp.seconds_since(newest));
        since.most = since.ahead.map(|ahead| since.most.map_or(ahead, |most| most.max(ahead)));
        let jump = since.note(stamp);
        jump.filter(|_| self.newest_imu.is_none() || self.is_imu_silent())
    }

    /// Returns by how many seconds the messages of a source come with stamps ahead of the IMU's.
    pub fn ahead_of_imu(&self, source: Source) -> Option<f64> {
        self.others[source as usize].ahead.filter(|_| !self.is_imu_silent())
    }

    /// Moves the end of the time line to an image while the IMU is silent (IMU time).
    pub fn image(&mut self, at: Stamp) {
        self.frontier = self.frontier.max(Some(at));
    }

    /// Returns what is known of the other messages, for a time line that begins again without IMU.
    pub fn beginning(self) -> Self {
        Self { others: self.others, ..Self::default() }
    }

    /// Returns whether images and encoders arrive and IMU samples do not.
    pub fn is_imu_silent(&self) -> bool {
        self.others.iter().any(|since| since.is_longer_than(SILENCE))
    }

    /// Returns whether the IMU has been silent long enough that a pose may be initialized without
    /// it: samples that a computer held up have arrived by then.
    pub fn is_imu_absent(&self) -> bool {
        self.others.iter().any(|since| since.is_longer_than(ABSENCE))
    }

    /// Returns the newest IMU sample.
    pub fn newest_imu(&self) -> Option<(Stamp, ImuReading)> {
        self.newest_imu
    }

    /// Returns the end of the time line: the newest IMU sample, or image while the IMU is silent.
    pub fn end(&self) -> Option<Stamp> {
        self.frontier
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: i64) -> Stamp {
        Stamp::from_nanos(10_000_000_000 + ms * 1_000_000)
    }

    #[test]
    fn jumps_must_be_confirmed() {
        let mut arrival = Arrival::default();
        assert_eq!(arrival.classify(at(0)), ImuArrival::First);
        arrival.imu(at(0), ImuReading::default());
        assert_eq!(arrival.classify(at(10)), ImuArrival::Next(0.01));
        assert_eq!(arrival.classify(at(-10)), ImuArrival::NotNewer);
        assert_eq!(arrival.classify(at(0)), ImuArrival::NotNewer);
        assert_eq!(arrival.classify(at(5000)), ImuArrival::Unconfirmed(5.0));
        assert_eq!(arrival.classify(at(-5000)), ImuArrival::Unconfirmed(-5.0));
        assert!(matches!(arrival.classify(at(-4990)), ImuArrival::Unconfirmed(_)));
        assert_eq!(arrival.classify(at(-4980)), ImuArrival::Back(4.98));
    }

    #[test]
    fn a_sample_ahead_is_confirmed_by_the_next_and_copies_confirm_nothing() {
        let mut arrival = Arrival::default();
        arrival.imu(at(0), ImuReading::default());
        assert!(matches!(arrival.classify(at(300)), ImuArrival::Unconfirmed(_)));
        assert!(matches!(arrival.classify(at(300)), ImuArrival::Unconfirmed(_)));
        assert_eq!(arrival.classify(at(10)), ImuArrival::Next(0.01));
        assert!(matches!(arrival.classify(at(300)), ImuArrival::Unconfirmed(_)));
        assert!(matches!(arrival.classify(at(310)), ImuArrival::Next(_)));
        for _ in 0..5 {
            assert!(matches!(arrival.classify(at(5000)), ImuArrival::Unconfirmed(_)));
        }
        // Two publishers of the same samples.
        for ms in [5010, 5010] {
            assert!(matches!(arrival.classify(at(ms)), ImuArrival::Unconfirmed(_)));
        }
        assert!(matches!(arrival.classify(at(5020)), ImuArrival::Next(_)));
    }

    #[test]
    fn images_confirm_the_first_sample_after_an_outage() {
        let mut arrival = Arrival::default();
        arrival.imu(at(0), ImuReading::default());
        for ms in (33..2000).step_by(33) {
            arrival.other(Source::Image, at(ms));
            if arrival.is_imu_silent() {
                arrival.image(at(ms));
            }
        }
        assert!(matches!(arrival.classify(at(60_000)), ImuArrival::Unconfirmed(_)));
        assert!(matches!(arrival.classify(at(2000)), ImuArrival::Next(_)));
    }

    #[test]
    fn an_imu_is_silent_when_another_source_goes_on_whatever_its_clock() {
        let mut arrival = Arrival::default();
        arrival.imu(at(0), ImuReading::default());
        for ms in [300, 333, 366, 400] {
            arrival.other(Source::Encoders, at(10_000));
            assert!(!arrival.is_imu_silent(), "{ms}");
            arrival.other(Source::Image, at(ms));
        }
        assert!(!arrival.is_imu_silent());
        arrival.other(Source::Image, at(433));
        assert!(arrival.is_imu_silent());
        arrival.imu(at(120), ImuReading::default());
        assert!(!arrival.is_imu_silent());
        arrival.other(Source::Image, at(466));
        arrival.other(Source::Image, at(10_466));
        assert!(!arrival.is_imu_silent(), "one stamp that jumps says nothing");
    }

    #[test]
    fn messages_that_were_held_up_are_no_silence_of_the_imu() {
        let (mut arrival, mut silent) = (Arrival::default(), vec![]);
        for ms in 0..3000 {
            if ms % 10 == 0 && ms <= 2000 {
                arrival.imu(at(ms), ImuReading::default());
            }
            // Seven encoder readings come together.
            if ms % 140 == 5 {
                for k in 0..7 {
                    arrival.other(Source::Encoders, at(ms - 122 + 20 * k));
                }
            }
            if ms > 100 && arrival.is_imu_silent() {
                silent.push(ms);
            }
        }
        assert_eq!((silent[0], silent.len()), (2105, 3000 - 2105));
    }
}
