//! The error-state filter: every visible marker's pixels, the encoders and the inertial unit, each at its own time.
//!
//! In flow [`crate::Input`]s in order of arrival; out flow odometry with every inertial sample, and a record for every
//! marker of every image. See [`state`] for the state, [`propagate`] for its motion, [`markers`] and [`climber`] for what
//! corrects it, [`history`] for late data, [`start`] for the beginning.

pub mod bank;
pub mod climber;
pub mod geometry;
pub mod history;
pub mod markers;
pub mod noise;
pub mod odometry;
pub mod propagate;
pub mod start;
pub mod state;

use crate::{
    config::TightConfig,
    output::{MarkerOutcome, MarkerUpdateRecord, Output, Warning},
    status::Status,
};
use climber::{Reading, ReadingNoise};
use geometry::{ClimberRest, Geometry};
use history::{Event, History};
use markers::{Gates, Report, Sighting, Verdict};
use nalgebra::{Matrix2, Vector2, Vector3};
use noise::{InertialNoise, Stillness};
use propagate::{Felt, Process, propagate};
use rig_model::{
    CameraModel, ClimberSample, ImuSample, MarkerColor, MarkerObservations, MarkerState, Rig, Stamp,
};
use start::{ClimberStart, Up};
use state::{
    ACCELEROMETER, ATTITUDE, CAMERA_CLOCK, CLIMBER, CLIMBER_CLOCK, CLIMBER_RATE, GYROSCOPE, POSITION, State,
    VELOCITY,
};
use std::collections::VecDeque;

/// Further ahead of the inertial samples than this, a message is not believed, s.
const AHEAD: f64 = 0.5;
/// An inertial stamp further from its predecessor than this must be confirmed by others, s.
const JUMP: f64 = 1.0;
/// So many inertial samples in a row confirm a jump of time.
const CONFIRM: u32 = 3;
/// A longer pause between inertial samples is a gap, s.
const GAP: f64 = 0.05;
/// What a rejected marker costs a hypothesis: as much as the gate, and a usual ln |S| on top.
const REFUSED_PRICE: f64 = 20.0;
/// So many images are no evidence yet: the noise of the other sensors is still being found.
const SETTLING: u64 = 15;
/// A reading that is so much (squared, in sigmas) off means that the climber jerks more than assumed.
const SURPRISE: f64 = 10.0;
/// So many image stamps are remembered to tell duplicates.
const REMEMBERED: usize = 64;

/// To be interpolated.
const NOTHING: Felt = Felt { force: Vector3::new(0.0, 0.0, 0.0), rate: Vector3::new(0.0, 0.0, 0.0) };

/// Centroid and covariance of each detected marker.
type Pixels = [Option<(Vector2<f64>, Matrix2<f64>)>; 4];

/// The error-state filter.
#[derive(Debug)]
pub struct Tight {
    rig: Rig,
    config: TightConfig,
    geometry: Option<Geometry>,
    history: History,
    started: bool,
    frozen: bool,
    newest_imu: Option<(Stamp, Felt)>,
    jump: Option<(Stamp, u32)>,
    attitudes: VecDeque<(Stamp, Up)>,
    readings: VecDeque<(Stamp, Vector3<f64>, ClimberRest)>,
    images: VecDeque<Stamp>,
    inertial_noise: InertialNoise,
    stillness: Stillness,
    reading_noise: ReadingNoise,
    jerk_scale: f64,
    pixel_scale: f64,
    pixel_ratio: f64,
    contradictions: u32,
    contradicted_since: Option<Stamp>,
    last_used: Option<Stamp>,
    lost: bool,
    /// The image to start from, while the inertial samples have not come so far.
    awaited: Option<(Stamp, Pixels)>,
    evidence: f64,
    weighed: u64,
    status: Status,
}

impl Tight {
    /// A filter that knows nothing yet.
    pub fn new(rig: Rig, config: TightConfig) -> Self {
        let steps = Vector3::new(config.climber_quantum, config.climber_quantum, config.climber_turn_quantum);
        Self {
            rig,
            geometry: None,
            history: History::default(),
            started: false,
            frozen: false,
            newest_imu: None,
            jump: None,
            attitudes: VecDeque::with_capacity(REMEMBERED),
            readings: VecDeque::with_capacity(REMEMBERED),
            images: VecDeque::with_capacity(REMEMBERED),
            inertial_noise: InertialNoise::default(),
            stillness: Stillness::default(),
            reading_noise: ReadingNoise::new(steps),
            jerk_scale: 1.0,
            pixel_scale: 1.0,
            pixel_ratio: 1.0,
            contradictions: 0,
            contradicted_since: None,
            last_used: None,
            lost: false,
            awaited: None,
            evidence: 0.0,
            weighed: 0,
            status: Status::default(),
            config,
        }
    }

    /// Counters and the newest insights.
    pub fn status(&self) -> Status {
        let mut status = self.status.clone();
        status.initialised = self.started;
        status.frozen = self.frozen;
        status.newest_imu = self.newest_imu.map(|(stamp, _)| stamp);
        status.last_used_image = self.last_used;
        status.pixel_noise_factor = self.pixel_scale.sqrt();
        let (force, rate) = self.densities();
        status.accelerometer_noise_density = force.sqrt();
        status.gyroscope_noise_density = rate.sqrt();
        if let Some(state) = self.state() {
            let p = &state.covariance;
            status.camera_clock_offset = state.camera_clock;
            status.camera_clock_sigma = p[(CAMERA_CLOCK, CAMERA_CLOCK)].max(0.0).sqrt();
            status.climber_clock_offset = state.climber_clock;
            status.climber_clock_sigma = p[(CLIMBER_CLOCK, CLIMBER_CLOCK)].max(0.0).sqrt();
            status.accelerometer_bias = state.accelerometer_bias;
            status.gyroscope_bias = state.gyroscope_bias;
            status.position_sigma = self.position_sigma(state);
        }
        status.lost = self.lost;
        status
    }

    /// The newest state, once started.
    pub fn state(&self) -> Option<&State> {
        if !self.started {
            return None;
        }
        self.history.get(self.history.run().checked_sub(1)?).map(|n| &n.state)
    }

    /// How unlikely all images were together (minus twice the logarithm of their likelihood, up to a constant).
    pub fn evidence(&self) -> f64 {
        self.evidence
    }

    /// How many images that is.
    pub fn weighed(&self) -> u64 {
        self.weighed
    }

    /// Adds what else speaks against this filter.
    pub fn add_evidence(&mut self, surprise: f64) {
        self.evidence += surprise;
    }

    /// Stops or resumes using markers; what is not used is still compared and recorded.
    pub fn freeze(&mut self, frozen: bool) {
        self.frozen = frozen;
    }

    /// Forgets the estimate and starts from the next image. What is known of the noise is forgotten as well.
    pub fn reset(&mut self) {
        let (status, frozen) = (self.status.clone(), self.frozen);
        let geometry = self.geometry.take();
        let (evidence, weighed) = (self.evidence, self.weighed);
        let mut fresh = Self::new(self.rig.clone(), self.config.clone());
        fresh.geometry = geometry;
        fresh.status = status;
        fresh.frozen = frozen;
        (fresh.evidence, fresh.weighed) = (evidence, weighed);
        *self = fresh;
    }

    /// The camera's calibration; a changed one counts from the next image on.
    pub fn camera(&mut self, camera: &CameraModel) {
        if self.geometry.as_ref().is_none_or(|g| g.camera != *camera) {
            self.geometry = Some(Geometry::new(&self.rig, camera.clone()));
        }
    }

    /// The camera's calibration, once known.
    pub fn camera_model(&self) -> Option<&CameraModel> {
        self.geometry.as_ref().map(|g| &g.camera)
    }

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
        let Some((newest, last)) = self.newest_imu else {
            self.take_imu(sample, felt, None);
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
            self.bridge(newest, &last, &felt, ahead);
        }
        self.take_imu(sample, felt, Some(ahead));
        if !self.started {
            let at = self.awaited.map(|(image, _)| image.plus_seconds(self.config.camera_clock_offset));
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
        let clock = self.state().map_or(self.config.camera_clock_offset, |s| s.camera_clock);
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
        if self.readings.back().is_some_and(|(last, _, _)| *last == stamp) {
            self.status.duplicates += 1;
            out.push_back(Output::Warning(Warning::Duplicate { source_name: "climber", stamp }));
            return;
        }
        let in_order = self.readings.back().is_none_or(|(last, _, _)| *last < stamp);
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
            self.reading_noise.take(&values)
        } else {
            // Out of order: whether it changed cannot be told, so it brings nothing but its value.
            (self.reading_noise.variance(), [1.0; 3])
        };
        if in_order {
            if self.readings.len() == REMEMBERED {
                self.readings.pop_front();
            }
            self.readings.push_back((stamp, values, rest));
        }
        let clock =
            self.state().map_or(self.config.camera_clock_offset, |s| s.camera_clock + s.climber_clock);
        let at = stamp.plus_seconds(clock);
        if self.started && self.history.get(0).is_none_or(|first| at <= first.stamp) {
            self.status.refused_climber += 1;
            let age_s = self.newest_imu.map_or(0.0, |(newest, _)| newest.seconds_since(stamp));
            out.push_back(Output::Warning(Warning::TooOld { source_name: "climber", stamp, age_s }));
            return;
        }
        let reading = Reading {
            values,
            variance: variance.component_mul(&Vector3::from(share)),
            clock,
            felt: NOTHING,
            rest,
        };
        self.history.insert(at, Event::Climber(reading), NOTHING);
        if self.started {
            self.run(out);
        }
    }

    fn take_imu(&mut self, sample: &ImuSample, felt: Felt, dt: Option<f64>) {
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

    fn late_imu(&mut self, sample: &ImuSample, felt: Felt, out: &mut VecDeque<Output>) {
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

    /// An inertial stamp far from the others: a glitch is refused, a jump that lasts starts everything anew.
    fn time_jump(&mut self, sample: &ImuSample, ahead: f64, out: &mut VecDeque<Output>) {
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
        out.push_back(Output::Warning(Warning::TimeJump { by_s: -ahead }));
        self.status.time_jumps += 1;
        self.reset();
        let felt = Felt { force: sample.specific_force, rate: sample.angular_velocity };
        self.take_imu(sample, felt, None);
    }

    /// Over a gap between inertial samples the motion is not known: uncertainty grows as if it could be any usual one.
    fn bridge(&mut self, from: Stamp, last: &Felt, next: &Felt, gap: f64) {
        if !self.started {
            return;
        }
        let middle = from.plus_seconds(gap / 2.0);
        self.history.insert(middle, Event::Gap { seconds: gap }, last.between(next, 0.5));
    }

    fn trim(&mut self) {
        let Some((newest, _)) = self.newest_imu else { return };
        let oldest = newest.plus_seconds(-self.config.history);
        while self.history.len() > 2
            && (!self.started || self.history.run() > 1)
            && self.history.get(1).is_some_and(|n| n.stamp < oldest)
        {
            self.history.drop_first();
        }
    }

    /// Runs every event that is not run yet and not later than the newest inertial sample.
    fn run(&mut self, out: &mut VecDeque<Output>) {
        let Some((newest, _)) = self.newest_imu else { return };
        let process = self.process();
        let gates = Gates {
            marker: self.config.marker_gate,
            joint: self.config.joint_gate,
            gravity: self.config.gravity,
        };
        let mut place = self.history.run().max(1);
        while place < self.history.len() {
            if self.history.get(place).is_none_or(|n| n.stamp > newest) {
                break;
            }
            let interpolated = self.interpolated(place);
            let frozen = self.frozen;
            let rest_sigma = self.config.rest_velocity;
            let rate_density = process.rate;
            let (Some(geometry), Some((from, to))) = (&self.geometry, self.history.step(place)) else {
                break;
            };
            if let Some(felt) = interpolated {
                to.felt = felt;
            }
            let dt = to.stamp.seconds_since(from.stamp);
            to.state.clone_from(&from.state);
            propagate(&mut to.state, &from.felt, &to.felt, dt, &process);
            let mut fresh_report = None;
            let felt = to.felt;
            match &mut to.event {
                Event::Set => {}
                Event::Imu { still } => {
                    if let (Some(rate), true) = (still, rest_sigma > 0.0) {
                        at_rest(&mut to.state, rate, rest_sigma, rate_density);
                    }
                }
                Event::Gap { seconds } => widen_over_gap(&mut to.state, *seconds),
                Event::Climber(reading) => {
                    let nis = {
                        reading.felt = felt;
                        climber::update(&mut to.state, reading, gates.gravity)
                    };
                    let more = if nis > SURPRISE { 1.6 } else { 0.98 };
                    self.jerk_scale = (self.jerk_scale * more).clamp(1.0, 1000.0);
                }
                Event::Markers { sighting, image, fresh } => {
                    sighting.felt = felt;
                    let report = markers::update(&mut to.state, geometry, sighting, &gates, frozen);
                    if *fresh {
                        *fresh = false;
                        fresh_report = Some((*image, sighting.pixels, report));
                    }
                }
            }
            let sound = to.state.is_sound();
            let stamp = to.stamp;
            self.history.set_run(place + 1);
            if !sound {
                out.push_back(Output::Warning(Warning::Diverged { stamp }));
                self.status.divergences += 1;
                self.reset();
                return;
            }
            if let Some((image, pixels, report)) = fresh_report {
                self.record(image, &report, out);
                if self.learn(image, &pixels, &report, out) {
                    return;
                }
            }
            place += 1;
        }
    }

    /// What the unit felt at an event between two inertial samples.
    fn interpolated(&self, place: usize) -> Option<Felt> {
        let node = self.history.get(place)?;
        if matches!(node.event, Event::Imu { .. } | Event::Gap { .. }) {
            return None;
        }
        let before = self.history.get(place.checked_sub(1)?)?;
        let Some(next) = self.history.next_imu(place) else { return Some(before.felt) };
        let span = next.stamp.seconds_since(before.stamp);
        let share = if span > 0.0 { node.stamp.seconds_since(before.stamp) / span } else { 0.0 };
        Some(before.felt.between(&next.felt, share.clamp(0.0, 1.0)))
    }

    fn densities(&self) -> (f64, f64) {
        let imu = &self.rig.imu;
        self.inertial_noise.densities(
            imu.accelerometer_noise_density.powi(2),
            imu.gyroscope_noise_density.powi(2),
            self.config.inertial_noise_limit,
        )
    }

    fn process(&self) -> Process {
        let (force, rate) = self.densities();
        let c = &self.config;
        Process {
            gravity: c.gravity,
            force,
            rate,
            accelerometer_bias: c.accelerometer_bias_walk.powi(2),
            gyroscope_bias: c.gyroscope_bias_walk.powi(2),
            jerk: Vector3::new(c.climber_jerk, c.climber_jerk, c.climber_turn_jerk) * self.jerk_scale,
            clocks: [c.camera_clock, c.climber_clock]
                .map(|s| if s > 0.0 { c.clock_walk.powi(2) } else { 0.0 }),
        }
    }

    /// The estimate at the newest inertial sample.
    fn say(&mut self, out: &mut VecDeque<Output>) {
        let (Some(geometry), Some((newest, _))) = (&self.geometry, self.newest_imu) else { return };
        if !self.started {
            return;
        }
        let Some(node) = self.history.run().checked_sub(1).and_then(|p| self.history.get(p)) else { return };
        if node.stamp != newest {
            return;
        }
        let rate_variance = self.densities().1 / self.inertial_noise.period().max(1e-4);
        out.push_back(Output::Odometry(odometry::odometry(
            newest,
            &node.state,
            &node.felt,
            geometry,
            rate_variance,
            self.config.gravity,
        )));
        self.status.odometry += 1;
    }

    fn position_sigma(&self, state: &State) -> f64 {
        (0..3).map(|i| state.covariance[(POSITION + i, POSITION + i)]).fold(0.0, f64::max).sqrt()
    }

    /// Says once when the estimate is lost, and when it is back.
    fn watch(&mut self, out: &mut VecDeque<Output>) {
        let Some(sigma) = self.state().map(|s| self.position_sigma(s)) else { return };
        let lost = sigma > self.config.lost_position;
        if let (true, false, Some(since)) = (lost, self.lost, self.last_used) {
            out.push_back(Output::Warning(Warning::VisionLost { since, position_sigma_m: sigma }));
        }
        self.lost = lost;
    }

    fn usable_pixels(&mut self, observations: &MarkerObservations, out: &mut VecDeque<Output>) -> Pixels {
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

    fn refuse(&mut self, stamp: Stamp, pixels: &Pixels, outcome: MarkerOutcome, out: &mut VecDeque<Output>) {
        for color in MarkerColor::ALL {
            let outcome = if pixels[color.index()].is_some() { outcome } else { MarkerOutcome::NotDetected };
            out.push_back(Output::MarkerUpdate(MarkerUpdateRecord {
                stamp,
                color,
                innovation: Vector2::repeat(f64::NAN),
                covariance: Matrix2::repeat(f64::NAN),
                nis: f64::NAN,
                outcome,
            }));
        }
    }

    fn record(&mut self, stamp: Stamp, report: &Report, out: &mut VecDeque<Output>) {
        for color in MarkerColor::ALL {
            let marker = &report.markers[color.index()];
            let outcome = match marker.verdict {
                Verdict::Absent => MarkerOutcome::NotDetected,
                Verdict::Used if self.frozen => MarkerOutcome::Frozen,
                Verdict::Used => MarkerOutcome::Used,
                Verdict::Gated => MarkerOutcome::Gated,
                Verdict::Inconsistent => MarkerOutcome::Inconsistent,
                Verdict::NotPredictable => MarkerOutcome::NotPredictable,
            };
            match outcome {
                MarkerOutcome::Used => self.status.used_markers += 1,
                MarkerOutcome::Gated | MarkerOutcome::Inconsistent => self.status.rejected_markers += 1,
                _ => {}
            }
            out.push_back(Output::MarkerUpdate(MarkerUpdateRecord {
                stamp,
                color,
                innovation: marker.innovation,
                covariance: marker.covariance,
                nis: marker.nis,
                outcome,
            }));
        }
    }

    /// Learns from what became of an image: pixel noise, lock-out. True where the filter was started anew.
    fn learn(&mut self, image: Stamp, pixels: &Pixels, report: &Report, out: &mut VecDeque<Output>) -> bool {
        let seen = pixels.iter().flatten().count() as u32;
        self.weighed += 1;
        let refused = f64::from(seen.saturating_sub(report.used));
        if self.weighed > SETTLING {
            self.evidence += report.surprise + REFUSED_PRICE * refused;
        }
        if report.used > 0 && !self.frozen {
            self.last_used = Some(image);
            let ratio = (report.nis / (2.0 * f64::from(report.used))).clamp(0.0, 6.0);
            self.pixel_ratio += (ratio - self.pixel_ratio) / 40.0;
            // Images that fit worse than they claim make the next ones count less, and slowly back.
            if self.pixel_ratio > 1.4 {
                self.pixel_scale = (self.pixel_scale * 1.02).min(100.0);
            } else if self.pixel_ratio < 1.05 {
                self.pixel_scale = (self.pixel_scale * 0.99).max(1.0);
            }
        }
        if seen < 2 || report.used * 2 > seen || self.frozen {
            if seen >= 1 && report.used > 0 {
                self.contradictions = 0;
                self.contradicted_since = None;
            }
            return false;
        }
        self.contradictions += 1;
        let since = *self.contradicted_since.get_or_insert(image);
        if self.contradictions < self.config.lock_out_images {
            return false;
        }
        self.recover(image, since, pixels, out)
    }

    /// The markers have contradicted the estimate for several images: where they agree with each other, they are right.
    fn recover(&mut self, image: Stamp, since: Stamp, pixels: &Pixels, out: &mut VecDeque<Output>) -> bool {
        let Some(geometry) = self.geometry.clone() else { return false };
        let Some(old) = self.state().cloned() else { return false };
        let Some((_, _, rest)) = self.readings.back().copied() else { return false };
        let at = image.plus_seconds(old.camera_clock);
        let sighting = Sighting { pixels: *pixels, clock: old.camera_clock, felt: NOTHING, rest };
        let sigma = |i: usize| old.covariance[(i, i)].max(0.0).sqrt();
        let climber = ClimberStart {
            values: old.climber,
            rates: old.climber_rate,
            sigma: Vector3::from_fn(|i, _| sigma(CLIMBER + i)),
            rate_sigma: Vector3::from_fn(|i, _| sigma(CLIMBER_RATE + i)),
        };
        let up = self.up_at(at);
        let found = start::hypotheses(&geometry, &self.config, &sighting, up.as_ref(), &climber);
        let Some(best) = found.into_iter().next() else { return false };
        let mut state = best.state;
        state.accelerometer_bias = old.accelerometer_bias;
        state.gyroscope_bias = old.gyroscope_bias;
        state.climber_acceleration = old.climber_acceleration;
        state.camera_clock = old.camera_clock;
        state.climber_clock = old.climber_clock;
        for first in [ACCELEROMETER, GYROSCOPE] {
            // What was learnt while it was wrong is worth half.
            let sigmas = Vector3::from_fn(|i, _| (2.0 * sigma(first + i)).max(1e-4));
            state.set_variance(first, &sigmas);
        }
        self.begin(at, state, out);
        self.contradictions = 0;
        self.contradicted_since = None;
        self.status.recoveries += 1;
        self.evidence += 100.0;
        out.push_back(Output::Warning(Warning::LockOutRecovered { since, stamp: image }));
        true
    }

    /// What is known of "up" at an instant: the unit's own attitude, else its accelerometer.
    fn up_at(&self, stamp: Stamp) -> Option<Up> {
        let nearest = self
            .attitudes
            .iter()
            .min_by_key(|(s, _)| (s.as_nanos() - stamp.as_nanos()).unsigned_abs())
            .filter(|(s, _)| s.seconds_since(stamp).abs() < 0.1);
        if let Some((_, up)) = nearest {
            return Some(*up);
        }
        let mut sum = Vector3::zeros();
        for place in 0..self.history.len() {
            if let Some(node) = self.history.get(place)
                && matches!(node.event, Event::Imu { .. })
                && node.stamp.seconds_since(stamp).abs() < 0.3
            {
                sum += node.felt.force;
            }
        }
        sum.try_normalize(1e-3).map(|in_imu| Up { in_imu, sigma: start::SWING_TILT })
    }

    /// Starts from an image, or keeps it until the inertial samples have come to its time.
    fn start_or_wait(
        &mut self,
        geometry: &Geometry,
        image: Stamp,
        pixels: Pixels,
        out: &mut VecDeque<Output>,
    ) {
        let at = image.plus_seconds(self.config.camera_clock_offset);
        if self.newest_imu.is_some_and(|(newest, _)| at <= newest) {
            self.try_start(geometry, image, &pixels, out);
            return;
        }
        // The first one is kept: were it replaced by each that follows, none would ever be reached.
        let stale = self.awaited.is_none_or(|(kept, _)| image.seconds_since(kept).abs() > AHEAD);
        if stale && pixels.iter().flatten().count() >= 3 {
            self.awaited = Some((image, pixels));
        } else {
            self.refuse(image, &pixels, MarkerOutcome::NotInitialised, out);
        }
    }

    fn try_start(&mut self, geometry: &Geometry, stamp: Stamp, pixels: &Pixels, out: &mut VecDeque<Output>) {
        let seen = pixels.iter().flatten().count();
        let clock = self.config.camera_clock_offset;
        let image = stamp;
        let stamp = image.plus_seconds(clock);
        let up = self.up_at(stamp);
        let felt_before = (0..self.history.len())
            .filter_map(|p| self.history.get(p))
            .any(|n| matches!(n.event, Event::Imu { .. }) && n.stamp <= stamp);
        let climber = self.climber_at(image);
        let (Some((climber, rest)), true, true, false) = (climber, seen >= 3, felt_before, self.frozen)
        else {
            self.refuse(image, pixels, MarkerOutcome::NotInitialised, out);
            return;
        };
        let sighting = Sighting { pixels: *pixels, clock, felt: NOTHING, rest };
        let found = start::hypotheses(geometry, &self.config, &sighting, up.as_ref(), &climber);
        let Some(best) = found.into_iter().next() else {
            self.refuse(image, pixels, MarkerOutcome::Inconsistent, out);
            return;
        };
        self.record(image, &best.report, out);
        self.last_used = Some(image);
        out.push_back(Output::Warning(Warning::Initialised { stamp: image }));
        self.started = true;
        self.begin(stamp, best.state, out);
    }

    /// Puts a state at an instant and runs what is behind it.
    fn begin(&mut self, stamp: Stamp, state: State, out: &mut VecDeque<Output>) {
        let place = self.history.place_of(stamp);
        let felt =
            match (place.checked_sub(1).and_then(|p| self.history.get(p)), self.history.next_imu(place)) {
                (Some(before), Some(next)) if matches!(before.event, Event::Imu { .. }) => {
                    let span = next.stamp.seconds_since(before.stamp);
                    let share = if span > 0.0 { stamp.seconds_since(before.stamp) / span } else { 0.0 };
                    before.felt.between(&next.felt, share.clamp(0.0, 1.0))
                }
                (_, Some(next)) => next.felt,
                (_, None) => match self.newest_imu {
                    Some((_, felt)) => felt,
                    None => return,
                },
            };
        for _ in 0..place {
            self.history.drop_first();
        }
        let place = self.history.insert(stamp, Event::Set, felt);
        if let Some(node) = self.history.get_mut(place) {
            node.state = state;
        }
        self.history.set_run(1);
        self.run(out);
    }

    /// The climber at an instant from the readings around it.
    fn climber_at(&self, stamp: Stamp) -> Option<(ClimberStart, ClimberRest)> {
        let (newest, _, _) = self.readings.back()?;
        if newest.seconds_since(stamp).abs() > 1.0 {
            return None;
        }
        let recent = || self.readings.iter().filter(|(s, _, _)| s.seconds_since(stamp).abs() < 0.25);
        let nearest =
            self.readings.iter().min_by_key(|(s, _, _)| (s.as_nanos() - stamp.as_nanos()).unsigned_abs())?;
        let step = Vector3::new(
            self.config.climber_quantum,
            self.config.climber_quantum,
            self.config.climber_turn_quantum,
        );
        let any = Vector3::new(0.5, 0.5, 0.4);
        let (mut rates, mut rate_sigma) = (Vector3::zeros(), any);
        if let (Some(first), Some(last)) = (recent().next(), recent().next_back()) {
            let span = last.0.seconds_since(first.0);
            if span > 0.03 {
                rates = last.1 - first.1;
                rates.z = climber::wrapped(rates.z);
                rates /= span;
                rate_sigma = (step / span + Vector3::repeat(0.5 * span)).inf(&any);
            }
        }
        let age = stamp.seconds_since(nearest.0);
        let values = nearest.1 + rates * age;
        let sigma = step + rate_sigma * age.abs();
        Some((ClimberStart { values, rates, sigma, rate_sigma }, nearest.2))
    }
}

/// The platform stands still: velocity and rate of turn are zero, where the filter does not know better.
fn at_rest(state: &mut State, mean_rate: &Vector3<f64>, sigma: f64, rate_density: f64) {
    let v = state.velocity;
    let p = |i: usize| state.covariance[(i, i)];
    let agrees = (0..3).all(|i| {
        v[i].abs() < 3.0 * (p(VELOCITY + i) + sigma * sigma).sqrt()
            && state.climber_rate[i].abs() < 3.0 * p(CLIMBER_RATE + i).sqrt() + 0.002
            && (mean_rate[i] - state.gyroscope_bias[i]).abs()
                < 3.0 * (p(GYROSCOPE + i) + 2.0 * rate_density).sqrt() + 1e-3
    });
    if !agrees {
        return;
    }
    for i in 0..3 {
        let residual = -state.velocity[i];
        markers::scalar_update(state, &[(VELOCITY + i, 1.0)], residual, sigma * sigma);
        let residual = mean_rate[i] - state.gyroscope_bias[i];
        // Half a second's mean: density / 0.5 s, and a tenth of a degree per second that nobody would see.
        markers::scalar_update(state, &[(GYROSCOPE + i, 1.0)], residual, 2.0 * rate_density + 3e-6);
    }
}

fn widen_over_gap(state: &mut State, seconds: f64) {
    for i in 0..3 {
        let velocity = 1.0 * seconds;
        state.covariance[(VELOCITY + i, VELOCITY + i)] += velocity * velocity;
        state.covariance[(POSITION + i, POSITION + i)] += (0.5 * velocity * seconds).powi(2);
        state.covariance[(ATTITUDE + i, ATTITUDE + i)] += (0.5 * seconds).powi(2);
    }
}
