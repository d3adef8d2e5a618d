//! Publication of the newest state: odometry, status, prediction, and the records of measurements.

use super::Filter;
use crate::{
    ekf::{
        consider::{CLIMBER_OFFSET, TIME_OFFSET_ERROR},
        state::State,
    },
    health::{
        encoder_trust::UNRESOLVED,
        pose_status::{
            CONTRADICTED_REASON, NEW_REASON, NO_IMU_SAMPLE, PoseState, PoseStatus, StatusTimer,
            UNCONFIRMED_REASON,
        },
        status::Counts,
    },
    measurements::{
        Innovation, Outcome,
        markers::{ImageInnovation, Pixels},
    },
    output::{
        MarkerUpdates, Odometry, Output, Warning,
        continuity::Continuity,
        largest_sigma,
        odometry::{Settings, odometry},
        prediction::{self, Changes},
        smoother::Archive,
        swing,
    },
    timeline::arrival::{JUMP, Source},
};
use rig_model::{PerColor, Stamp};
use std::{borrow::Cow, collections::VecDeque};

/// After a silence of the IMU its samples carry the pose from the next image on, or after this
/// time, s: until then the angular velocity between the last image and the first sample is not
/// known.
const RESUMING: f64 = 0.3;

/// Time for which the IMU must repeat one sample to be of no use, s.
const REPEATS: f64 = 1.0;

/// Without a pose for longer than this a status alone is published, s.
const SILENT: f64 = 0.3;

/// A pose that images have not confirmed is lost where none is used for this time, s.
const NEXT_IMAGE: f64 = 1.0;

/// Outages of the pose and of the IMU.
#[derive(Clone, Debug, Default)]
pub(super) struct Silence {
    /// When the filter last had no pose, until the first odometry after that.
    awaited: Option<Stamp>,
    status_timer: StatusTimer,
    /// That the pose is LOST was reported.
    pose_lost: bool,
    imu_lost: bool,
    /// First IMU sample after it, until an image follows.
    resumed: Option<Stamp>,
}

/// What publication remembers.
#[derive(Clone, Debug, Default)]
pub(super) struct Publisher {
    pub counts: Counts,
    pub continuity: Continuity,
    pub position_sigma: f64,
    changes: Changes,
    /// Newest instant of the inputs, IMU time.
    now: Option<Stamp>,
    last_published: Option<Stamp>,
    /// `now` when it was published: the encoders' clock may be ahead of the IMU's.
    published_now: Option<Stamp>,
    /// IMU time of the newest encoder reading that was used.
    pub(super) last_encoders: Option<Stamp>,
    pub(super) markers_used: u8,
    silence: Silence,
    /// Entries for the smoother.
    pub archive: Archive,
    out: VecDeque<Output>,
}

impl Publisher {
    pub fn new() -> Self {
        let out = VecDeque::with_capacity(256);
        Self { position_sigma: f64::INFINITY, out, ..Self::default() }
    }

    /// Outputs a warning, and counts it.
    pub fn warn(&mut self, warning: Warning) {
        let Counts { inputs, rejected, resets, .. } = &mut self.counts;
        match (&warning, warning.origin()) {
            (Warning::Duplicate { .. }, _) => inputs.duplicates += 1,
            (Warning::NotFinite { .. }, Some(Source::Image)) => rejected.markers += 1,
            (_, Some(Source::Imu)) => rejected.imu += 1,
            (_, Some(Source::Image)) => rejected.images += 1,
            (_, Some(Source::Encoders)) => rejected.climber += 1,
            (Warning::ImuGap { .. }, _) => inputs.imu_gaps += 1,
            (Warning::TimeJump { .. }, _) => resets.time_jumps += 1,
            (Warning::ClockStep { .. }, _) => resets.clock_steps += 1,
            (Warning::Shock { .. }, _) => resets.shocks += 1,
            (Warning::LockOutRecovered { .. }, _) => resets.recoveries += 1,
            (Warning::Diverged { .. }, _) => resets.divergences += 1,
            (Warning::EncoderStep { .. }, _) => resets.encoder_steps += 1,
            (Warning::TimeOffset { .. }, _) => resets.time_offsets += 1,
            _ => {}
        }
        self.out.push_back(Output::Warning(warning));
    }

    /// Takes over what a reset keeps.
    pub fn keep_from(&mut self, former: &mut Publisher) {
        self.counts = former.counts;
        self.archive = std::mem::take(&mut former.archive);
        self.out = std::mem::take(&mut former.out);
    }

    /// Notes that the IMU is silent; true the first time.
    pub fn note_imu_lost(&mut self) -> bool {
        !std::mem::replace(&mut self.silence.imu_lost, true)
    }

    /// Notes the instant of an input, IMU time.
    pub fn note_now(&mut self, at: Stamp) {
        let behind = self.now.filter(|now| (0.0..JUMP).contains(&now.seconds_since(at)));
        self.now = behind.or(Some(at));
    }

    /// Outputs the records of an image that is not processed.
    pub fn skip(&mut self, stamp: Stamp, pixels: &Pixels, outcome: Outcome) {
        let markers = PerColor(pixels.map(|pixel| {
            Innovation::without_values(if pixel.is_some() { outcome } else { Outcome::NotDetected })
        }));
        self.out.push_back(Output::MarkerUpdates(MarkerUpdates { stamp, markers }));
    }

    /// Outputs the records of an image and counts its markers.
    pub fn record(&mut self, stamp: Stamp, record: &ImageInnovation, frozen: bool) {
        let mut markers = PerColor(record.markers);
        for marker in &mut markers.0 {
            match marker.outcome {
                Outcome::Used if frozen => marker.outcome = Outcome::Frozen,
                Outcome::Used => self.counts.used_markers += 1,
                Outcome::Gated | Outcome::Inconsistent => self.counts.gated_markers += 1,
                _ => {}
            }
        }
        self.out.push_back(Output::MarkerUpdates(MarkerUpdates { stamp, markers }));
        if record.used > 0 && !frozen {
            self.markers_used = record.used as u8;
        }
    }
}

impl Filter {
    /// Outputs the estimate at the end of the time line: odometry, status, prediction and swing.
    pub(super) fn publish(&mut self) {
        let (Some(end), true) = (self.arrival.end(), self.is_started()) else { return };
        let without_imu = self.without_imu(end);
        let silent = without_imu.is_some();
        let settings = self.settings(silent);
        let (Some(geometry), Some(entry)) = (&self.setup.geometry, self.history.newest_processed())
        else {
            return;
        };
        if entry.stamp != end || self.publisher.last_published.is_some_and(|last| last >= end) {
            return;
        }
        let (state, reading) = (&entry.state, &entry.reading);
        let image = self.monitor.last_used.map(|image| image.plus_seconds(state.time_offset));
        if self.publisher.silence.imu_lost && !silent {
            let resumed = *self.publisher.silence.resumed.get_or_insert(end);
            let followed = image.is_some_and(|image| image >= resumed);
            if !followed && end.seconds_since(resumed) < RESUMING {
                return;
            }
        }
        let odometry = odometry(end, state, reading, geometry, &settings);
        let estimated = odometry.world_from_volant.translation.vector;
        let continuity = &mut self.publisher.continuity;
        let mut limited =
            if silent { continuity.follow(odometry) } else { continuity.limit(odometry) };
        let behind = limited.world_from_volant.translation.vector - estimated;
        let disagreement = self.trust.disagreement();
        if let Some(disagreement) = &disagreement {
            limited.add_disagreement(disagreement, &state.climber);
        }
        let position_sigma = largest_sigma(&limited.pose_covariance, 0);
        let status = PoseStatus {
            position_sigma,
            rotation_sigma: largest_sigma(&limited.pose_covariance, 3),
            markers_used: self.publisher.markers_used,
            ..PoseStatus::lost(end, self.ages(end), state.time_offset, String::new())
        }
        .judged(&self.setup.status, without_imu, self.unusable(end, state));
        let horizon = self.setup.config.prediction_horizon;
        let earlier = end.plus_seconds(-horizon);
        let earlier = (self.history.place_of(earlier).checked_sub(1))
            .and_then(|place| self.history.get(place))
            .filter(|_| horizon > 0.0 && !silent);
        if let Some(earlier) = earlier {
            self.publisher.changes.add(end, reading, &earlier.reading);
        }
        let predicted = (horizon > 0.0).then(|| {
            let (noise, changes) = (self.process_noise(), &self.publisher.changes);
            let mut predicted = prediction::predicted(
                end, state, reading, horizon, &noise, changes, geometry, &settings,
            );
            predicted.displace(&behind);
            if let Some(disagreement) = &disagreement {
                predicted.add_disagreement(disagreement, &state.climber);
            }
            predicted
        });
        let config = &self.setup.config;
        let swing = self.climber.newest().filter(|_| config.swing).map(|(_, _, rest)| {
            swing::swing(end, state, reading, rest, geometry, &config.pendulum, &settings)
        });
        self.publisher.position_sigma = position_sigma;
        self.publisher.last_published = Some(end);
        self.publisher.published_now = self.publisher.now;
        self.publisher.silence.awaited = None;
        self.publisher.silence.imu_lost &= silent;
        self.publisher.silence.resumed = None;
        let lost = status.state == PoseState::Lost;
        if lost && !self.publisher.silence.pose_lost {
            let reason = status.reason.clone();
            self.publisher.warn(Warning::PoseLost { stamp: end, reason });
        }
        self.publisher.silence.pose_lost = lost;
        self.publisher.out.push_back(Output::Odometry(limited));
        self.publisher.out.push_back(Output::Status(status));
        self.publisher.out.extend(predicted.map(Output::Predicted));
        self.publisher.out.extend(swing.map(Output::Swing));
    }

    /// Returns why the pose at an instant must not be used whatever its sigmas, and its state: the
    /// inputs contradict each other, or it is new.
    fn unusable(&self, at: Stamp, state: &State) -> Option<(PoseState, Cow<'static, str>)> {
        let camera = at.plus_seconds(-state.time_offset);
        let [image_age, ..] = self.ages(at);
        let lost = |reason: Cow<'static, str>| Some((PoseState::Lost, reason));
        if let Some(wrong) = self.trust.directions.wrong() {
            let stamps = self.evidence.wrong[CLIMBER_OFFSET] != 0.0;
            let or = if stamps { ", or their stamps are wrong" } else { "" };
            return lost(format!("images and IMU contradict the encoders: {wrong}{or}").into());
        }
        if self.monitor.is_contradicted(camera) {
            return lost(CONTRADICTED_REASON.into());
        }
        if self.trust.is_unresolved(at) {
            return lost(
                format!(
                    "images and IMU have contradicted the encoders for {UNRESOLVED} s: check \
                     whether an encoder is stuck, and the IMU (`volant check`)"
                )
                .into(),
            );
        }
        if self.monitor.is_new() {
            // A restored pose has had none.
            let due = image_age < NEXT_IMAGE || image_age.is_infinite();
            let state = if due { PoseState::Initializing } else { PoseState::Lost };
            return Some((state, NEW_REASON.into()));
        }
        let coasting = image_age > self.setup.status.max_image_age;
        if coasting && self.monitor.is_unconfirmed() {
            lost(UNCONFIRMED_REASON.into())
        } else {
            None
        }
    }

    /// Returns the outputs that wait to be taken.
    pub fn outputs(&mut self) -> &mut VecDeque<Output> {
        &mut self.publisher.out
    }

    /// Returns the status where it is due while there is no odometry.
    pub fn due_status(&mut self) -> Option<PoseStatus> {
        let now = self.publisher.now?;
        let started = self.is_started();
        if !started {
            self.publisher.silence.awaited = Some(now);
        }
        if started && self.silence(now) < SILENT {
            return None;
        }
        self.publisher.silence.status_timer.is_due(now).then(|| self.pose_status(now))
    }

    /// Returns the status of a filter that outputs no odometry at an instant of IMU time.
    fn pose_status(&self, now: Stamp) -> PoseStatus {
        let time_offset = self.time_offset();
        if !self.is_started() {
            return PoseStatus::initializing(now, time_offset, self.missing());
        }
        let silence = self.silence(now);
        let reason = format!("no usable IMU sample and no image with markers for {silence:.1} s");
        PoseStatus::lost(now, self.ages(now), time_offset, reason)
    }

    /// Returns the time since the newest odometry, or since there was no pose, s.
    fn silence(&self, now: Stamp) -> f64 {
        let last_output = self.publisher.silence.awaited.or(self.publisher.published_now);
        last_output.map_or(f64::INFINITY, |last| now.seconds_since(last))
    }

    /// Ages of the newest used image, IMU sample and used encoder reading at an instant, s.
    fn ages(&self, at: Stamp) -> [f64; 3] {
        let offset = self.time_offset();
        let image = self.monitor.last_used.map(|image| image.plus_seconds(offset));
        let imu = self.arrival.newest_imu().map(|(stamp, _)| stamp);
        let age = |stamp: Stamp| at.seconds_since(stamp).max(0.0);
        [image, imu, self.publisher.last_encoders].map(|stamp| stamp.map_or(f64::INFINITY, age))
    }

    /// Returns the uncertainty of the time offset beside the state's, while it is searched, s.
    pub(super) fn offset_doubt(&self) -> f64 {
        if self.search.is_some() {
            self.start.offset_doubt.unwrap_or(self.setup.config.clock.camera_sigma)
        } else {
            0.0
        }
    }

    /// Returns whether the pose comes from images alone.
    pub(super) fn is_without_imu(&self) -> bool {
        self.arrival.is_imu_silent() || self.imu.integrity.unchanged > REPEATS
    }

    /// Returns why the pose comes from images alone, and for how long it has, s, if it does.
    fn without_imu(&self, end: Stamp) -> Option<(&'static str, f64)> {
        let repeats = self.imu.integrity.unchanged;
        if self.arrival.is_imu_silent() {
            Some((NO_IMU_SAMPLE, self.ages(end)[1]))
        } else {
            (repeats > REPEATS).then_some(("the IMU repeats one sample", repeats))
        }
    }

    fn settings(&self, silent: bool) -> Settings {
        let densities = self.imu.densities(&self.setup.rig.imu);
        let mut calibration = self.setup.calibration;
        // Lasting contradictions mean that the rig's files are wrong by more than their sigmas.
        calibration.scale(self.images.model_error.factor);
        calibration.open(&self.evidence.wrong, &self.setup.rig.markers);
        calibration.variances[TIME_OFFSET_ERROR] = self.offset_doubt().powi(2);
        Settings {
            rate_variance: densities.rate / self.imu.noise.period(),
            gravity: self.setup.config.gravity,
            calibration,
            silent,
        }
    }

    /// Keeps from now on what the smoother needs.
    pub fn keep_archive(&mut self) {
        self.publisher.archive.enable();
    }

    /// Keeps the processed entries at the end of an estimate: those before `until`, if given.
    pub(super) fn archive_until(&mut self, until: Option<Stamp>) {
        for place in 0..self.history.processed() {
            let entry = self.history.get(place);
            self.publisher.archive.add(entry.filter(|e| until.is_none_or(|u| e.stamp < u)));
        }
    }

    /// See [`crate::Fusion::smoothed`].
    pub fn smoothed(&mut self, end: bool) -> Vec<Odometry> {
        if end {
            self.archive_until(None);
        }
        let settings = self.settings(self.arrival.is_imu_silent());
        let gravity = self.setup.config.gravity;
        let Some(geometry) = &self.setup.geometry else { return Vec::new() };
        self.publisher.archive.smoothed(end, gravity, |entry, state| {
            odometry(entry.stamp, state, &entry.reading, geometry, &settings)
        })
    }
}
