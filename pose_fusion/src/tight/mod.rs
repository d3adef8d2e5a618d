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
mod learn;
pub mod markers;
pub mod noise;
pub mod odometry;
pub mod operator;
pub mod propagate;
mod run;
pub mod smoother;
pub mod start;
pub mod state;
pub mod tie;

use crate::{config::TightConfig, output::Odometry, status::Status};
use climber::ReadingNoise;
use geometry::{ClimberRest, Geometry};
use history::{History, Node};
use nalgebra::{Matrix2, UnitQuaternion, Vector2, Vector3, Vector6};
use noise::{InertialNoise, Stillness};
use propagate::Felt;
use rig_model::{CameraModel, Rig, Stamp};
use start::Up;
use state::{CAMERA_CLOCK, POSITION, State, VELOCITY};
use std::collections::VecDeque;

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
/// A reading that is so much (squared, in sigmas) off means that the climber jerks more than assumed.
const SURPRISE: f64 = 10.0;
/// So many image stamps are remembered to tell duplicates.
const REMEMBERED: usize = 64;

/// To be interpolated.
const NOTHING: Felt = Felt { force: Vector3::new(0.0, 0.0, 0.0), rate: Vector3::new(0.0, 0.0, 0.0) };

/// Centroid and covariance of each detected marker.
type Pixels = [Option<(Vector2<f64>, Matrix2<f64>)>; 4];

/// The error-state filter.
#[derive(Clone, Debug)]
pub struct Tight {
    rig: Rig,
    config: TightConfig,
    climber_clock: f64,
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
    /// The last state before an outage: its clocks and biases serve the next start.
    kept: Option<Box<State>>,
    /// Of which instant, where it may be taken up as a whole.
    kept_at: Option<Stamp>,
    /// What nothing can change any more, for the smoother; `None` where it is not wanted.
    archive: Option<Vec<Node>>,
    evidence: f64,
    weighed: u64,
    settling: u64,
    /// In the newest image.
    markers_seen: usize,
    status: Status,
}

impl Tight {
    /// A filter that knows nothing yet.
    pub fn new(rig: Rig, config: TightConfig) -> Self {
        let steps = Vector3::new(config.climber_quantum, config.climber_quantum, config.climber_turn_quantum);
        Self {
            rig,
            climber_clock: 0.0,
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
            kept: None,
            kept_at: None,
            archive: None,
            evidence: 0.0,
            weighed: 0,
            settling: SETTLING,
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
        status.climber_clock_offset = self.climber_clock;
        if let Some(state) = self.state() {
            let p = &state.covariance;
            status.camera_clock_offset = state.camera_clock;
            status.camera_clock_sigma = p[(CAMERA_CLOCK, CAMERA_CLOCK)].max(0.0).sqrt();
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

    /// Velocity and rate of turn (world) with which the platform is carried by the climber.
    pub fn carried(&self) -> Vector6<f64> {
        let Some(state) = self.state() else { return Vector6::zeros() };
        let (rate, z) = (state.climber_rate, Vector3::z());
        let arm = state.position - Vector3::new(state.climber.x, state.climber.y, state.position.z);
        let v = Vector3::new(rate.x, rate.y, 0.0) + z.cross(&arm) * rate.z;
        Vector6::new(v.x, v.y, v.z, 0.0, 0.0, rate.z)
    }

    /// Goes on counting from there.
    pub fn count_on(&mut self, status: Status) {
        self.status = status;
    }

    /// Counts the evidence anew, after so many images more.
    pub fn forget_evidence(&mut self, settling: u64) {
        (self.evidence, self.weighed, self.settling) = (0.0, 0, settling);
    }

    /// The climber's clock offset d that is taken as given, s.
    pub fn climber_clock(&self) -> f64 {
        self.climber_clock
    }

    /// A copy that takes the climber's clock to be off by `offset`. Everything that is known moves rigidly with the climber along
    /// the climber's own way; how well that way is bent is known to [`BEND`], so much less is known of the velocity.
    #[must_use]
    pub fn with_climber_clock(&self, offset: f64) -> Self {
        let mut other = self.clone();
        let later = offset - self.climber_clock;
        other.climber_clock = offset;
        other.history.each_state(|state| move_climber(state, later));
        for node in other.archive.iter_mut().flatten() {
            move_climber(&mut node.state, later);
        }
        if let Some(kept) = &mut other.kept {
            move_climber(kept, later);
        }
        other
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
        let said = nodes
            .iter()
            .zip(&states)
            .take(ready)
            .filter(|(node, _)| matches!(node.event, history::Event::Imu { .. }))
            .map(|(node, state)| {
                let white = node.process.rate / period;
                odometry::odometry(node.stamp, state, &node.felt, geometry, white, self.config.gravity)
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
        let (evidence, weighed) = (self.evidence, self.weighed);
        self.archive_all();
        let mut fresh = Self::new(self.rig.clone(), self.config.clone());
        fresh.geometry = geometry;
        fresh.status = status;
        fresh.frozen = frozen;
        (fresh.evidence, fresh.weighed, fresh.settling) = (evidence, weighed, self.settling);
        fresh.climber_clock = self.climber_clock;
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
        (0..3).map(|i| state.covariance[(POSITION + i, POSITION + i)]).fold(0.0, f64::max).sqrt()
    }
}

/// Acceleration of the climber that its readings may leave unseen, m/s² (1 sigma).
const BEND: f64 = 0.2;

/// The climber was `later` seconds less far on its way, and the platform with it.
fn move_climber(state: &mut State, later: f64) {
    let z = Vector3::z();
    let flat = |v: &Vector3<f64>| Vector3::new(v.x, v.y, 0.0);
    let (place, rate) = (flat(&state.climber), state.climber_rate);
    let back = state.climber_rate * later - state.climber_acceleration * (later * later / 2.0);
    state.climber -= back;
    state.climber_rate -= state.climber_acceleration * later;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -back.z);
    let arm = state.position - place;
    let against = state.velocity - flat(&rate) - z.cross(&arm) * rate.z;
    let arm = turn * arm;
    state.position = flat(&state.climber) + arm;
    state.velocity = turn * against + flat(&state.climber_rate) + z.cross(&arm) * state.climber_rate.z;
    state.attitude = turn * state.attitude;
    for i in 0..2 {
        state.covariance[(VELOCITY + i, VELOCITY + i)] += (BEND * later).powi(2);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moved_with_the_climber_the_camera_sees_the_same() {
        let mut s = State::zero();
        s.position = Vector3::new(0.4, 0.2, 1.3);
        s.velocity = Vector3::new(0.3, -0.2, 0.1);
        s.attitude = UnitQuaternion::from_euler_angles(0.1, 0.2, 0.5);
        s.climber = Vector3::new(0.1, -0.1, 0.4);
        s.climber_rate = Vector3::new(0.3, 0.2, -0.15);
        s.climber_acceleration = Vector3::new(-0.2, 0.1, 0.05);
        let climber = |s: &State| {
            let rest = ClimberRest { height: 2.8, tilt: UnitQuaternion::identity() };
            rest.join(&s.climber).inverse() * nalgebra::Isometry3::from_parts(s.position.into(), s.attitude)
        };
        let before = s.clone();
        move_climber(&mut s, 0.03);
        let (a, b) = (climber(&before), climber(&s));
        assert!((a.translation.vector - b.translation.vector).norm() < 1e-12);
        assert!(a.rotation.angle_to(&b.rotation) < 1e-7);
        // Back by 30 ms on a way at 0.3 m/s.
        assert!((before.climber.x - s.climber.x - (0.3 * 0.03 + 0.2 * 0.00045)).abs() < 1e-12);
        move_climber(&mut s, -0.03);
        assert!((s.position - before.position).norm() < 1e-3 && (s.velocity - before.velocity).norm() < 1e-3);
    }
}
