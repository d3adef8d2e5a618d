//! The error-state filter: every visible marker's pixels, the encoders and the inertial unit, each at its own time.
//!
//! In flow [`crate::Input`]s in order of arrival; out flow odometry with every inertial sample, and a record for every
//! marker of every image. See [`state`] for the state, [`propagate`] for its motion, [`markers`] and [`climber`] for what
//! corrects it, [`history`] for late data, [`start`] for the beginning.

pub mod bank;
mod begin;
pub mod climber;
pub mod gap;
pub mod geometry;
pub mod history;
mod intake;
mod jolt;
mod learn;
pub mod markers;
pub mod noise;
pub mod odometry;
pub mod operator;
pub mod pendulum;
pub mod propagate;
mod run;
pub mod smoother;
pub mod start;
pub mod state;
pub mod systematic;
pub mod tie;

use crate::{config::TightConfig, output::Odometry, status::Status};
use climber::ReadingNoise;
use geometry::Geometry;
use history::{History, Node};
use jolt::{Evidence, Jolts};
use nalgebra::{Matrix2, Vector2, Vector3};
use noise::{InertialNoise, Stillness};
use odometry::Along;
use pendulum::Comparison;
use propagate::Felt;
use rig_model::{CameraModel, Rig, Stamp};
use start::Up;
use state::{ATTITUDE, CAMERA_CLOCK, CLIMBER, Error, POSITION, State};
use std::collections::VecDeque;
use tie::{Belief, Prior, Readings};

/// Further ahead of the inertial samples than this, a message is not believed, s.
const AHEAD: f64 = 0.5;
/// An inertial stamp further from its predecessor than this must be confirmed by others, s.
const JUMP: f64 = 1.0;
/// So many inertial samples in a row confirm a jump of time.
const CONFIRM: u32 = 3;
/// A longer pause between inertial samples is a gap, s.
const GAP: f64 = 0.05;
/// A longer gap is not bridged where an image can start the pose anew, s.
const BRIDGED: f64 = 0.4;
/// What a rejected marker costs a hypothesis: as much as the gate, and a usual ln |S| on top.
const REFUSED_PRICE: f64 = 20.0;
/// So many images are no evidence yet: the noise of the other sensors is still being found.
const SETTLING: u64 = 15;
/// So many images of a driving climber say nothing of its clock: biases are still being found, and what drives it as well.
/// (Those of one that stands teach neither.)
const ASKING: u64 = 60;
/// One answer about the climber's clock that is so probable is taken as given.
const SURE: f64 = 0.99;
/// A smaller change of the climber's clock needs no other linearisation, s.
const MOVE: f64 = 2e-3;
/// A reading that is so much (squared, in sigmas) off means that the climber jerks more than assumed.
const JERKY: f64 = 10.0;
/// A climber that stands will set off, and jerks by so much (in units of the density assumed of one that drives) when it does.
const SETTING_OFF: f64 = 100.0;
/// So many image stamps are remembered to tell duplicates.
const REMEMBERED: usize = 64;
/// And so many readings of the climber: [`tie::SPAN`] at 100 Hz, and as much again for those that come late.
const READINGS: usize = 200;

/// To be interpolated.
const NOTHING: Felt = Felt { force: Vector3::new(0.0, 0.0, 0.0), rate: Vector3::new(0.0, 0.0, 0.0) };

/// Centroid and covariance of each detected marker.
type Pixels = [Option<(Vector2<f64>, Matrix2<f64>)>; 4];

/// The error-state filter.
#[derive(Clone, Debug)]
pub struct Tight {
    rig: Rig,
    config: TightConfig,
    /// What is thought of the climber's clock before the data, and what is taken as given.
    prior: Prior,
    climber_clock: f64,
    geometry: Option<Geometry>,
    history: History,
    started: bool,
    frozen: bool,
    newest_imu: Option<(Stamp, Felt)>,
    jump: Option<(Stamp, u32)>,
    attitudes: VecDeque<(Stamp, Up)>,
    readings: Readings,
    images: VecDeque<Stamp>,
    inertial_noise: InertialNoise,
    stillness: Stillness,
    reading_noise: ReadingNoise,
    /// What the readings in the history were weighed with.
    reading_variance: Vector3<f64>,
    jerk_scale: f64,
    jolts: Jolts,
    comparison: Comparison,
    pixel_scale: f64,
    pixel_ratio: f64,
    contradictions: u32,
    contradicted_since: Option<Stamp>,
    last_used: Option<Stamp>,
    lost: bool,
    /// The image to start from, while the inertial samples have not come so far.
    awaited: Option<(Stamp, Pixels)>,
    /// The last state before an outage: its clocks and biases serve the next start.
    kept: Option<Box<State>>,
    /// Of which instant, where it may be taken up as a whole.
    kept_at: Option<Stamp>,
    /// What nothing can change any more, for the smoother; `None` where it is not wanted.
    archive: Option<Vec<Node>>,
    evidence: Evidence,
    weighed: u64,
    /// From so many images on the rope is asked.
    ask_after: u64,
    /// The climber was seen driving by its newest reading, and so many images were taken while it was.
    driving: bool,
    driven: u64,
    /// Other filters take the camera's clock for another.
    camera_clock_open: bool,
    /// In the newest image.
    markers_seen: usize,
    status: Status,
}

impl Tight {
    /// A filter that knows nothing yet.
    pub fn new(rig: Rig, config: TightConfig) -> Self {
        let steps = Vector3::new(config.climber_quantum, config.climber_quantum, config.climber_turn_quantum);
        let reading_noise = ReadingNoise::new(steps);
        Self {
            rig,
            prior: Prior {
                tied: if config.climber_clock > 0.0 { config.climber_clock_tied } else { 1.0 },
                mean: 0.0,
                sigma: config.climber_clock.max(1e-6),
            },
            climber_clock: 0.0,
            geometry: None,
            history: History::default(),
            started: false,
            frozen: false,
            newest_imu: None,
            jump: None,
            attitudes: VecDeque::with_capacity(REMEMBERED),
            readings: VecDeque::with_capacity(READINGS + 1),
            images: VecDeque::with_capacity(REMEMBERED),
            inertial_noise: InertialNoise::default(),
            stillness: Stillness::default(),
            reading_variance: reading_noise.variance(),
            reading_noise,
            jerk_scale: SETTING_OFF,
            jolts: Jolts::default(),
            comparison: Comparison::default(),
            pixel_scale: 1.0,
            pixel_ratio: 1.0,
            contradictions: 0,
            contradicted_since: None,
            last_used: None,
            lost: false,
            awaited: None,
            kept: None,
            kept_at: None,
            archive: None,
            evidence: Evidence::default(),
            weighed: 0,
            ask_after: ASKING,
            driving: false,
            driven: 0,
            camera_clock_open: false,
            markers_seen: 0,
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
        let belief = self.belief();
        let (mean, variance) = belief.moments();
        status.climber_clock_offset = mean;
        status.climber_clock_sigma = variance.sqrt();
        status.climber_clock_tied = belief.tied;
        status.rope = self.rope();
        if let Some(state) = self.state() {
            let p = &state.covariance;
            let by_offset = state.tie.by_offset[CAMERA_CLOCK];
            status.camera_clock_offset = state.camera_clock + by_offset * (mean - self.climber_clock);
            status.camera_clock_sigma =
                (p[(CAMERA_CLOCK, CAMERA_CLOCK)].max(0.0) + by_offset * by_offset * variance).sqrt();
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

    /// How unlikely the images that count were together (minus twice the logarithm of their likelihood, up to a constant).
    pub fn evidence(&self) -> f64 {
        self.evidence.sum
    }

    /// What each image says for or against this filter.
    pub(super) fn images_say(&self) -> &Evidence {
        &self.evidence
    }

    /// An image that all filters have weighed counts; one that some never will is forgotten.
    pub(super) fn close_image(&mut self, image: Stamp, counts: bool) {
        self.evidence.close(image, counts);
    }

    /// What is thought of the climber's clock.
    pub fn belief(&self) -> Belief {
        match self.state() {
            Some(state) if !self.camera_clock_open => self.prior.after(self.climber_clock, &state.tie),
            _ => self.prior.belief(),
        }
    }

    /// The climber's clock offset that is taken as given, s.
    pub fn climber_clock(&self) -> f64 {
        self.climber_clock
    }

    /// Lets the climber's clock be: as long as the camera's is open, what is found of it is not used.
    pub fn let_be(&mut self, open: bool) {
        self.camera_clock_open = open;
    }

    /// Where the offset that is taken as given is another than the one that is believed, all moves to that.
    pub(super) fn recentre(&mut self) {
        let belief = self.belief();
        let by = if belief.tied > SURE {
            -self.climber_clock
        } else if belief.tied < 1.0 - SURE {
            belief.mean - self.climber_clock
        } else {
            0.0
        };
        if by.abs() < MOVE.max(belief.variance.sqrt()) && !(belief.tied > SURE && by != 0.0) {
            return;
        }
        let gravity = self.config.gravity;
        self.history.each_node(|node| node.state.recentre(by, &node.felt, gravity));
        for node in self.archive.iter_mut().flatten() {
            node.state.recentre(by, &node.felt, gravity);
        }
        if let Some(kept) = &mut self.kept {
            kept.recentre(by, &NOTHING, gravity);
        }
        self.climber_clock += by;
    }

    /// How many images that is.
    pub fn weighed(&self) -> u64 {
        self.weighed
    }

    /// Adds what else speaks against this filter.
    pub fn add_evidence(&mut self, surprise: f64) {
        self.evidence.sum += surprise;
    }

    /// Stops or resumes using markers; what is not used is still compared and recorded.
    pub fn freeze(&mut self, frozen: bool) {
        self.frozen = frozen;
    }

    /// Keeps from now on what the smoother needs: about 1 MB for each second.
    pub fn keep_archive(&mut self) {
        self.archive.get_or_insert_default();
    }

    /// How much is kept, s.
    pub fn archived(&self) -> f64 {
        let ends = self.archive.as_ref().and_then(|a| Some((a.first()?, a.last()?)));
        ends.map_or(0.0, |(first, last)| last.stamp.seconds_since(first.stamp))
    }

    /// The smoothed odometry with every inertial sample of what is kept, but for the last `lag` seconds of it, which stay.
    pub fn smoothed(&mut self, lag: f64) -> Vec<Odometry> {
        let (Some(nodes), Some(geometry)) = (self.archive.take(), &self.geometry) else { return Vec::new() };
        let states = smoother::smooth(&nodes, self.config.gravity);
        let end = nodes.last().map_or(Stamp::default(), |n| n.stamp).plus_seconds(-lag);
        let ready = nodes.iter().take_while(|n| n.stamp <= end).count();
        let period = self.inertial_noise.period().max(1e-4);
        let (mean, variance) = self.belief().moments();
        let climber_clock = (mean - self.climber_clock, variance);
        let said = nodes
            .iter()
            .zip(&states)
            .take(ready)
            .filter(|(node, _)| matches!(node.event, history::Event::Imu { .. }))
            .map(|(node, state)| {
                let along = Along {
                    rate_variance: node.process.rate / period,
                    gravity: self.config.gravity,
                    climber_clock,
                    systematic: self.config.pixel_systematic,
                };
                odometry::odometry(node.stamp, state, &node.felt, geometry, &along)
            })
            .collect();
        self.archive = Some(nodes.into_iter().skip(ready).collect());
        said
    }

    /// Ends what is kept with the newest state.
    pub fn archive_all(&mut self) {
        if let (Some(archive), true) = (&mut self.archive, self.started) {
            archive.extend((0..self.history.run()).filter_map(|p| self.history.get(p)).cloned());
        }
    }

    fn archive_first(&mut self) {
        if let (Some(archive), true, true) = (&mut self.archive, self.started, self.history.run() > 0) {
            archive.extend(self.history.get(0).cloned());
        }
    }

    /// Forgets the estimate and starts from the next image. What is known of the noise is forgotten as well.
    pub fn reset(&mut self) {
        let (status, frozen) = (self.status.clone(), self.frozen);
        let geometry = self.geometry.take();
        let (evidence, weighed, prior) = (self.evidence.clone(), self.weighed, self.prior);
        self.archive_all();
        let mut fresh = Self::new(self.rig.clone(), self.config.clone());
        fresh.geometry = geometry;
        fresh.status = status;
        fresh.frozen = frozen;
        (fresh.evidence, fresh.weighed, fresh.prior) = (evidence, weighed, prior);
        fresh.ask_after = weighed + ASKING;
        fresh.camera_clock_open = self.camera_clock_open;
        fresh.archive = self.archive.take();
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

    fn position_sigma(&self, state: &State) -> f64 {
        let (_, doubt) = self.belief().moments();
        let variance = |i: usize| state.covariance[(i, i)] + state.tie.by_offset[i].powi(2) * doubt;
        (POSITION..POSITION + 3).map(variance).fold(0.0, f64::max).sqrt()
    }
}

/// By how much everything differs, per second of the climber's clock, where nothing is known of the platform but what the
/// camera sees of it: it moves rigidly with the climber, which was `speed` less far.
fn rigid(state: &State, speed: &Vector3<f64>) -> Error {
    let mut by_offset = Error::zeros();
    let arm = state.position - Vector3::new(state.climber.x, state.climber.y, state.position.z);
    let carried = Vector3::new(speed.x, speed.y, 0.0) + Vector3::z().cross(&arm) * speed.z;
    by_offset.fixed_rows_mut::<3>(POSITION).copy_from(&-carried);
    by_offset[ATTITUDE + 2] = -speed.z;
    by_offset.fixed_rows_mut::<3>(CLIMBER).copy_from(&-speed);
    by_offset
}
