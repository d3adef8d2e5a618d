//! Initialization of the filter: from an image, again after an outage, and with the camera time
//! offset once it is known.

use super::{Filter, search};
use crate::{
    adaptation::{innovation_scale::PIXEL_NOISE, layout_misfit::LayoutMisfit},
    ekf::{
        calibration::Calibration,
        propagation::ImuReading,
        state::{
            ACCELEROMETER_BIAS, ATTITUDE, CLIMBER, CLIMBER_RATE, GYROSCOPE_BIAS, State, TIME_OFFSET,
        },
    },
    initialization::{
        ambiguity::Ambiguity,
        from_image::{self, Known},
        time_offset::TimeOffset,
    },
    input::{
        climber_track::ClimberAt,
        imu::{SWING_TILT, Up},
    },
    measurements::{
        Outcome,
        markers::{Image, Pixels},
    },
    output::Warning,
    timeline::{
        arrival::{AHEAD, Arrival, JUMP},
        history::Event,
    },
};
use nalgebra::{UnitQuaternion, Vector3};
use rig_model::Stamp;

/// An encoder reading further from the image than this initializes nothing, s.
const READING_NEAR: f64 = 1.0;
/// Smallest uncertainty of "up" of an estimate whose time offset is unknown, rad, and largest time
/// to the state that serves an instant, s.
const ESTIMATED_UP: f64 = 0.05;
const ESTIMATED_NEAR: f64 = 0.05;
/// The IMU's own attitude is wrong where another "up" is off by less than this share of it.
const OWN_WORSE: f64 = 0.5;
/// Factor on the sigmas of what was known before an outage or recovery.
const INFLATION: f64 = 2.0;
/// Smallest bias sigma after an outage, m/s² and rad/s.
const BIAS_FLOOR: f64 = 1e-4;
/// Smallest uncertainty of an initialized time offset, s, and factor on what its alignment claims.
pub(super) const OFFSET_SIGMA: [f64; 2] = [1e-3, 1.5];

/// What the initialization remembers.
#[derive(Clone, Debug, Default)]
pub(super) struct Start {
    /// Image to start from, while the IMU samples have not come so far.
    awaited: Option<(Stamp, Pixels)>,
    /// Images that allow several poses.
    pub(super) ambiguity: Option<Ambiguity>,
    /// Last state before an outage: its offset and biases serve the next start.
    pub(super) kept: Option<Box<State>>,
    /// Time of the kept state, where it may be resumed as a whole.
    pub(super) kept_at: Option<Stamp>,
    pub(super) time_offset: Option<TimeOffset>,
    /// Time offset with which the pose was initialized, s.
    pub(super) initial_offset: f64,
    /// Image since which the filter's time offset has not moved further than it corrects linearly,
    /// and that offset, s.
    pub(super) settled: (Stamp, f64),
    /// Newest image at which the filter did not know its time offset.
    pub(super) unknown: Stamp,
    /// The time offset was known before, and is searched because images contradict it.
    pub(super) searches_again: bool,
    /// Uncertainty of the time offset while it is searched, s, once there is an alignment.
    pub(super) offset_doubt: Option<f64>,
    /// Upward specific force of samples that cannot initialize the pose, m/s².
    pub(super) wrong_gravity: Option<f64>,
    /// Markers detected in the newest image.
    pub(super) markers_seen: usize,
}

/// It is not clear yet which of several poses is the right one.
struct Unclear;

impl Filter {
    /// Drops the pose and keeps offset, biases and noise: the next image initializes the pose.
    pub(super) fn restart(&mut self) {
        if let Some(state) = self.state().cloned() {
            self.start.kept = Some(Box::new(state));
        }
        self.archive_until(None);
        self.history.clear();
        self.arrival = Arrival::default();
        self.imu.interrupt();
        self.trust.reset();
        self.monitor.clear();
        (self.start.awaited, self.start.ambiguity) = (None, None);
    }

    /// While the IMU is silent images move the end of the time line.
    pub(super) fn follow_without_imu(&mut self, stamp: Stamp) {
        let at = stamp.plus_seconds(self.time_offset());
        if let (Some((since, _)), true) =
            (self.arrival.newest_imu(), self.publisher.note_imu_lost())
        {
            self.publisher.warn(Warning::ImuLost { since });
        }
        let ahead = self.arrival.end().map_or(0.0, |end| at.seconds_since(end));
        if self.is_started() && !(-JUMP..=AHEAD).contains(&ahead) {
            let arrival = self.arrival.clone();
            if ahead < 0.0 {
                // The clock was set back.
                self.publisher.warn(Warning::TimeJump { by_s: -ahead });
                self.reset();
            } else {
                // Neither images nor samples for a while: the image initializes the pose.
                self.restart();
            }
            self.arrival = arrival.beginning();
        }
        self.arrival.image(at);
    }

    /// What the estimate knows of "up" at an instant of the time line.
    pub(super) fn up_of_estimate(&self, at: Stamp) -> Option<Up> {
        let place = self.history.place_of(at).min(self.history.processed());
        let entry = self.history.get(place.checked_sub(1)?)?;
        let near = at.seconds_since(entry.stamp) < ESTIMATED_NEAR;
        let sigma = (3.0 * entry.state.sigmas(ATTITUDE).max()).max(ESTIMATED_UP);
        let in_imu = entry.state.attitude.inverse() * Vector3::z();
        near.then_some(Up { in_imu, sigma, is_specific_force: false })
    }

    /// Drops everything that was estimated: it was unsound.
    pub(super) fn reset_estimate(&mut self) {
        self.restart();
        self.images.layout = LayoutMisfit::default();
        self.start = Start { markers_seen: self.start.markers_seen, ..Start::default() };
        self.search = search(&self.setup.config);
    }

    /// Constants as a former pose knew them.
    pub(super) fn calibration(&self) -> Calibration {
        let kept = self.start.kept.as_deref().map(|kept| kept.calibration);
        let rotation = &self.setup.rig.imu.volant_from_imu.rotation;
        kept.unwrap_or_else(|| Calibration::new(&self.setup.config.imu, rotation))
    }

    /// Offset and biases from before an outage.
    pub(super) fn remember(&mut self, state: &mut State) {
        if let Some(found) = self.start.time_offset {
            state.time_offset = found.offset;
            state.set_sigma(TIME_OFFSET, (OFFSET_SIGMA[1] * found.sigma).max(OFFSET_SIGMA[0]));
        }
        if let Some(kept) = self.start.kept.take() {
            carry_over(state, &kept);
        }
    }

    /// Resumes a restored state, where it is so recent that an IMU sample at `stamp` continues it.
    pub(super) fn resume(&mut self, stamp: Stamp) -> bool {
        if self.setup.geometry.is_none() {
            return false;
        }
        let Some(at) = self.start.kept_at.take() else { return false };
        if !(0.0..crate::timeline::dropout::BRIDGED).contains(&stamp.seconds_since(at)) {
            return false;
        }
        let Some(state) = self.start.kept.take() else { return false };
        self.set_state(at, *state);
        true
    }

    /// Starts from an image, or keeps it until the IMU samples have come to its time.
    pub(super) fn start_or_wait(&mut self, stamp: Stamp, pixels: Pixels) {
        let at = stamp.plus_seconds(self.time_offset());
        let absent = self.arrival.is_imu_absent();
        if absent || self.arrival.newest_imu().is_some_and(|(newest, _)| at <= newest) {
            return self.try_start(stamp, &pixels, None);
        }
        // The first one is kept: were it replaced by each that follows, none would ever be reached.
        let stale =
            self.start.awaited.is_none_or(|(kept, _)| stamp.seconds_since(kept).abs() > AHEAD);
        if stale && pixels.iter().flatten().count() >= 3 {
            self.start.awaited = Some((stamp, pixels));
        } else {
            self.publisher.skip(stamp, &pixels, Outcome::NotInitialized);
        }
    }

    /// Starts from the awaited image where the IMU samples have come to its time.
    pub(super) fn start_from_awaited(&mut self, newest: Stamp) {
        let Some((image, pixels)) = self.start.awaited else { return };
        if image.plus_seconds(self.time_offset()) <= newest {
            self.start.awaited = None;
            self.try_start(image, &pixels, None);
        }
    }

    /// Initializes the pose from an image. `up` is what a former estimate knew of "up", where there
    /// was one; the IMU's own attitude counts more.
    pub(super) fn try_start(&mut self, stamp: Stamp, pixels: &Pixels, up: Option<Up>) {
        let time_offset = self.time_offset();
        let at = stamp.plus_seconds(time_offset);
        let absent = self.arrival.is_imu_absent();
        let measured = absent || self.history.iter().any(|e| e.is_imu() && e.stamp <= at);
        let Some(climber) = self.climber_at(stamp) else {
            return self.publisher.skip(stamp, pixels, Outcome::NotInitialized);
        };
        let enough = pixels.iter().flatten().count() >= 3;
        self.start.wrong_gravity =
            self.imu.wrong_gravity(at, &self.history, self.setup.config.gravity);
        if !enough || !measured || self.setup.frozen {
            return self.publisher.skip(stamp, pixels, Outcome::NotInitialized);
        }
        if !absent && self.start.wrong_gravity.is_some() {
            return self.publisher.skip(stamp, pixels, Outcome::NotInitialized);
        }
        let mut image = Image::new(pixels, time_offset, climber.rest);
        image.shake = self.shake_variance().map(|v| v as f32).into();
        let [own, estimated] = [self.imu.verticals.at(at), up];
        let ups = [own, estimated.or_else(|| self.imu.force_up_at(at, &self.history))];
        let known = self.calibration();
        // A former estimate tells the poses apart.
        let clear = match estimated {
            Some(_) => Ok(None),
            None => self.clear_attitude(at, &image, own.or(ups[1]), &climber, &known),
        };
        let Ok(toward) = clear else {
            return self.publisher.skip(stamp, pixels, Outcome::NotInitialized);
        };
        let Some(start) = self.likeliest_start(at, &image, ups, &climber, &known, toward) else {
            return self.publisher.skip(stamp, pixels, Outcome::Inconsistent);
        };
        self.publisher.record(stamp, &start.record, false);
        self.monitor.initialized(stamp);
        self.publisher.warn(Warning::Initialized { stamp });
        self.images.pixel_noise.raise(start.noise_factor, &PIXEL_NOISE);
        self.images.shake.interrupt(stamp, &start.record);
        let mut state = start.state;
        self.remember(&mut state);
        self.set_state(at, state);
    }

    /// Returns the attitude of the IMU (`world_from_imu`) to initialize the pose with, where three
    /// markers allow several; `None`: the likeliest one. The error: it is not clear yet.
    fn clear_attitude(
        &mut self,
        at: Stamp,
        image: &Image,
        up: Option<Up>,
        climber: &ClimberAt,
        calibration: &Calibration,
    ) -> Result<Option<UnitQuaternion<f64>>, Unclear> {
        let before = self.start.ambiguity.take();
        let geometry = self.setup.geometry.as_ref().filter(|_| image.detected() == 3);
        let Some(geometry) = geometry.filter(|_| !self.arrival.is_imu_absent()) else {
            return Ok(None);
        };
        let config = &self.setup.config;
        let known = Known { geometry, config, climber, calibration, toward: None };
        let poses = from_image::attitudes(&known, image, up.as_ref());
        let turn = |since: Stamp| self.history.turn(since, at);
        Ambiguity::resolve(before, at, poses, turn).map_err(|open| {
            self.start.ambiguity = Some(open);
            Unclear
        })
    }

    /// Returns the initial state from an image. `ups` are the IMU's own attitude, and what else is
    /// known of "up". Where the markers reject the IMU's own attitude and agree better with the
    /// other, it is not used any more: on a platform that swings it may be off by far more than the
    /// IMU claims. It still chooses between two poses that are mirrored.
    fn likeliest_start(
        &mut self,
        at: Stamp,
        image: &Image,
        ups: [Option<Up>; 2],
        climber: &ClimberAt,
        calibration: &Calibration,
        toward: Option<UnitQuaternion<f64>>,
    ) -> Option<from_image::InitialEstimate> {
        let (geometry, config) = (self.setup.geometry.as_ref()?, &self.setup.config);
        let known = Known { geometry, config, climber, calibration, toward };
        let start = |up: Option<&Up>| from_image::start(&known, image, up);
        let [own, other] = ups;
        if let Some(found) = start(own.or(other).as_ref()) {
            return Some(found);
        }
        let (own, other) = (own?, other?);
        let found = start(Some(&Up { sigma: SWING_TILT.max(own.sigma), ..own }))?;
        let angle = |up: &Up| (found.state.attitude * up.in_imu).angle(&Vector3::z());
        let angle_rad = angle(&own);
        // An IMU that is mounted otherwise has both off by the same angle.
        if angle(&other) > OWN_WORSE * angle_rad {
            return None;
        }
        self.imu.ignore_attitude();
        self.publisher.warn(Warning::ImuAttitude { stamp: at, angle_rad });
        Some(found)
    }

    /// Returns the climber by its encoders at an image, where readings are near and do not leap.
    pub(super) fn climber_at(&self, image: Stamp) -> Option<ClimberAt> {
        let read = image.plus_seconds(-self.setup.config.clock.climber_offset);
        let climber = self.climber.at(read).filter(|climber| climber.distance <= READING_NEAR);
        climber.filter(|_| !self.climber.leaps_near(read))
    }

    /// Puts a state at an instant of the time line and processes what is behind it.
    pub(super) fn set_state(&mut self, at: Stamp, state: State) {
        self.trust.directions.interrupt();
        let image = at.plus_seconds(-state.time_offset);
        self.start.initial_offset = state.time_offset;
        self.start.settled = (image, state.time_offset);
        self.start.unknown = image;
        let place = self.history.place_of(at);
        let before = place.checked_sub(1).and_then(|p| self.history.get(p));
        let reading = match (before, self.history.next_imu(place)) {
            (Some(before), Some(next)) if before.is_imu() => {
                let span = next.stamp.seconds_since(before.stamp);
                let share = if span > 0.0 { at.seconds_since(before.stamp) / span } else { 0.0 };
                before.reading.lerp(&next.reading, share.clamp(0.0, 1.0))
            }
            (_, Some(next)) => next.reading,
            (_, None) => match self.arrival.newest_imu() {
                Some((_, reading)) => reading,
                None => ImuReading::of_uniform_motion(&state, self.setup.config.gravity),
            },
        };
        for _ in 0..place {
            self.publisher
                .archive
                .add(self.history.get(0).filter(|_| self.history.processed() > 0));
            self.history.drop_first();
        }
        let place = self.history.insert(at, Event::Set, reading);
        if let Some(entry) = self.history.get_mut(place) {
            entry.state = state;
        }
        self.history.set_processed(1);
        self.monitor.note_start(image);
        self.process();
    }

    /// Reinitializes the pose from an image whose markers agree with each other; `uses_up`: with
    /// the IMU's direction of "up" as a prior. Returns whether the time line was replaced.
    pub(super) fn reinitialize(
        &mut self,
        stamp: Stamp,
        image: &Image,
        since: Stamp,
        uses_up: bool,
    ) -> bool {
        let Some(old) = self.state().cloned() else { return false };
        // Behind the image's place on the time line, so that the image is not used once more.
        let at = stamp.plus_seconds(old.time_offset.max(image.time_offset));
        let mut image = *image;
        image.time_offset = old.time_offset;
        let ups = [self.imu.verticals.at(at), self.imu.force_up_at(at, &self.history)];
        let ups = ups.map(|up| up.filter(|_| uses_up));
        // What contradicted the images has moved the climber of the state, too.
        let trusted = (!self.trust.is_suspended()).then(|| self.climber_at(stamp)).flatten();
        let climber = trusted.unwrap_or_else(|| ClimberAt {
            values: old.climber,
            rates: old.climber_rate,
            noise: Vector3::zeros(),
            growth: old.sigmas(CLIMBER),
            rate_sigmas: old.sigmas(CLIMBER_RATE),
            distance: 0.0,
            rest: image.rest,
        });
        let Some(start) = self.likeliest_start(at, &image, ups, &climber, &old.calibration, None)
        else {
            return false;
        };
        self.images.pixel_noise.raise(start.noise_factor, &PIXEL_NOISE);
        self.images.shake.interrupt(stamp, &start.record);
        let mut state = start.state;
        carry_over(&mut state, &old);
        state.climber_acceleration = old.climber_acceleration;
        self.monitor.initialized(stamp);
        self.publisher.warn(Warning::LockOutRecovered { since, stamp });
        self.set_state(at, state);
        true
    }
}

/// Takes over offset and biases of a former state; the biases count half.
fn carry_over(state: &mut State, former: &State) {
    state.accelerometer_bias = former.accelerometer_bias;
    state.gyroscope_bias = former.gyroscope_bias;
    state.time_offset = former.time_offset;
    state.set_sigma(TIME_OFFSET, former.sigma(TIME_OFFSET));
    for first in [ACCELEROMETER_BIAS, GYROSCOPE_BIAS] {
        let sigmas = former.sigmas(first).map(|sigma| (INFLATION * sigma).max(BIAS_FLOOR));
        state.set_sigmas(first, &sigmas);
    }
}
