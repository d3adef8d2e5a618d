//! The clock offsets are found by filters that start from different offsets side by side.
//!
//! First the camera's. An error-state filter corrects its clock offset well while it is off by a few milliseconds, and loses its way where
//! it is off by more than an image period: it then integrates the wrong inertial samples. So the offset is first a choice among
//! hypotheses [`STEP`] apart, each a filter of its own. Every image weighs them by what it surprises them (`νᵀ S⁻¹ ν + ln |S|`, and a fixed
//! price for a marker that is gated), any two by the images that both have weighed: one that still waits for inertial samples is not behind
//! one that does not. Those that fall far behind another are dropped, and the last one goes on alone and tunes its offset as a state.
//! Without motion no hypothesis falls behind: the one of the configured offset speaks until another is clearly better, and the offset
//! stays open.

use super::{
    Tight,
    operator::{Checkpoint, Refusal},
    state::CAMERA_CLOCK,
    tie::Prior,
};
use crate::{
    config::TightConfig,
    output::{Odometry, Output, PoseEstimate},
    status::Status,
};
use nalgebra::Vector6;
use rig_model::{CameraModel, ClimberSample, ImuSample, MarkerObservations, Rig, Stamp};
use std::collections::VecDeque;

/// Distance between the hypotheses, s.
pub const STEP: f64 = 0.010;
/// Uncertainty of the offset within one, s.
pub const WITHIN: f64 = 0.006;
/// How far they reach, in sigmas of the offset.
const REACH: f64 = 2.2;
/// A hypothesis that is so much less likely than the best (minus twice the logarithm) is dropped.
const DROP: f64 = 100.0;
/// Another one speaks when it is so much more likely than the speaker.
const CHANGE: f64 = 40.0;

/// Adds what an unknown offset of the clock makes of the pose: `ẋ ẋᵀ σ²`.
fn widen(odometry: &mut Odometry, variance: f64) {
    let turn = odometry.world_from_volant.rotation;
    let (v, w) = (turn * odometry.linear_velocity, turn * odometry.angular_velocity);
    let motion = Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z);
    odometry.pose_covariance += motion * motion.transpose() * variance;
}

/// So much is smoothed at a time, s.
const SMOOTHED: f64 = 60.0;
/// So much of what comes later is known to it, s: biases and clocks are found in less.
const LAG: f64 = 20.0;
/// After so many images two hypotheses may have become one.
const SETTLED: u64 = 60;

/// Filters side by side, of which one speaks.
#[derive(Debug)]
pub struct Bank {
    rig: Rig,
    config: TightConfig,
    /// As it was told, before anything was found.
    told: TightConfig,
    members: Vec<Tight>,
    speaker: usize,
    smoothing: bool,
    /// To be used again.
    images: Vec<Stamp>,
    silent: VecDeque<Output>,
}

impl Bank {
    /// One filter where the offset is known to [`STEP`] or so, else as many as its uncertainty asks for.
    pub fn new(rig: Rig, config: TightConfig) -> Self {
        let mut bank = Self {
            rig,
            told: config.clone(),
            config,
            members: Vec::new(),
            speaker: 0,
            smoothing: false,
            images: Vec::new(),
            silent: VecDeque::with_capacity(256),
        };
        bank.fill();
        bank
    }

    fn fill(&mut self) {
        self.members.clear();
        self.speaker = 0;
        let reach = if self.config.camera_clock > WITHIN {
            (REACH * self.config.camera_clock / STEP).round() as i32
        } else {
            0
        };
        // The configured offset first: it speaks until it is refuted.
        for i in 0..=2 * reach {
            let step = if i % 2 == 0 { i / 2 } else { -(i + 1) / 2 };
            let away = f64::from(step) * STEP;
            let config = TightConfig {
                camera_clock_offset: self.config.camera_clock_offset + away,
                camera_clock: self.config.camera_clock.min(WITHIN),
                ..self.config.clone()
            };
            let mut member = Tight::new(self.rig.clone(), config);
            if self.smoothing {
                member.keep_archive();
            }
            if reach > 0 {
                member.let_be(true);
                member.add_evidence((away / self.config.camera_clock).powi(2));
            }
            self.members.push(member);
        }
    }

    /// The filter that speaks.
    pub fn speaker(&self) -> &Tight {
        &self.members[self.speaker]
    }

    /// The filter that speaks, to be changed.
    pub fn speaker_mut(&mut self) -> &mut Tight {
        &mut self.members[self.speaker]
    }

    /// What is known now.
    ///
    /// # Errors
    /// There is no estimate.
    pub fn checkpoint(&self) -> Result<Checkpoint, Refusal> {
        self.speaker().checkpoint()
    }

    /// Takes up what was known (see [`Tight::restore`]).
    ///
    /// # Errors
    /// The checkpoint cannot be; nothing is changed then.
    pub fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), Refusal> {
        let state = checkpoint.state()?;
        let sigma = state.covariance[(CAMERA_CLOCK, CAMERA_CLOCK)].max(0.0).sqrt();
        self.config = self.told.clone();
        if self.config.camera_clock > 0.0 {
            self.config.camera_clock_offset = checkpoint.camera_clock;
            self.config.camera_clock = sigma.clamp(1e-6, WITHIN);
        }
        let prior = Prior {
            tied: checkpoint.climber_clock_tied,
            mean: checkpoint.climber_clock,
            sigma: checkpoint.climber_clock_sigma.max(1e-4),
        };
        let camera = self.speaker().camera_model().cloned();
        self.fill();
        camera.iter().for_each(|camera| self.camera(camera));
        let stamp = Stamp::from_nanos(checkpoint.stamp_ns);
        self.members.iter_mut().for_each(|m| m.restore(state.clone(), stamp, prior));
        Ok(())
    }

    /// Puts the platform at a pose.
    ///
    /// # Errors
    /// As [`Tight::set_pose`].
    pub fn set_pose(&mut self, pose: &PoseEstimate, out: &mut VecDeque<Output>) -> Result<(), Refusal> {
        let mut result = Ok(());
        self.each(out, |member, out| {
            if let Err(refusal) = member.set_pose(pose, out) {
                result = Err(refusal);
            }
        });
        result
    }

    /// Keeps from now on what the smoother needs.
    pub fn keep_archive(&mut self) {
        self.smoothing = true;
        self.members.iter_mut().for_each(Tight::keep_archive);
    }

    /// The smoothed odometry that is ready: [`SMOOTHED`] seconds at a time with the knowledge of [`LAG`] seconds more; at
    /// the end all that is left. So the memory is bounded however long the run is.
    pub fn smoothed(&mut self, end: bool) -> Vec<Odometry> {
        let ready = self.members.len() == 1 && self.speaker().archived() > SMOOTHED + LAG;
        if !(end || ready) {
            return Vec::new();
        }
        let speaker = self.speaker_mut();
        if end {
            speaker.archive_all();
        }
        speaker.smoothed(if end { 0.0 } else { LAG })
    }

    /// How many hypotheses are left.
    pub fn hypotheses(&self) -> usize {
        self.members.len()
    }

    /// Counters and insights of the one that speaks.
    pub fn status(&self) -> Status {
        let mut status = self.speaker().status();
        status.clock_hypotheses = self.members.len();
        if self.members.len() > 1 {
            // As far as they lie apart, the offset is not known better.
            let offsets = self.members.iter().map(|m| m.status().camera_clock_offset);
            let (low, high) =
                offsets.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
            status.camera_clock_sigma = status.camera_clock_sigma.max((high - low) / 2.0);
        }
        status
    }

    /// Forgets everything.
    pub fn reset(&mut self) {
        self.config = self.told.clone();
        let cameras: Vec<CameraModel> =
            self.members.iter().take(1).filter_map(|m| m.camera_model().cloned()).collect();
        self.fill();
        cameras.iter().for_each(|camera| self.camera(camera));
    }

    /// Stops or resumes using markers.
    pub fn freeze(&mut self, frozen: bool) {
        self.members.iter_mut().for_each(|m| m.freeze(frozen));
    }

    /// The camera's calibration.
    pub fn camera(&mut self, camera: &CameraModel) {
        self.members.iter_mut().for_each(|m| m.camera(camera));
    }

    /// An inertial sample.
    pub fn imu(&mut self, sample: &ImuSample, out: &mut VecDeque<Output>) {
        let said = out.len();
        self.each(out, |member, out| member.imu(sample, out));
        if self.members.len() > 1 && self.drop_lost() {
            // What a lost one says is no pose; the next sample is another's.
            let mut index = 0;
            out.retain(|output| {
                index += 1;
                index <= said || !matches!(output, Output::Odometry(_))
            });
        }
        if self.members.len() > 1 {
            let variance = self.open_variance();
            for output in out.iter_mut().skip(said) {
                if let Output::Odometry(odometry) = output {
                    widen(odometry, variance);
                }
            }
        }
        self.weigh();
    }

    /// How far the offsets of the hypotheses that are still likely lie from the speaker's, s² (mean square).
    fn open_variance(&self) -> f64 {
        let Some(speaker) = self.speaker().state().map(|s| s.camera_clock) else { return 0.0 };
        let (mut sum, mut square) = (0.0, 0.0);
        for (member, deficit) in self.members.iter().zip(self.deficits()) {
            let Some(state) = member.state() else { continue };
            // Half as sharp as the evidence would be if noise were as white as the filters take it.
            let weight = (-deficit / 4.0).exp();
            sum += weight;
            square += weight * (state.camera_clock - speaker).powi(2);
        }
        if sum > 0.0 { square / sum } else { 0.0 }
    }

    /// The markers of an image.
    pub fn markers(&mut self, observations: &MarkerObservations, out: &mut VecDeque<Output>) {
        self.each(out, |member, out| member.markers(observations, out));
        self.weigh();
    }

    /// The climber's encoders.
    pub fn climber(&mut self, sample: &ClimberSample, out: &mut VecDeque<Output>) {
        self.each(out, |member, out| member.climber(sample, out));
    }

    fn each(&mut self, out: &mut VecDeque<Output>, mut work: impl FnMut(&mut Tight, &mut VecDeque<Output>)) {
        for (i, member) in self.members.iter_mut().enumerate() {
            if i == self.speaker {
                work(member, out);
            } else {
                work(member, &mut self.silent);
                self.silent.clear();
            }
        }
    }

    /// Images reach the hypotheses at different moments of the inertial clock, and late ones not all of them: those count that all have
    /// weighed.
    fn close_images(&mut self) {
        let mut images = std::mem::take(&mut self.images);
        images.extend(self.members.iter().flat_map(|m| m.images_say().open()));
        images.sort_unstable();
        images.dedup();
        for image in images.drain(..) {
            let says = |m: &Tight| m.images_say().said(image);
            let all = self.members.iter().all(|m| says(m).is_some());
            let never = self.members.iter().any(|m| says(m) == Some(None) || m.images_say().is_past(image));
            if all || never {
                self.members.iter_mut().for_each(|m| m.close_image(image, all && !never));
            }
        }
        self.images = images;
    }

    /// How much more each has against it than another one that has weighed the same images: the most of all others.
    fn deficits(&self) -> Vec<f64> {
        let says = || self.members.iter().map(Tight::images_say);
        says().map(|m| says().map(|other| m.against(other)).fold(0.0, f64::max)).collect()
    }

    fn weigh(&mut self) {
        if self.members.len() == 1 {
            return;
        }
        self.drop_lost();
        if self.members.len() == 1 {
            return self.alone();
        }
        self.close_images();
        let images = self.members.iter().map(Tight::weighed).max().unwrap_or(0);
        if self.members.iter().any(|m| m.weighed() + 3 < images) {
            // One that cannot start is no hypothesis.
            self.retain(|m| m.weighed() + 12 >= images);
        }
        if images == 0 {
            return;
        }
        let deficits = self.deficits();
        if deficits.get(self.speaker).is_some_and(|deficit| *deficit > CHANGE) {
            let speaker = self.speaker().images_say();
            let by = |m: &Tight| speaker.against(m.images_say());
            let best = self.members.iter().map(by).enumerate().max_by(|a, b| a.1.total_cmp(&b.1));
            self.speaker = best.map_or(self.speaker, |(best, _)| best);
        }
        // Neighbours that have tuned themselves to the speaker's offset are the same hypothesis.
        let offset = |m: &Tight| m.state().map(|s| s.camera_clock);
        let spoken = offset(self.speaker());
        let same = |m: &Tight| {
            images > SETTLED
                && matches!((offset(m), spoken), (Some(a), Some(b)) if (a - b).abs() < 0.2 * STEP)
        };
        let same: Vec<bool> = self.members.iter().map(same).collect();
        let mut all = deficits.iter().zip(&same);
        self.retain(|_| all.next().is_some_and(|(deficit, same)| *deficit <= DROP && !same));
        self.alone();
    }

    /// The last hypothesis tunes the climber's clock too.
    fn alone(&mut self) {
        if let [last] = self.members.as_mut_slice() {
            last.let_be(false);
        }
    }

    /// A wrong hypothesis can lose its way before it is refuted: its offset runs away to where no image is any more, and nothing more
    /// speaks against it. True where that was the one that speaks.
    fn drop_lost(&mut self) -> bool {
        let farthest = 2.0 * REACH * self.config.camera_clock.max(WITHIN);
        let told = self.config.camera_clock_offset;
        let lost = |m: &Tight| {
            let off = m.state().map(|s| (s.camera_clock - told).abs());
            off.is_some_and(|off| off.is_nan() || off > farthest)
        };
        if !self.members.iter().any(lost) || self.members.iter().all(lost) {
            return false;
        }
        let spoke = lost(&self.members[self.speaker]);
        if spoke {
            let sound = self.members.iter().enumerate().filter(|(_, m)| !lost(m));
            let best = sound.min_by(|a, b| a.1.evidence().total_cmp(&b.1.evidence()));
            self.speaker = best.map_or(0, |(i, _)| i);
        }
        self.retain(|m| !lost(m));
        spoke
    }

    /// Keeps these, and the one that speaks.
    fn retain(&mut self, mut stays: impl FnMut(&Tight) -> bool) {
        let (speaker, mut index, mut shift) = (self.speaker, 0, 0);
        self.members.retain(|m| {
            let keep = stays(m) || index == speaker;
            shift += usize::from(!keep && index < speaker);
            index += 1;
            keep
        });
        self.speaker -= shift;
    }
}
