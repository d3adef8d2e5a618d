//! Recovery where images contradict the prediction.
//!
//! An image contradicts where at least half of its detected markers are rejected. After
//! `markers.lock_out_images` of them in a row the filter responds, with the mildest explanation
//! first: encoders that stopped while the images see the climber drive on are suspended; else the
//! platform was struck, and the time since the last used image is re-propagated with the process
//! noise of a shock; shocks that follow each other mean that something else is wrong, and the pose
//! is reinitialized from the image. The same happens where all images of `STARVED` seconds
//! contradict: a single marker that still passes its gate keeps no pose that the others contradict.
//!
//! Where that happens again and again, no shock explains it: a unit, a sign, a direction or a frame
//! is wrong, and the pose must not be used.

use rig_model::Stamp;

/// Time without a consistent image after which the second contradicting one reinitializes, s.
const STARVED: f64 = 0.5;
/// Encoders that jumped within this time before an image may be what contradicts it, s.
pub const SUSPECT: f64 = 0.5;
/// Shocks within [`REPEATED`] seconds after which another explanation is tried.
const SHOCKS: u32 = 2;
const REPEATED: f64 = 0.6;
/// The pose is contradicted where the filter responded three times within this time, and until as
/// much time has passed without a further response, s. With correct files it responds on none of
/// seven recordings; with a wrong unit, sign or direction of the IMU several times in this time
/// (`test/tests/robustness.rs`).
const CONTRADICTED: f64 = 3.0;
/// A pose that replaces one which was wrong for certain (it diverged, or other encoders were
/// adopted) must hold for this time before it may be used, s: encoders whose turn is in degrees
/// contradict the adopted pose within it.
const REPLACED: f64 = 1.0;
/// Images must have confirmed a pose for this long after a response before it may be used without
/// images, s: velocity, tilt and biases are what the response changed, and drift from there.
const CONFIRMED: f64 = 0.5;
/// Images must have agreed for this long with a pose that one of them initialized before it may be
/// used, s: before, its velocity is unknown.
const HELD: f64 = 0.2;

/// Response of the filter to an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Response {
    /// Nothing.
    None,
    /// Re-propagate with the noise of a shock, so that the state follows the images; the first
    /// image that contradicted.
    FollowImages(Stamp),
    /// Reinitialize the pose from the image; the first image that contradicted it.
    Reinitialize(Stamp),
}

/// Count of consecutive contradictions.
#[derive(Clone, Debug, Default)]
pub struct ContradictionMonitor {
    contradictions: u32,
    since: Option<Stamp>,
    /// Contradicting images since the last one that did not.
    opposing: u32,
    /// Markers of the newest image that were rejected.
    rejected: [bool; 4],
    /// Last image used before a shock, where the newest image shows one.
    shock_since: Option<Stamp>,
    /// Newest image that was used and did not contradict.
    pub last_used: Option<Stamp>,
    /// Image that the pose was initialized from, or when it was set.
    pub initialized_at: Option<Stamp>,
    /// First of the times that contradicting images were followed, and how often since.
    followed: Option<(Stamp, u32)>,
    /// Images of the last three responses.
    responses: [Option<Stamp>; 3],
    /// When a pose was last replaced that was wrong for certain.
    replaced: Option<Stamp>,
}

impl ContradictionMonitor {
    /// Notes that the pose was initialized from an image.
    pub fn initialized(&mut self, image: Stamp) {
        *self = Self {
            last_used: self.last_used.max(Some(image)),
            initialized_at: Some(image),
            responses: self.responses,
            replaced: self.replaced,
            ..Self::default()
        };
    }

    /// Notes that the estimate begins, unless an image began it.
    pub fn note_start(&mut self, at: Stamp) {
        self.initialized_at.get_or_insert(at);
    }

    /// Notes an image's rejected markers; true where one was not rejected in the image before.
    pub fn rejects(&mut self, rejected: [bool; 4]) -> bool {
        let before = std::mem::replace(&mut self.rejected, rejected);
        (0..4).any(|i| rejected[i] && !before[i])
    }

    /// Notes whether an image shows a shock since `last_used`. Where the image before it did, too,
    /// returns since when.
    pub fn note_shock(&mut self, is_shock: bool, last_used: Stamp) -> Option<Stamp> {
        let before = self.shock_since.filter(|_| is_shock);
        self.shock_since = is_shock.then_some(before.unwrap_or(last_used));
        before
    }

    /// Notes an image of which `used` of `detected` markers were used, and returns what follows.
    /// `limit` is the number of contradicting images in a row; `excused` an image that contradicts
    /// because the climber was just disturbed.
    pub fn note(
        &mut self,
        image: Stamp,
        detected: usize,
        used: u32,
        limit: u32,
        excused: bool,
    ) -> Response {
        let used = used as usize;
        if detected == 0 || used * 2 > detected {
            if used > 0 {
                self.last_used = Some(self.last_used.map_or(image, |last| last.max(image)));
                self.contradictions = 0;
                self.since = None;
                self.opposing = 0;
            }
            return Response::None;
        }
        self.opposing += 1;
        let since = *self.since.get_or_insert(image);
        self.contradictions += u32::from(!excused);
        let starved =
            self.last_used.is_none_or(|last| image.seconds_since(last) > STARVED) && since < image;
        if starved && detected >= 3 {
            Response::Reinitialize(since)
        } else if self.contradictions >= limit {
            Response::FollowImages(since)
        } else {
            Response::None
        }
    }

    /// Notes that a contradicting image is followed, and returns whether that is too often.
    pub fn note_followed(&mut self, image: Stamp) -> bool {
        let (first, count) = match self.followed {
            Some((first, count)) if image.seconds_since(first) < REPEATED => (first, count + 1),
            _ => (image, 1),
        };
        self.followed = Some((first, count));
        count > SHOCKS
    }

    /// Notes that the filter responds to an image, and starts counting again.
    pub fn responded(&mut self, image: Stamp) {
        self.clear();
        self.responses.rotate_left(1);
        self.responses[2] = Some(image);
    }

    /// Notes that the pose, which was wrong, is replaced at the time of an image.
    pub fn replaced(&mut self, image: Stamp) {
        self.responded(image);
        self.replaced = Some(image);
    }

    /// Starts counting again.
    pub fn clear(&mut self) {
        self.contradictions = 0;
        self.since = None;
    }

    /// Returns whether images and prediction contradict each other again and again, or did so just
    /// before the pose was replaced.
    pub fn is_contradicted(&self, now: Stamp) -> bool {
        // A clock that was set back leaves it in the future.
        let lasts = |since: Stamp| (0.0..REPLACED).contains(&now.seconds_since(since));
        let replaced = self.replaced.is_some_and(lasts);
        replaced
            || matches!(self.responses, [Some(first), _, Some(last)]
            if last.seconds_since(first) < CONTRADICTED && now.seconds_since(last) < CONTRADICTED)
    }

    /// Returns whether images have not agreed for long enough with the pose that one initialized.
    pub fn is_new(&self) -> bool {
        let held = self.initialized_at.zip(self.last_used).map(|(at, used)| used.seconds_since(at));
        held.is_none_or(|held| held < HELD)
    }

    /// Returns whether the newest images contradict, or were used so shortly after the filter
    /// responded to a contradiction that they have not confirmed the pose.
    pub fn is_unconfirmed(&self) -> bool {
        let [.., response] = self.responses;
        let lasted = response.zip(self.last_used).map(|(at, used)| used.seconds_since(at));
        self.opposing > 1 || lasted.is_some_and(|lasted| lasted.abs() < CONFIRMED)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Response::{FollowImages, None as Nothing, Reinitialize};

    fn at(ms: i64) -> Stamp {
        Stamp::from_nanos(ms * 1_000_000)
    }

    /// A count that began with an image at 0 ms.
    fn initialized() -> ContradictionMonitor {
        let image = Some(at(0));
        ContradictionMonitor { last_used: image, initialized_at: image, ..Default::default() }
    }

    #[test]
    fn contradictions_in_a_row_make_the_prediction_give_way_and_half_a_second_reinitializes() {
        let mut monitor = initialized();
        // Stamp (ms), detected and used markers, whether it is excused, what follows.
        for (ms, detected, used, excused, expected) in [
            (30, 4, 4, false, Nothing),
            (60, 4, 0, false, Nothing),
            (90, 4, 3, false, Nothing),
            (120, 4, 1, true, Nothing),
            (150, 4, 1, false, Nothing),
            (180, 4, 1, false, FollowImages(at(120))),
        ] {
            assert_eq!(monitor.note(at(ms), detected, used, 2, excused), expected, "{ms} ms");
        }
        monitor.responded(at(180));
        assert_eq!(monitor.note(at(210), 4, 0, 2, false), Nothing);
        assert_eq!(monitor.note(at(800), 4, 0, 9, false), Reinitialize(at(210)));
        assert_eq!(monitor.last_used, Some(at(90)));
        // A single marker contradicts, and an image without markers does not.
        monitor = initialized();
        let images = [(33, 1), (66, 0), (99, 1)];
        let responses = images.map(|(ms, detected)| monitor.note(at(ms), detected, 0, 2, false));
        assert_eq!(responses, [Nothing, Nothing, FollowImages(at(33))]);
        // One contradiction after a gap reinitializes nothing.
        monitor = initialized();
        let images = [(600, 1), (633, 4), (666, 1)];
        let responses = images.map(|(ms, used)| monitor.note(at(ms), 4, used, 6, true));
        assert_eq!(responses, [Nothing; 3]);
    }

    #[test]
    fn one_marker_of_three_keeps_no_pose_that_two_contradict() {
        let mut monitor = initialized();
        // Excused, as where the time offset is unknown.
        let first = (1..30)
            .map(|k| (k, monitor.note(at(33 * k), 3, 1, 6, true)))
            .find(|(_, response)| *response != Nothing);
        assert_eq!(first, Some((16, Reinitialize(at(33)))));
    }

    #[test]
    fn a_marker_is_newly_rejected_once() {
        let mut monitor = ContradictionMonitor::default();
        let image = |rejected: &[usize]| std::array::from_fn(|i| rejected.contains(&i));
        let images: [&[usize]; 6] = [&[], &[0], &[0], &[0, 2], &[], &[0]];
        let new = images.map(|rejected| monitor.rejects(image(rejected)));
        assert_eq!(new, [false, true, false, true, false, true]);
    }

    #[test]
    fn a_pose_is_new_until_images_have_agreed_with_it_and_unconfirmed_while_they_contradict() {
        let mut monitor = initialized();
        // Stamp (ms), used markers, whether the pose is new, and whether it is unconfirmed.
        for (ms, used, new, unconfirmed) in [
            (100, 4, true, false),
            (150, 1, true, false),
            (199, 4, true, false),
            (210, 3, false, false),
            (240, 2, false, false),
            (270, 1, false, true),
            (300, 3, false, false),
        ] {
            monitor.note(at(ms), 4, used, 9, true);
            assert_eq!((monitor.is_new(), monitor.is_unconfirmed()), (new, unconfirmed), "{ms} ms");
        }
        monitor.initialized(at(330));
        assert!(monitor.is_new());
    }

    #[test]
    fn a_pose_is_unconfirmed_until_images_were_used_for_half_a_second_after_a_response() {
        let mut monitor = initialized();
        assert!(!monitor.is_unconfirmed());
        monitor.responded(at(1000));
        for (ms, unconfirmed) in [(1033, true), (1490, true), (1510, false), (400, false)] {
            monitor.last_used = Some(at(ms));
            assert_eq!(monitor.is_unconfirmed(), unconfirmed, "{ms} ms");
        }
    }

    #[test]
    fn three_responses_within_three_seconds_are_a_contradiction_until_three_seconds_passed() {
        let at = |s: i64| Stamp::from_nanos(s * 1_000_000_000);
        let mut monitor = ContradictionMonitor::default();
        for (second, contradicted) in [(0, false), (2, false), (5, false), (6, false), (7, true)] {
            monitor.responded(at(second));
            // A new pose does not change what happened.
            monitor.initialized(at(second));
            assert_eq!(monitor.is_contradicted(at(second)), contradicted, "{second}");
        }
        assert!(monitor.is_contradicted(at(9)) && !monitor.is_contradicted(at(10)));
        monitor.replaced(at(20));
        monitor.initialized(at(20));
        assert!(monitor.is_contradicted(at(20)) && !monitor.is_contradicted(at(21)));
        assert!(!monitor.is_contradicted(at(19)), "the clock was set back");
    }
}
