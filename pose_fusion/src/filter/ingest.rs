//! Inputs of the filter: each message is checked and put in its place on the time line.

use super::{Filter, processing::OFFSET_DOUBTED};
use crate::{
    adaptation::{imu_integrity::ImuIntegrity, imu_noise::Densities, stamp_jitter},
    ekf::{propagation::ImuReading, state::ATTITUDE},
    input::{climber_track::ClimberTrack, imu_stamps::Bursts, markers},
    measurements::{
        Outcome, encoders::EncoderReading, geometry::ClimberHeightTilt, markers::Image,
    },
    output::Warning,
    timeline::{
        arrival::{AHEAD, ImuArrival, JUMP, Source},
        dropout::{BRIDGED, GAP},
        history::{CAPACITY, Entry, Event},
    },
};
use nalgebra::Vector3;
use rig_model::{ClimberSample, ImuSample, MarkerObservations, Sample, Stamp};

/// Largest standard deviation of the attitude with which the pose goes on after a gap, rad.
const LARGEST_ATTITUDE: f64 = 0.2;
/// Samples further apart than this many periods have a gap between them.
const FILLED: f64 = 1.5;
/// Smallest uncertainty of the IMU's own roll and pitch, rad.
const SMALLEST_ATTITUDE: f64 = 0.01;

impl Filter {
    /// Takes in one input.
    pub fn handle(&mut self, input: &Sample) {
        match input {
            Sample::Imu(sample) => {
                let stamp = self.imu_stamp(sample);
                self.imu(&ImuSample { stamp, ..*sample });
            }
            Sample::Markers(observations) => self.markers(observations),
            Sample::Climber(sample) => self.climber(sample),
            Sample::Camera(camera) => self.camera(camera),
        }
    }

    /// Counts an input that is rejected, and outputs why.
    pub fn reject(&mut self, why: Warning) {
        self.publisher.warn(why);
    }

    /// Returns the stamp with which an IMU sample counts. Where it turns out that the samples come
    /// in bursts, everything is identified again with their right stamps.
    fn imu_stamp(&mut self, sample: &ImuSample) -> Stamp {
        let known = self.imu.stamps.bursts.is_some();
        let reading = ImuReading::from(sample);
        let repeated = self.arrival.newest_imu().is_some_and(|(_, newest)| newest == reading);
        let stamp = self.imu.stamps.add(sample.stamp, repeated);
        if let (false, Some(Bursts { period, samples })) = (known, self.imu.stamps.bursts) {
            self.publisher.warn(Warning::ImuBursts { samples, every_s: samples * period });
            self.reset();
        }
        stamp
    }

    /// Takes in an IMU sample: moves the estimate to its stamp and publishes it.
    fn imu(&mut self, sample: &ImuSample) {
        let (from, stamp, reading) = (Source::Imu, sample.stamp, ImuReading::from(sample));
        if let Err(what) = ImuIntegrity::check(&reading) {
            return self.publisher.warn(Warning::NotFinite { from, stamp, what });
        }
        match self.arrival.classify(stamp) {
            ImuArrival::First => self.newer_imu(sample, reading, None),
            ImuArrival::Next(dt) => self.newer_imu(sample, reading, Some(dt)),
            ImuArrival::NotNewer => self.late_imu(sample, reading),
            ImuArrival::Unconfirmed(ahead_s) => {
                self.publisher.warn(if ahead_s < 0.0 {
                    Warning::TooOld { from, stamp, age_s: -ahead_s }
                } else {
                    Warning::Ahead { from, stamp, ahead_s }
                });
            }
            ImuArrival::Back(by_s) => self.set_back(sample, reading, by_s),
        }
    }

    /// Takes in a sample `dt` seconds after the one before.
    fn newer_imu(&mut self, sample: &ImuSample, reading: ImuReading, dt: Option<f64>) {
        let jump = dt.map_or(0.0, |dt| dt - self.imu.noise.period());
        let offset = self.time_offset();
        self.imu.clocks.imu(sample.stamp, jump, offset);
        self.next_imu(sample, reading, dt);
    }

    /// Starts again with a sample of an IMU whose clock was set back.
    fn set_back(&mut self, sample: &ImuSample, reading: ImuReading, by_s: f64) {
        let offset = self.time_offset();
        self.imu.clocks.imu(sample.stamp, -by_s, offset);
        self.publisher.warn(Warning::TimeJump { by_s });
        self.reset();
        self.next_imu(sample, reading, None);
    }

    /// Notes when an image or encoder reading arrives, which may confirm that a clock stepped.
    fn note_arrival(&mut self, source: Source, stamp: Stamp) {
        let offset = self.time_offset();
        let Some(step) = self.imu.clocks.message(source, stamp, offset) else { return };
        self.publisher.warn(Warning::ClockStep { by_s: step.by });
        if self.setup.config.clock.camera_sigma > 0.0 {
            let before = self.setup.stepped.unwrap_or(step.offset);
            self.setup.stepped = Some(before + step.by);
            self.follow_clock_step();
        }
    }

    /// Starts again with the time offset that follows from a step of a clock, unless the filter is
    /// frozen.
    pub(super) fn follow_clock_step(&mut self) {
        if let (Some(camera_offset), false) = (self.setup.stepped, self.setup.frozen) {
            self.setup.camera_offset = camera_offset;
            self.setup.stepped = None;
            self.reset();
        }
    }

    fn next_imu(&mut self, sample: &ImuSample, reading: ImuReading, dt: Option<f64>) {
        if let (Some(first), true) = (self.history.get(0), self.is_started())
            && sample.stamp <= first.stamp
        {
            // Held back until after an image alone had initialized the pose, or of a clock that is
            // behind: the pose goes on without it until its stamps have come to the images'.
            let behind_s = first.stamp.seconds_since(sample.stamp);
            return self.publisher.warn(Warning::BehindImages { stamp: sample.stamp, behind_s });
        }
        let mut dt = dt;
        if let (Some(seconds), Some((from, _))) =
            (dt.filter(|dt| *dt > GAP), self.arrival.newest_imu())
        {
            self.publisher.warn(Warning::ImuGap { from, to: sample.stamp });
            self.imu.interrupt();
            if let (Some(search), true) = (&mut self.search, seconds > BRIDGED) {
                search.clear();
            }
            let covered = self.publisher.markers_used == 4
                && (self.arrival.end())
                    .is_some_and(|end| sample.stamp.seconds_since(end) < BRIDGED);
            // What neither samples nor images with four markers have followed is not bridged where
            // an image can reinitialize the pose (three markers may have followed the mirrored
            // tilt; a frozen filter uses none), and an attitude that is hardly known is no point
            // to linearize at.
            let unknown = self.state().is_some_and(|s| s.sigmas(ATTITUDE).max() > LARGEST_ATTITUDE);
            let unfollowed = seconds > BRIDGED && !covered && self.start.markers_seen >= 3;
            if self.is_started() && !self.setup.frozen && (unfollowed || unknown) {
                self.restart();
                dt = None;
            }
        }
        let mounting = &self.setup.rig.imu;
        let event = self.imu.event(&reading, dt, mounting, self.images.model_error.factor);
        if let Some(more) = self.imu.newly_known_noise(mounting) {
            self.reweigh_samples(&more);
        }
        self.imu.remember_attitude(sample, SMALLEST_ATTITUDE);
        let place = self.history.insert(sample.stamp, event, reading);
        self.publisher.note_now(sample.stamp);
        // While the time offset is not known, images contradict the samples, and an image that was
        // first processed without them is not judged again.
        if self.offset_doubt() <= OFFSET_DOUBTED {
            self.interpolate_again(place);
        }
        self.arrival.imu(sample.stamp, reading);
        if let Some(search) = &mut self.search {
            if self.imu.integrity.hides_motion {
                search.clear();
            } else {
                search.add_reading(sample.stamp, &reading);
            }
        }
        self.trim(self.arrival.end().unwrap_or(sample.stamp));
        if self.is_started() {
            self.process();
            self.publish();
        } else if self.resume(sample.stamp) {
            self.publish();
        } else {
            self.start_from_awaited(sample.stamp);
        }
    }

    /// Processes again what was interpolated over the place of a new IMU sample, or followed
    /// without it: back to the sample before.
    fn interpolate_again(&mut self, place: usize) {
        let measured = |n: &&Entry| !matches!(n.event, Event::Imu { .. } | Event::Set);
        let between = self.history.before(place).take_while(measured).count();
        self.history.rewind(place - between);
    }

    fn late_imu(&mut self, sample: &ImuSample, reading: ImuReading) {
        let stamp = sample.stamp;
        let place = self.history.place_of(stamp);
        let before = self.history.before(place).take_while(|entry| entry.stamp == stamp);
        let same = before.filter(|entry| entry.is_imu()).map(|entry| entry.reading).next();
        if same == Some(reading) {
            return self.publisher.warn(Warning::Duplicate { from: Source::Imu, stamp });
        }
        if let Some(by_s) = self.arrival.late_imu(stamp, self.fills_gap(place)) {
            return self.set_back(sample, reading, by_s);
        }
        if same.is_some() {
            return self.publisher.warn(Warning::Duplicate { from: Source::Imu, stamp });
        }
        if place == 0 {
            let age_s = self.age(stamp);
            return self.publisher.warn(Warning::TooOld { from: Source::Imu, stamp, age_s });
        }
        self.publisher.counts.inputs.late_imu += 1;
        let noise = self.imu.densities(&self.setup.rig.imu);
        let event = Event::Imu { noise, doubt: Densities::default(), at_rest: None };
        let place = self.history.insert(stamp, event, reading);
        self.interpolate_again(place);
        self.process();
    }

    /// Whether the IMU samples around a place are so far apart that one is missing between them.
    fn fills_gap(&self, place: usize) -> bool {
        let before = self.history.before(place).find(|entry| entry.is_imu());
        let interval = before.zip(self.history.next_imu(place));
        interval
            .is_some_and(|(b, a)| a.stamp.seconds_since(b.stamp) > FILLED * self.imu.noise.period())
    }

    /// Takes in the markers of an image.
    fn markers(&mut self, observations: &MarkerObservations) {
        let stamp = observations.stamp;
        self.publisher.counts.inputs.images += 1;
        let (config, noise) = (&self.setup.config.markers, self.images.pixel_noise.factor);
        let pixels = markers::pixels(observations, config, noise, |w| self.publisher.warn(w));
        self.start.markers_seen = pixels.iter().flatten().count();
        if self.images.stamps.contains(&stamp) {
            return self.publisher.warn(Warning::Duplicate { from: Source::Image, stamp });
        }
        self.note_arrival(Source::Image, stamp);
        if let Some(by_s) = self.arrival.other(Source::Image, stamp) {
            self.publisher.warn(Warning::Jump { from: Source::Image, stamp, by_s });
            return self.publisher.skip(stamp, &pixels, Outcome::Rejected);
        }
        let silent = self.arrival.is_imu_silent();
        let newest = self.arrival.newest_imu().map(|(newest, _)| newest);
        if self.setup.geometry.is_none() || (newest.is_none() && !silent) {
            return self.publisher.skip(stamp, &pixels, Outcome::NotInitialized);
        }
        let camera_offset = self.setup.camera_offset;
        let ahead_s =
            newest.map_or(0.0, |newest| stamp.plus_seconds(camera_offset).seconds_since(newest));
        if ahead_s > AHEAD && !silent {
            self.publisher.warn(Warning::Ahead { from: Source::Image, stamp, ahead_s });
            return self.publisher.skip(stamp, &pixels, Outcome::Rejected);
        }
        self.images.remember(stamp);
        self.publisher.note_now(stamp.plus_seconds(self.time_offset()));
        if silent {
            self.follow_without_imu(stamp);
        }
        if !self.is_started() {
            self.start_or_wait(stamp, pixels);
            if silent && self.is_started() {
                self.publish();
            }
            return;
        }
        let time_offset = self.time_offset();
        let at = stamp.plus_seconds(time_offset);
        if self.history.get(0).is_none_or(|first| at <= first.stamp) {
            self.publisher.warn(Warning::TooOld { from: Source::Image, stamp, age_s: -ahead_s });
            return self.publisher.skip(stamp, &pixels, Outcome::Rejected);
        }
        let Some((_, _, rest)) = self.climber.newest().copied() else {
            return self.publisher.skip(stamp, &pixels, Outcome::NotInitialized);
        };
        let jitter = stamp_jitter::sigma(&self.images.stamps);
        let stamp_sigma = jitter.min(self.setup.config.clock.image_jitter);
        let layout_doubt = self.images.layout.doubt.take();
        if let (Some(_), Some(search)) = (layout_doubt, &mut self.search) {
            // The image poses that it has are tilted by the layout's error.
            search.clear();
        }
        let mut image = Image::new(&pixels, time_offset, rest);
        image.stamp_sigma = stamp_sigma as f32;
        image.shake = self.shake_variance().map(|v| v as f32).into();
        image.layout_doubt = layout_doubt.map(|sigma| sigma as f32);
        let event = Event::Image { image, stamp, fresh: true, apply: !self.setup.frozen };
        self.history.insert(at, event, ImuReading::default());
        self.process();
        if !self.setup.frozen {
            self.search_time_offset(stamp, &pixels);
        }
        if silent {
            self.trim(self.arrival.end().unwrap_or(at));
            self.publish();
        }
    }

    /// Takes in an encoder reading.
    fn climber(&mut self, sample: &ClimberSample) {
        let (stamp, from) = (sample.stamp, Source::Encoders);
        let Some((values, rest)) = ClimberHeightTilt::split(&sample.world_from_climber) else {
            return self.publisher.warn(Warning::NotFinite { from, stamp, what: "the pose" });
        };
        self.note_arrival(from, stamp);
        if let Some(by_s) = self.arrival.other(from, stamp) {
            return self.publisher.warn(Warning::Jump { from, stamp, by_s });
        }
        let config = &self.setup.config;
        let offset = self.setup.camera_offset + config.clock.climber_offset;
        let imu = self.arrival.newest_imu().filter(|_| !self.arrival.is_imu_silent());
        let ahead = |at: Stamp| imu.map(|(imu, _)| at.plus_seconds(offset).seconds_since(imu));
        if let Some(ahead_s) = ahead(stamp).filter(|ahead_s| *ahead_s > AHEAD) {
            return self.publisher.warn(Warning::Ahead { from, stamp, ahead_s });
        }
        let newest = self.climber.newest().map(|(newest, _, _)| *newest);
        let from_the_future = |newest: &Stamp| {
            newest.seconds_since(stamp) > JUMP && ahead(*newest).is_none_or(|by| by > JUMP)
        };
        if newest.as_ref().is_some_and(from_the_future) {
            self.climber = ClimberTrack::new(&config.climber);
        }
        let rates = self.climber.at(stamp).map_or(Vector3::zeros(), |climber| climber.rates);
        let Some((variance, multiplicity)) = self.climber.add(stamp, values, rest) else {
            return self.publisher.warn(Warning::Duplicate { from, stamp });
        };
        if self.climber.noise.is_young() {
            self.reweigh_readings(&variance);
        }
        let time_offset = self.encoder_offset();
        let at = stamp.plus_seconds(time_offset);
        let end = self.arrival.end().unwrap_or(at);
        self.climber.note_latency(end.seconds_since(at));
        if self.is_started() && self.history.get(0).is_none_or(|first| at <= first.stamp) {
            let age_s = self.age(stamp);
            return self.publisher.warn(Warning::TooOld { from, stamp, age_s });
        }
        let reading = EncoderReading {
            values,
            rates,
            variance: variance.component_mul(&multiplicity),
            multiplicity,
            time_offset,
        };
        self.publisher.note_now(at);
        let ahead_s = at.seconds_since(end);
        if ahead_s > AHEAD && self.history.len() > CAPACITY / 2 {
            // For a long time neither IMU samples nor images have come, which would process it: it
            // must not push out the newest state.
            return self.publisher.warn(Warning::NotKept { from, stamp, ahead_s });
        }
        let event = Event::Encoders { reading, excluded: self.trust.is_suspended(), fresh: true };
        self.history.insert(at, event, ImuReading::default());
        if self.is_started() {
            self.process();
        } else {
            self.trim(at.max(end));
        }
    }

    /// Time from a stamp to the newest IMU sample, s.
    fn age(&self, stamp: Stamp) -> f64 {
        self.arrival.newest_imu().map_or(0.0, |(newest, _)| newest.seconds_since(stamp))
    }

    /// Drops what is older than the configured history before `newest`.
    fn trim(&mut self, newest: Stamp) {
        let oldest = newest.plus_seconds(-self.setup.config.history);
        let started = self.is_started();
        while self.history.len() > 2
            && (!started || self.history.processed() > 1)
            && self.history.get(1).is_some_and(|n| n.stamp < oldest)
        {
            if started {
                self.publisher.archive.add(self.history.get(0));
            }
            self.history.drop_first();
        }
    }
}
