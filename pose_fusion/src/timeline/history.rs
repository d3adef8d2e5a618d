//! Measurements in the order of their own time, with the state after each, from a store that is
//! reused. It is trimmed to the configured time: 0.6 s at 100 Hz, 50 Hz and 30 Hz are 108 entries
//! of about 9.2 kB. It never holds more than [`CAPACITY`] entries; what that drops is counted.

use crate::{
    adaptation::imu_noise::Densities,
    ekf::{
        propagation::{ImuReading, Motion, ProcessNoise},
        state::State,
    },
    measurements::{encoders::EncoderReading, markers::Image},
};
use nalgebra::{UnitQuaternion, Vector3};
use rig_model::Stamp;
use std::collections::VecDeque;

/// Largest number of entries: 1 s of 1,000 IMU samples, 200 readings and 200 images per second.
pub const CAPACITY: usize = 1400;

/// Half the width of the triangular mean of the IMU readings that is taken as the motion at an
/// image, s.
const SMOOTHING: f64 = 0.03;

/// What happened at an instant.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The state was set (initialization, pose set by an operator).
    Set,
    /// IMU sample.
    Imu {
        /// Noise densities of the step to this sample.
        noise: Densities,
        /// What of it comes from images that contradicted the prediction.
        doubt: Densities,
        /// Mean angular velocity of the window that ends here, where at rest, rad/s.
        at_rest: Option<Vector3<f64>>,
    },
    /// Image.
    Image {
        /// Markers.
        image: Image,
        /// Stamp of the image, camera time.
        stamp: Stamp,
        /// Not processed yet: its record is still to be published.
        fresh: bool,
        /// Its markers correct the state; those of a frozen filter are only compared.
        apply: bool,
    },
    /// Encoder reading.
    Encoders {
        /// Reading.
        reading: EncoderReading,
        /// Excluded as an outlier or while the encoders are not trusted.
        excluded: bool,
        /// Not processed yet.
        fresh: bool,
    },
}

/// Event with the IMU reading and the state after it.
#[derive(Clone, Debug)]
pub struct Entry {
    /// IMU time.
    pub stamp: Stamp,
    /// Event.
    pub event: Event,
    /// IMU reading at that time, interpolated unless the event is an IMU sample.
    pub reading: ImuReading,
    /// The same with less noise at images, see [`History::motion`]; valid where processed.
    pub motion: Motion,
    /// Process noise of the step to this entry; valid where processed.
    pub noise: ProcessNoise,
    /// State after the event; valid where processed.
    pub state: State,
    /// Time since a marker last corrected the state, s; valid where processed.
    pub unseen: f64,
}

impl Entry {
    /// Returns whether the event is an IMU sample.
    pub fn is_imu(&self) -> bool {
        matches!(self.event, Event::Imu { .. })
    }
}

/// Entries in the order of time.
#[derive(Clone, Debug, Default)]
pub struct History {
    entries: VecDeque<Box<Entry>>,
    /// Entries that are reused: nothing is allocated once the history is as long as configured.
    free: Vec<Box<Entry>>,
    processed: usize,
    /// Entries that were dropped because the history was full.
    pub overflows: u64,
    /// Half the width of the mean that was taken as the motion at the newest image, s.
    pub smoothing: f64,
}

#[allow(clippy::len_without_is_empty, reason = "nobody asks")]
impl History {
    /// Removes all entries.
    pub fn clear(&mut self) {
        self.free.extend(self.entries.drain(..));
        self.processed = 0;
    }

    /// Returns the number of entries.
    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// Returns how many of the first entries hold a valid state.
    pub fn processed(&self) -> usize {
        self.processed
    }

    /// Sets how many of the first entries hold a valid state.
    pub fn set_processed(&mut self, processed: usize) {
        self.processed = processed.min(self.entries.len());
    }

    /// Marks everything from `place` on, but for the first entry, as to be processed again.
    pub fn rewind(&mut self, place: usize) {
        self.processed = self.processed.min(place.max(1));
    }

    /// Returns the entry at a place.
    pub fn get(&self, place: usize) -> Option<&Entry> {
        self.entries.get(place).map(|entry| &**entry)
    }

    /// Returns the entry at a place, mutable.
    pub fn get_mut(&mut self, place: usize) -> Option<&mut Entry> {
        self.entries.get_mut(place).map(|entry| &mut **entry)
    }

    /// Returns the newest entry with a valid state.
    pub fn newest_processed(&self) -> Option<&Entry> {
        self.get(self.processed.checked_sub(1)?)
    }

    /// Returns the entries in the order of time.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &Entry> + ExactSizeIterator {
        self.entries.iter().map(|entry| &**entry)
    }

    /// Returns the entries before a place, the newest first.
    pub fn before(&self, place: usize) -> impl Iterator<Item = &Entry> {
        self.entries.range(..place.min(self.len())).rev().map(|entry| &**entry)
    }

    /// Returns the IMU samples at and behind a place.
    fn imu_from(&self, place: usize) -> impl DoubleEndedIterator<Item = &Entry> {
        let entries = self.entries.range(place.min(self.len())..);
        entries.map(|entry| &**entry).filter(|entry| entry.is_imu())
    }

    /// Returns the place of an event at this stamp: behind all that are not later.
    pub fn place_of(&self, stamp: Stamp) -> usize {
        self.len() - self.iter().rev().take_while(|entry| entry.stamp > stamp).count()
    }

    /// Inserts an event and returns its place. Everything from there on is to be processed (again);
    /// where the history is full the oldest entry is dropped and counted.
    pub fn insert(&mut self, stamp: Stamp, event: Event, reading: ImuReading) -> usize {
        if self.len() == CAPACITY {
            self.overflows += 1;
            self.drop_first();
        }
        let place = self.place_of(stamp);
        let motion = reading.into();
        let entry = match self.free.pop() {
            Some(mut entry) => {
                (entry.stamp, entry.event, entry.unseen) = (stamp, event, 0.0);
                (entry.reading, entry.motion) = (reading, motion);
                entry
            }
            None => {
                let (noise, state) = (ProcessNoise::default(), State::zero());
                Box::new(Entry { stamp, event, reading, motion, noise, state, unseen: 0.0 })
            }
        };
        self.entries.insert(place, entry);
        self.processed = self.processed.min(place);
        place
    }

    /// Removes the oldest entry.
    pub fn drop_first(&mut self) {
        if let Some(entry) = self.entries.pop_front() {
            self.free.push(entry);
            self.processed = self.processed.saturating_sub(1);
        }
    }

    /// Returns the entries at `place - 1` and `place`, for a step from one to the other.
    pub fn step(&mut self, place: usize) -> Option<(&Entry, &mut Entry)> {
        let places = [place.checked_sub(1)?, place];
        let [from, to] = self.entries.make_contiguous().get_disjoint_mut(places).ok()?;
        Some((&**from, &mut **to))
    }

    /// Returns the `count`-th encoder reading before a place, or the oldest, with its stamp.
    pub fn reading_before(&self, place: usize, count: usize) -> Option<(usize, Stamp)> {
        let used = |e: &Entry| matches!(e.event, Event::Encoders { excluded: false, .. });
        let before = self.before(place).enumerate().filter(|(_, entry)| used(entry));
        before.take(count).last().map(|(k, entry)| (place - 1 - k, entry.stamp))
    }

    /// Returns the next IMU sample at or behind a place.
    pub fn next_imu(&self, place: usize) -> Option<&Entry> {
        self.imu_from(place).next()
    }

    /// Returns by how much the IMU has turned between two instants (`from_to`), by its samples.
    pub fn turn(&self, from: Stamp, to: Stamp) -> UnitQuaternion<f64> {
        let mut turned = UnitQuaternion::identity();
        let mut last = from;
        for entry in self.imu_from(self.place_of(from)) {
            let until = entry.stamp.min(to);
            let step = entry.reading.angular_velocity * until.seconds_since(last);
            turned *= UnitQuaternion::from_scaled_axis(step);
            last = until;
            if entry.stamp >= to {
                break;
            }
        }
        turned
    }

    /// Returns the motion at an entry as the triangular mean of the readings before and after it,
    /// and half the width of that mean, s. A mean of past readings alone would have the noise in
    /// common with the attitude that they were integrated to.
    pub fn motion(&self, place: usize) -> Option<(Motion, f64)> {
        let at = self.get(place)?.stamp;
        let distance = |entry: &Entry| entry.stamp.seconds_since(at);
        let newest = self.imu_from(place).next_back()?;
        let half = SMOOTHING.min(distance(newest));
        let before = self.before(place).filter(|entry| entry.is_imu());
        let after = self.imu_from(place);
        let near = |entry: &&Entry| distance(entry).abs() < half;
        let mut sum = ImuReading::default();
        let (mut weights, mut sides) = (0.0, [0; 2]);
        for entry in before.take_while(near).chain(after.take_while(near)) {
            let weight = 1.0 - distance(entry).abs() / half;
            sum.specific_force += entry.reading.specific_force * weight;
            sum.angular_velocity += entry.reading.angular_velocity * weight;
            weights += weight;
            sides[usize::from(distance(entry) > 0.0)] += 1;
        }
        let mean = ImuReading {
            specific_force: sum.specific_force / weights,
            angular_velocity: sum.angular_velocity / weights,
        };
        (sides[0] > 0 && sides[1] > 0).then(|| (mean.into(), half))
    }

    /// Returns the last IMU sample, or set state, before a place.
    pub fn last_imu(&self, place: usize) -> Option<&Entry> {
        self.before(place).find(|entry| matches!(entry.event, Event::Imu { .. } | Event::Set))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ms: i64) -> Stamp {
        Stamp::from_nanos(ms * 1_000_000)
    }

    #[test]
    fn events_are_ordered_by_their_own_time_and_reprocessed_from_there() {
        let mut history = History::default();
        for ms in [0, 10, 30, 40] {
            history.insert(at(ms), Event::Set, ImuReading::default());
        }
        history.set_processed(4);
        assert_eq!(history.insert(at(20), Event::Set, ImuReading::default()), 2);
        assert_eq!(history.processed(), 2);
        assert!(history.iter().zip(history.iter().skip(1)).all(|(a, b)| a.stamp < b.stamp));
        history.drop_first();
        assert_eq!((history.len(), history.processed()), (4, 1));
        history.rewind(0);
        assert_eq!(history.processed(), 1);
    }

    /// A mean of past readings would lag behind a ramp and share noise with the attitude.
    #[test]
    fn the_motion_at_an_image_reaches_as_far_back_as_samples_follow() {
        let reading = |ms: i64| ImuReading {
            specific_force: Vector3::new(0.1 * ms as f64, 0.0, 9.8),
            angular_velocity: Vector3::new(0.0, 1.0 - 0.02 * ms as f64, 0.0),
        };
        for (period, follow, expected) in [
            (1, 40, Some(0.03)),
            (10, 40, Some(0.03)),
            (1, 20, Some(0.02)),
            (5, 10, Some(0.01)),
            (1, 0, None),
            (50, 40, None),
        ] {
            let mut history = History::default();
            for ms in (0..=100 + follow).step_by(period) {
                let event = Event::Imu {
                    noise: Densities::default(),
                    doubt: Densities::default(),
                    at_rest: None,
                };
                history.insert(at(ms), event, reading(ms));
            }
            let place = history.insert(at(100), Event::Set, reading(100));
            let motion = history.motion(place);
            let half_width = motion.map(|(_, half_width)| half_width);
            assert_eq!(half_width, expected, "{period} ms, {follow} ms");
            if let Some((motion, _)) = motion {
                let exact = Motion::from(reading(100));
                let [force, rate] = [motion.force - exact.force, motion.rate - exact.rate];
                assert!(force.amax() < 1e-5 && rate.amax() < 1e-6, "{period} {follow}: {motion:?}");
            }
        }
    }

    #[test]
    fn a_full_history_drops_the_oldest_and_counts_it() {
        let mut history = History::default();
        for ms in 0..CAPACITY as i64 + 5 {
            history.insert(at(ms), Event::Set, ImuReading::default());
        }
        assert_eq!((history.len(), history.overflows), (CAPACITY, 5));
        assert_eq!(history.get(0).unwrap().stamp, at(5));
    }
}
