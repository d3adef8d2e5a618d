//! Inputs of the filter: each message is checked and put in its place on the time line.

use super::Filter;
use crate::{
    adaptation::imu_integrity::Implausible,
    ekf::{propagation::ImuReading, state::ATTITUDE},
    health::status::RejectedCounts,
    input::imu::ImuInput,
    measurements::{encoders::EncoderReading, geometry::ClimberRest, markers::Image},
    output::{MarkerOutcome, Output, Warning},
    timeline::{
        arrival::{AHEAD, Arrival, ImuArrival, Source},
        dropout::INTERPOLATED,
        history::Event,
    },
};
use rig_model::{ClimberSample, ImuSample, MarkerObservations, Stamp, topics};
use std::collections::VecDeque;

/// Largest standard deviation of the attitude with which the pose goes on after a gap, rad.
const LARGEST_ATTITUDE: f64 = 0.2;
/// Smallest uncertainty of the IMU's own roll and pitch, rad.
const SMALLEST_ATTITUDE: f64 = 0.01;

const IMU: &str = "IMU sample";

impl Filter {
    /// Counters of rejected inputs, for what is rejected before it comes here.
    pub fn rejected_counts(&mut self) -> &mut RejectedCounts {
        &mut self.publisher.counts.rejected
    }

    /// Takes in an IMU sample: moves the estimate to its stamp and publishes it.
    pub fn imu(&mut self, sample: &ImuSample, out: &mut VecDeque<Output>) {
        let stamp = sample.stamp;
        let reading = match ImuInput::reading(sample) {
            Ok(reading) => reading,
            Err(why) => {
                let what = match why {
                    Implausible::Force => "linear_acceleration",
                    Implausible::Rate => "angular_velocity",
                    Implausible::AllZero => "every value is zero: linear_acceleration",
                };
                self.publisher.counts.rejected.imu += 1;
                return out.push_back(Output::Warning(Warning::NotFinite {
                    source_name: IMU,
                    stamp,
                    what,
                }));
            }
        };
        match self.arrival.classify(stamp) {
            ImuArrival::First => self.next_imu(sample, reading, None, out),
            ImuArrival::Next(dt) => self.next_imu(sample, reading, Some(dt), out),
            ImuArrival::Late => self.late_imu(stamp, reading, out),
            ImuArrival::Duplicate => {
                self.publisher.counts.inputs.duplicates += 1;
                out.push_back(Output::Warning(Warning::Duplicate { source_name: IMU, stamp }));
            }
            ImuArrival::Unconfirmed(ahead_s) => {
                self.publisher.counts.rejected.imu += 1;
                out.push_back(Output::Warning(if ahead_s < 0.0 {
                    Warning::TooOld { source_name: IMU, stamp, age_s: -ahead_s }
                } else {
                    Warning::Ahead { source_name: IMU, stamp, ahead_s }
                }));
            }
            ImuArrival::Outage => {
                let dt = self.arrival.newest_imu().map(|(newest, _)| stamp.seconds_since(newest));
                self.next_imu(sample, reading, dt, out);
            }
            ImuArrival::Back(by_s) => {
                out.push_back(Output::Warning(Warning::TimeJump { by_s }));
                self.publisher.counts.resets.time_jumps += 1;
                self.reset();
                self.next_imu(sample, reading, None, out);
            }
        }
    }

    fn next_imu(
        &mut self,
        sample: &ImuSample,
        reading: ImuReading,
        dt: Option<f64>,
        out: &mut VecDeque<Output>,
    ) {
        if let (Some(first), true) = (self.history.get(0), self.start.is_started())
            && sample.stamp <= first.stamp
        {
            // Held back until after an image alone had initialized the pose.
            let age_s = first.stamp.seconds_since(sample.stamp);
            self.arrival.imu(sample.stamp, reading);
            self.publisher.counts.rejected.imu += 1;
            let stamp = sample.stamp;
            out.push_back(Output::Warning(Warning::TooOld { source_name: IMU, stamp, age_s }));
            return;
        }
        let mut dt = dt;
        if let (Some(seconds), Some((from, _))) =
            (dt.filter(|dt| Arrival::is_gap(*dt)), self.arrival.newest_imu())
        {
            self.publisher.counts.inputs.imu_gaps += 1;
            out.push_back(Output::Warning(Warning::ImuGap { from, to: sample.stamp }));
            self.imu.interrupt();
            if let (Some(search), true) = (&mut self.search, seconds > INTERPOLATED) {
                search.clear();
            }
            let covered = self.publisher.markers_used == 4
                && (self.arrival.end())
                    .is_some_and(|end| sample.stamp.seconds_since(end) < INTERPOLATED);
            // What neither samples nor images with four markers have followed is not bridged where
            // an image can reinitialize the pose (three markers may have followed the mirrored
            // tilt), and an attitude that is hardly known is no point to linearize at.
            let unknown = self.state().is_some_and(|s| s.sigmas(ATTITUDE).max() > LARGEST_ATTITUDE);
            let unfollowed = seconds > INTERPOLATED && !covered && self.start.markers_seen() >= 3;
            if self.start.is_started() && (unfollowed || unknown) {
                self.restart();
                dt = None;
            }
        }
        let mounting = &self.setup.rig.imu;
        let event = self.imu.event(&reading, dt, mounting);
        if let Some(more) = self.imu.newly_known_noise(mounting) {
            self.reweigh_samples(&more);
        }
        self.imu.remember_attitude(sample, SMALLEST_ATTITUDE);
        self.history.insert(sample.stamp, event, reading);
        self.arrival.imu(sample.stamp, reading);
        self.publisher.counts.inputs.imu += 1;
        if let Some(search) = &mut self.search {
            if self.imu.hides_motion() {
                search.clear();
            } else {
                search.add_reading(sample.stamp, &reading);
            }
        }
        self.trim();
        if self.start.is_started() {
            self.process(out);
            self.publish(out);
        } else if self.resume(sample.stamp, out) {
            self.publish(out);
        } else {
            self.start_from_awaited(sample.stamp, out);
        }
    }

    fn late_imu(&mut self, stamp: Stamp, reading: ImuReading, out: &mut VecDeque<Output>) {
        let place = self.history.place_of(stamp);
        let before = place.checked_sub(1).and_then(|p| self.history.get(p));
        if before.is_some_and(|n| n.stamp == stamp && matches!(n.event, Event::Imu { .. })) {
            self.publisher.counts.inputs.duplicates += 1;
            return out.push_back(Output::Warning(Warning::Duplicate { source_name: IMU, stamp }));
        }
        if before.is_none() {
            self.publisher.counts.rejected.imu += 1;
            let age_s = self.age(stamp);
            return out.push_back(Output::Warning(Warning::TooOld {
                source_name: IMU,
                stamp,
                age_s,
            }));
        }
        self.publisher.counts.inputs.late_imu += 1;
        let noise = self.imu.densities(&self.setup.rig.imu);
        let place = self.history.insert(stamp, Event::Imu { noise, at_rest: None }, reading);
        // What was interpolated over this sample's place is interpolated again: back to the sample
        // before.
        let mut from = place;
        while from > 1
            && self
                .history
                .get(from - 1)
                .is_some_and(|n| !matches!(n.event, Event::Imu { .. } | Event::Set))
        {
            from -= 1;
        }
        self.history.rewind(from);
        if self.start.is_started() {
            self.process(out);
        }
    }

    /// Takes in the markers of an image.
    pub fn markers(&mut self, observations: &MarkerObservations, out: &mut VecDeque<Output>) {
        let stamp = observations.stamp;
        self.publisher.counts.inputs.images += 1;
        let mut unusable = 0;
        let pixels = self.markers.pixels(observations, &self.setup.config.markers, |warning| {
            unusable += 1;
            out.push_back(Output::Warning(warning));
        });
        self.publisher.counts.rejected.markers += unusable;
        self.start.note_markers(pixels.iter().flatten().count());
        if self.markers.is_duplicate(stamp) {
            self.publisher.counts.inputs.duplicates += 1;
            return out
                .push_back(Output::Warning(Warning::Duplicate { source_name: "image", stamp }));
        }
        let newest = self.arrival.newest_imu().map(|(newest, _)| newest);
        let ahead_s = newest.map_or(0.0, |newest| stamp.seconds_since(newest));
        self.arrival.other(Source::Image, stamp);
        let silent = self.arrival.is_imu_silent();
        if self.setup.geometry.is_none() || (newest.is_none() && !silent) {
            return self.publisher.reject(stamp, &pixels, MarkerOutcome::NotInitialized, out);
        }
        if ahead_s > AHEAD && !silent {
            self.publisher.counts.rejected.images += 1;
            out.push_back(Output::Warning(Warning::Ahead { source_name: "image", stamp, ahead_s }));
            return self.publisher.reject(stamp, &pixels, MarkerOutcome::Rejected, out);
        }
        self.markers.remember(stamp);
        self.follow_without_imu(stamp, silent, out);
        if !self.start.is_started() {
            let absent = self.arrival.is_imu_absent();
            return self.start_or_wait(stamp, pixels, absent, out);
        }
        let time_offset = self.time_offset();
        let at = stamp.plus_seconds(time_offset);
        if self.history.get(0).is_none_or(|first| at <= first.stamp) {
            self.publisher.counts.rejected.images += 1;
            out.push_back(Output::Warning(Warning::TooOld {
                source_name: "image",
                stamp,
                age_s: -ahead_s,
            }));
            return self.publisher.reject(stamp, &pixels, MarkerOutcome::Rejected, out);
        }
        let Some((_, _, rest)) = self.climber.newest().copied() else { return };
        let stamp_sigma = self.markers.stamp_sigma().min(self.setup.config.clock.image_jitter);
        let layout_doubt = self.markers.take_layout_doubt();
        if let (Some(_), Some(search)) = (layout_doubt, &mut self.search) {
            // The image poses that it has are tilted by the layout's error.
            search.clear();
        }
        let mut image = Image::new(&pixels, time_offset, rest);
        image.stamp_sigma = stamp_sigma as f32;
        image.layout_doubt = layout_doubt.map(|sigma| sigma as f32);
        self.history.insert(at, Event::Image { image, stamp, fresh: true }, ImuReading::default());
        self.process(out);
        if !self.setup.frozen {
            self.search_time_offset(stamp, &pixels, out);
        }
        if silent {
            self.trim();
            self.publish(out);
        }
    }

    /// While the IMU is silent images move the end of the time line.
    fn follow_without_imu(&mut self, stamp: Stamp, silent: bool, out: &mut VecDeque<Output>) {
        if !silent {
            return;
        }
        let at = stamp.plus_seconds(self.time_offset());
        if self.arrival.end().is_some_and(|end| at.seconds_since(end) > AHEAD)
            && self.start.is_started()
        {
            // Neither images nor samples for a while: the image initializes the pose.
            self.restart();
        }
        if let (Some((since, _)), true) =
            (self.arrival.newest_imu(), self.publisher.note_imu_lost())
        {
            out.push_back(Output::Warning(Warning::ImuLost { since }));
        }
        self.arrival.image(at);
    }

    /// Takes in an encoder reading.
    pub fn climber(&mut self, sample: &ClimberSample, out: &mut VecDeque<Output>) {
        const SOURCE: &str = topics::CLIMBER_TRANSFORM;
        let (pose, stamp) = (&sample.world_from_climber, sample.stamp);
        if !pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|x| x.is_finite())
        {
            self.publisher.counts.rejected.climber += 1;
            let what = "the pose";
            return out.push_back(Output::Warning(Warning::NotFinite {
                source_name: SOURCE,
                stamp,
                what,
            }));
        }
        self.arrival.other(Source::Encoders, stamp);
        if let (Some((newest, _)), false) =
            (self.arrival.newest_imu(), self.arrival.is_imu_silent())
        {
            let ahead_s = stamp.seconds_since(newest);
            if ahead_s > AHEAD {
                self.publisher.counts.rejected.climber += 1;
                return out.push_back(Output::Warning(Warning::Ahead {
                    source_name: SOURCE,
                    stamp,
                    ahead_s,
                }));
            }
        }
        let (values, rest) = ClimberRest::split(pose);
        let Some((variance, multiplicity)) = self.climber.add(stamp, values, rest) else {
            self.publisher.counts.inputs.duplicates += 1;
            return out
                .push_back(Output::Warning(Warning::Duplicate { source_name: SOURCE, stamp }));
        };
        if self.climber.is_young() {
            self.reweigh_readings(&variance);
        }
        let time_offset = self.encoder_offset();
        let at = stamp.plus_seconds(time_offset);
        if self.start.is_started() && self.history.get(0).is_none_or(|first| at <= first.stamp) {
            self.publisher.counts.rejected.climber += 1;
            let age_s = self.age(stamp);
            return out.push_back(Output::Warning(Warning::TooOld {
                source_name: SOURCE,
                stamp,
                age_s,
            }));
        }
        let reading = EncoderReading {
            values,
            variance: variance.component_mul(&multiplicity),
            multiplicity,
            time_offset,
        };
        let excluded = self.trust.is_suspended();
        self.history.insert(
            at,
            Event::Encoders { reading, excluded, fresh: true },
            ImuReading::default(),
        );
        if self.start.is_started() {
            self.suspend_frozen_encoders(at, out);
            self.process(out);
        }
        self.publish_silence(out);
    }

    /// Time from a stamp to the newest IMU sample, s.
    fn age(&self, stamp: Stamp) -> f64 {
        self.arrival.newest_imu().map_or(0.0, |(newest, _)| newest.seconds_since(stamp))
    }

    /// Drops what is older than the configured history.
    fn trim(&mut self) {
        let Some(end) = self.arrival.end() else { return };
        let oldest = end.plus_seconds(-self.setup.config.history);
        let started = self.start.is_started();
        while self.history.len() > 2
            && (!started || self.history.processed() > 1)
            && self.history.get(1).is_some_and(|n| n.stamp < oldest)
        {
            if started && self.history.processed() > 0 {
                self.publisher.archive(self.history.get(0));
            }
            self.history.drop_first();
        }
    }
}
