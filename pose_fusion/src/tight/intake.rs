//! What arrives: each message is checked, put in its place in the history, and what follows from it is run.

use super::{
    AHEAD, BRIDGED, CONFIRM, GAP, JUMP, NOTHING, Pixels, READINGS, REMEMBERED, Tight,
    climber::Reading,
    geometry::ClimberRest,
    history::Event,
    markers::Sighting,
    propagate::Felt,
    start::{self, Up},
    tie,
};
use crate::output::{MarkerOutcome, Output, Warning};
use nalgebra::{Matrix2, Vector3};
use rig_model::{ClimberSample, ImuSample, MarkerObservations, MarkerState};
use std::collections::VecDeque;

impl Tight {
    /// An inertial sample: moves the estimate to its stamp and says it.
    pub fn imu(&mut self, sample: &ImuSample, out: &mut VecDeque<Output>) {
        let felt = Felt { force: sample.specific_force, rate: sample.angular_velocity };
        let plausible = |v: &Vector3<f64>, most: f64| v.iter().all(|x| x.is_finite() && x.abs() < most);
        for (what, fine) in [
            ("linear_acceleration", plausible(&felt.force, 1e3)),
            ("angular_velocity", plausible(&felt.rate, 1e3)),
        ] {
            if !fine {
                self.status.refused_imu += 1;
                out.push_back(Output::Warning(Warning::NotFinite {
                    source_name: "inertial sample",
                    stamp: sample.stamp,
                    what,
                }));
                return;
            }
        }
        let Some((newest, _)) = self.newest_imu else {
            self.take_imu(sample, felt, None);
            if self.take_up(sample.stamp, out) {
                self.say(out);
            }
            return;
        };
        let ahead = sample.stamp.seconds_since(newest);
        if ahead.abs() > JUMP {
            self.time_jump(sample, ahead, out);
            return;
        }
        self.jump = None;
        if ahead == 0.0 {
            self.status.duplicates += 1;
            out.push_back(Output::Warning(Warning::Duplicate {
                source_name: "inertial sample",
                stamp: sample.stamp,
            }));
            return;
        }
        if ahead < 0.0 {
            self.late_imu(sample, felt, out);
            return;
        }
        if ahead > GAP {
            self.status.gaps += 1;
            out.push_back(Output::Warning(Warning::InertialGap { from: newest, to: sample.stamp }));
            self.stillness.clear();
            if ahead > BRIDGED && self.markers_seen >= 3 && self.started {
                self.restart();
            }
        }
        self.take_imu(sample, felt, Some(ahead));
        if !self.started && self.take_up(sample.stamp, out) {
            self.say(out);
            return;
        }
        if !self.started {
            let at = self.awaited.map(|(image, _)| image.plus_seconds(self.clock_guess()));
            if at.is_none_or(|at| at > sample.stamp) {
                return;
            }
            if let (Some((image, pixels)), Some(geometry)) = (self.awaited.take(), self.geometry.clone()) {
                self.try_start(&geometry, image, &pixels, out);
            }
            return;
        }
        self.run(out);
        self.say(out);
        self.watch(out);
    }

    /// The markers of an image.
    pub fn markers(&mut self, observations: &MarkerObservations, out: &mut VecDeque<Output>) {
        let stamp = observations.stamp;
        self.status.images += 1;
        let pixels = self.usable_pixels(observations, out);
        self.markers_seen = pixels.iter().flatten().count();
        if self.images.contains(&stamp) {
            self.status.duplicates += 1;
            out.push_back(Output::Warning(Warning::Duplicate { source_name: "image", stamp }));
            return;
        }
        let (Some(geometry), Some((newest, _))) = (&self.geometry, self.newest_imu) else {
            self.refuse(stamp, &pixels, MarkerOutcome::NotInitialised, out);
            return;
        };
        let ahead = stamp.seconds_since(newest);
        if ahead > AHEAD {
            self.status.refused_images += 1;
            out.push_back(Output::Warning(Warning::Ahead { source_name: "image", stamp, ahead_s: ahead }));
            self.refuse(stamp, &pixels, MarkerOutcome::Refused, out);
            return;
        }
        if self.images.len() == REMEMBERED {
            self.images.pop_front();
        }
        self.images.push_back(stamp);
        if !self.started {
            let geometry = geometry.clone();
            self.start_or_wait(&geometry, stamp, pixels, out);
            return;
        }
        let clock = self.clock_guess();
        let at = stamp.plus_seconds(clock);
        if self.history.get(0).is_none_or(|first| at <= first.stamp) {
            self.status.refused_images += 1;
            out.push_back(Output::Warning(Warning::TooOld { source_name: "image", stamp, age_s: -ahead }));
            self.refuse(stamp, &pixels, MarkerOutcome::Refused, out);
            return;
        }
        let Some((_, _, rest)) = self.readings.back().copied() else { return };
        let sighting = Sighting { pixels, clock, felt: NOTHING, rest };
        self.history.insert(at, Event::Markers { sighting, image: stamp, fresh: true }, NOTHING);
        self.run(out);
        self.watch(out);
    }

    /// The climber's encoders.
    pub fn climber(&mut self, sample: &ClimberSample, out: &mut VecDeque<Output>) {
        let pose = &sample.world_from_climber;
        let finite = pose.translation.vector.iter().chain(pose.rotation.coords.iter()).all(|x| x.is_finite());
        let stamp = sample.stamp;
        if !finite {
            self.status.refused_climber += 1;
            out.push_back(Output::Warning(Warning::NotFinite {
                source_name: "climber",
                stamp,
                what: "the pose",
            }));
            return;
        }
        let (values, rest) = ClimberRest::split(pose);
        // Where it belongs among the others.
        let place = self.readings.partition_point(|(at, _, _)| *at < stamp);
        if self.readings.get(place).is_some_and(|(at, _, _)| *at == stamp) {
            self.status.duplicates += 1;
            out.push_back(Output::Warning(Warning::Duplicate { source_name: "climber", stamp }));
            return;
        }
        let in_order = place == self.readings.len();
        if let Some((newest, _)) = self.newest_imu {
            let ahead = stamp.seconds_since(newest);
            if ahead > AHEAD {
                self.status.refused_climber += 1;
                out.push_back(Output::Warning(Warning::Ahead {
                    source_name: "climber",
                    stamp,
                    ahead_s: ahead,
                }));
                return;
            }
        }
        let (variance, share) = if in_order {
            self.reading_noise.take(stamp, &values)
        } else {
            let neighbour =
                place.checked_sub(1).and_then(|p| self.readings.get(p)).map(|(_, values, _)| values);
            self.reading_noise.late(&values, neighbour)
        };
        let share = Vector3::from(share);
        if in_order && self.reading_noise.is_young() {
            self.weigh_readings_anew(&variance);
        }
        // One that is older than all tells nothing of the climber's speed now.
        if in_order || place > 0 {
            self.readings.insert(place, (stamp, values, rest));
        }
        if self.readings.len() > READINGS {
            self.readings.pop_front();
        }
        let clock = self.clock_guess() + self.climber_clock;
        let at = stamp.plus_seconds(clock);
        if self.started && self.history.get(0).is_none_or(|first| at <= first.stamp) {
            self.status.refused_climber += 1;
            let age_s = self.newest_imu.map_or(0.0, |(newest, _)| newest.seconds_since(stamp));
            out.push_back(Output::Warning(Warning::TooOld { source_name: "climber", stamp, age_s }));
            return;
        }
        let speed = tie::speed(&self.readings, stamp, &variance);
        if in_order {
            self.driving = speed.is_some_and(|s| s != Vector3::zeros());
        }
        let reading = Reading {
            values,
            variance: variance.component_mul(&share),
            share,
            clock,
            felt: NOTHING,
            rest,
            speed,
        };
        self.history.insert(at, Event::Climber(reading), NOTHING);
        if self.started {
            self.run(out);
        }
    }

    pub(super) fn take_imu(&mut self, sample: &ImuSample, felt: Felt, dt: Option<f64>) {
        if let Some(dt) = dt {
            self.inertial_noise.take(&felt, dt);
        }
        let (force, rate) = self.densities();
        let period = self.inertial_noise.period().max(1e-4);
        let still = self.stillness.take(&felt, force / period, rate / period);
        self.history.insert(sample.stamp, Event::Imu { still }, felt);
        self.newest_imu = Some((sample.stamp, felt));
        self.status.imu_samples += 1;
        let up = sample.orientation.as_ref().and_then(|o| {
            let coords = o.enu_from_imu.coords;
            if !coords.iter().all(|x| x.is_finite()) || (coords.norm() - 1.0).abs() > 0.01 {
                return None;
            }
            let variance = o.covariance.map_or(0.0, |c| c[(0, 0)].max(c[(1, 1)]));
            let sigma = if variance.is_finite() { variance.max(0.0).sqrt() } else { 0.0 };
            Some(Up { in_imu: start::up_of(&o.enu_from_imu), sigma: sigma.max(self.config.attitude_floor) })
        });
        if let Some(up) = up {
            if self.attitudes.len() == REMEMBERED {
                self.attitudes.pop_front();
            }
            self.attitudes.push_back((sample.stamp, up));
        }
        self.trim();
    }

    pub(super) fn late_imu(&mut self, sample: &ImuSample, felt: Felt, out: &mut VecDeque<Output>) {
        let place = self.history.place_of(sample.stamp);
        let before = place.checked_sub(1).and_then(|p| self.history.get(p));
        let duplicate =
            before.is_some_and(|n| n.stamp == sample.stamp && matches!(n.event, Event::Imu { .. }));
        if duplicate {
            self.status.duplicates += 1;
            out.push_back(Output::Warning(Warning::Duplicate {
                source_name: "inertial sample",
                stamp: sample.stamp,
            }));
            return;
        }
        if before.is_none() {
            self.status.refused_imu += 1;
            let age_s = self.newest_imu.map_or(0.0, |(newest, _)| newest.seconds_since(sample.stamp));
            out.push_back(Output::Warning(Warning::TooOld {
                source_name: "inertial sample",
                stamp: sample.stamp,
                age_s,
            }));
            return;
        }
        self.status.late_imu += 1;
        let place = self.history.insert(sample.stamp, Event::Imu { still: None }, felt);
        // What was interpolated over this sample's place is interpolated anew: back to the sample before.
        let mut from = place;
        while from > 1
            && self.history.get(from - 1).is_some_and(|n| !matches!(n.event, Event::Imu { .. } | Event::Set))
        {
            from -= 1;
        }
        self.history.set_run(self.history.run().min(from));
        if self.started {
            self.run(out);
        }
    }

    /// An inertial stamp far from the others: a glitch is refused. One that lasts is an outage where it leads forwards (the
    /// pose starts anew, what was learnt is kept), and another time where it leads back: everything starts anew.
    pub(super) fn time_jump(&mut self, sample: &ImuSample, ahead: f64, out: &mut VecDeque<Output>) {
        let count = match self.jump {
            Some((last, count)) if (0.0..JUMP).contains(&sample.stamp.seconds_since(last)) => count + 1,
            _ => 1,
        };
        if count < CONFIRM {
            self.jump = Some((sample.stamp, count));
            self.status.refused_imu += 1;
            let (source_name, stamp) = ("inertial sample", sample.stamp);
            out.push_back(Output::Warning(if ahead < 0.0 {
                Warning::TooOld { source_name, stamp, age_s: -ahead }
            } else {
                Warning::Ahead { source_name, stamp, ahead_s: ahead }
            }));
            return;
        }
        if let (true, Some((from, _))) = (ahead > 0.0, self.newest_imu) {
            out.push_back(Output::Warning(Warning::InertialGap { from, to: sample.stamp }));
            self.status.gaps += 1;
            self.restart();
        } else {
            out.push_back(Output::Warning(Warning::TimeJump { by_s: -ahead }));
            self.status.time_jumps += 1;
            self.reset();
        }
        let felt = Felt { force: sample.specific_force, rate: sample.angular_velocity };
        self.take_imu(sample, felt, None);
    }

    pub(super) fn trim(&mut self) {
        let Some((newest, _)) = self.newest_imu else { return };
        let oldest = newest.plus_seconds(-self.config.history);
        while self.history.len() > 2
            && (!self.started || self.history.run() > 1)
            && self.history.get(1).is_some_and(|n| n.stamp < oldest)
        {
            self.archive_first();
            self.history.drop_first();
        }
    }

    pub(super) fn usable_pixels(
        &mut self,
        observations: &MarkerObservations,
        out: &mut VecDeque<Output>,
    ) -> Pixels {
        let floor = Matrix2::identity() * self.config.pixel_floor.powi(2);
        let minimum = self.config.pixel_minimum.powi(2);
        let mut pixels = [None; 4];
        for (color, marker) in observations.markers.iter() {
            if marker.state != MarkerState::Detected {
                continue;
            }
            let c = &marker.covariance;
            let usable = marker.centroid.iter().all(|x| x.is_finite() && x.abs() < 1e5)
                && c.iter().all(|x| x.is_finite() && x.abs() < 1e6)
                && c.determinant() >= 0.0
                && c.trace() >= 0.0;
            if !usable {
                self.status.refused_markers += 1;
                out.push_back(Output::Warning(Warning::NotFinite {
                    source_name: "marker",
                    stamp: observations.stamp,
                    what: color.name(),
                }));
                continue;
            }
            let symmetric = (c + c.transpose()) * 0.5;
            let believed = symmetric + Matrix2::identity() * (minimum - symmetric.trace() / 2.0).max(0.0);
            pixels[color.index()] = Some((marker.centroid, believed * self.pixel_scale + floor));
        }
        pixels
    }
}
