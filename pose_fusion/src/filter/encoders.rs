//! The responses to encoder readings that contradict the prediction.

use super::{Filter, time_offset::CLIMBER_NEAR};
use crate::{
    ekf::state::{ACCELEROMETER_BIAS, CLIMBER_RATE, GYROSCOPE_BIAS},
    health::{
        contradiction_monitor::SUSPECT,
        encoder_trust::{Cause, EncoderEvidence, Verdict},
    },
    input::climber_track::SPEED,
    measurements::{
        Innovation,
        encoders::{self, CONTRADICTION},
    },
    output::Warning,
    timeline::history::{Entry, Event},
};
use nalgebra::Vector3;
use rig_model::Stamp;

/// A disturbance of the climber began at most this many readings before the one that reveals it.
const DISTURBED_READINGS: usize = 2;
/// An impossible reading withdraws a jerk of the climber that ended at most this long before it, s.
const JERKED: f64 = 0.1;
/// A climber moves where its estimated rate is this many sigma from zero.
const MOVES: f64 = 5.0;

/// Images contradict the prediction for at most this time before an axis stops that is stuck, s.
const CALM: f64 = 0.2;
/// Encoders are suspended that contradict although no reading has been used for this time, s.
const UNUSED: f64 = 0.15;
/// Images and IMU show within this time that a climber drives whose encoders are stuck, s.
const LONGEST_UNSEEN: f64 = 5.0;
/// Standard deviation of axes that are not measured, m and rad.
const UNMEASURED: f64 = 1e3;
/// Errors of their readings within this time are the same, s.
const CORRELATED_FOR: f64 = 0.02;

impl Filter {
    /// Responds to an encoder reading. Returns whether the time line was replaced.
    pub(super) fn on_encoders(
        &mut self,
        place: usize,
        at: Stamp,
        innovation: &Innovation<3>,
        excluded: bool,
        fresh: bool,
    ) -> bool {
        if excluded {
            self.publisher.counts.excluded_readings += u64::from(fresh);
            return fresh
                && self.trust.is_suspended()
                && self.judge_encoders(place, at, innovation);
        }
        if innovation.nis <= CONTRADICTION {
            if fresh {
                self.climber.adapt_jerk(innovation.nis);
            }
            if !self.trust.is_suspended() {
                self.publisher.last_encoders = self.publisher.last_encoders.max(Some(at));
            }
            return false;
        }
        if self.trust.is_suspended() {
            // One that was used with inflated noise, and is processed again.
            self.set_excluded(place, true);
            return false;
        }
        if self.stands_beside(at, innovation) {
            return false;
        }
        let first = self.history.get(0).map_or(at, |first| first.stamp);
        let (since, from) =
            self.history.reading_before(place, DISTURBED_READINGS).unwrap_or((0, first));
        if encoders::is_impossible(innovation, at.seconds_since(from)) {
            self.set_excluded(place, true);
            self.suspend_encoders(place, at, innovation);
            // What a jerk just before it explained was wrong, too.
            if let Some(from) = self.disturbances.forget_climber(at, JERKED) {
                self.exclude_since(from);
            }
        } else if self.disturbances.add_jerk(from, at, innovation) {
            self.climber.adapt_jerk(innovation.nis);
            self.history.rewind(since + 1);
        } else {
            self.set_excluded(place, true);
            let used = self.publisher.last_encoders;
            if used.is_none_or(|used| at.seconds_since(used) > UNUSED) {
                self.suspend_encoders(place, at, innovation);
            }
        }
        false
    }

    /// Suspends encoders of which one has stood beside the estimate of its axis: the images moved
    /// that. Returns whether it does.
    fn stands_beside(&mut self, at: Stamp, innovation: &Innovation<3>) -> bool {
        let read = at.plus_seconds(-self.encoder_offset());
        let mut standing = self.climber.may_have_stuck(read);
        for (i, since) in standing.iter_mut().enumerate() {
            let nis = innovation.residual[i].powi(2) / innovation.covariance[(i, i)];
            *since = since.filter(|_| nis > CONTRADICTION);
        }
        let since = standing.into_iter().flatten().max();
        since.is_some_and(|since| self.suspect_stuck(standing, since, at))
    }

    /// Judges a reading of encoders that are suspended. Returns whether the time line was replaced.
    fn judge_encoders(&mut self, place: usize, at: Stamp, innovation: &Innovation<3>) -> bool {
        self.forget_stuck_readings();
        let timeout = self.setup.config.climber.step_timeout;
        let stands = self.climber.standing();
        let unreported = self.trust.directions.unreported();
        let moves = self.history.get(place).is_some_and(|Entry { state, .. }| {
            let (rates, sigmas) = (state.climber_rate, state.sigmas(CLIMBER_RATE));
            (0..3).any(|i| stands[i] && rates[i].abs() > MOVES * sigmas[i])
        });
        let shown = (0..3).any(|i| stands[i] && unreported[i]);
        let standing = moves || shown || stands == [true; 3] || self.climber.may_be_stuck();
        let read = self.read_at(place).unwrap_or(at);
        let (moves_on, since) = (self.climber.moves_on(read), self.climber.standing_since());
        let suspended = self.trust.suspended_since().unwrap_or(at);
        let earliest = suspended.plus_seconds(-self.encoder_offset() - SUSPECT);
        let axis_stopped = (0..3).any(|i| stands[i] && since[i].is_some_and(|s| s > earliest));
        let seen = EncoderEvidence { standing, axis_stopped, moves, shown, moves_on };
        match self.trust.judge(at, innovation.nis, &innovation.residual, seen, timeout) {
            Verdict::Exclude => {
                let moving = self.climber.moving();
                if moving != [false; 3] {
                    self.use_with_inflated_noise(place, innovation, moving);
                }
                false
            }
            Verdict::Resume => {
                self.climber.clear_stuck();
                self.set_excluded(place, false);
                self.history.rewind(place);
                self.publisher.warn(Warning::EncodersResumed { stamp: at });
                false
            }
            // No image could initialize the pose.
            Verdict::Adopt if self.setup.frozen => false,
            Verdict::Adopt => {
                self.climber.clear_stuck();
                self.publisher.warn(Warning::EncoderStep { stamp: at });
                self.monitor.replaced(at.plus_seconds(-self.time_offset()));
                self.restart();
                self.publisher.continuity.reset();
                true
            }
        }
    }

    /// Uses a reading of suspended encoders that move with a sigma as large as its residual:
    /// readings that are late bound the drift of the climber. Axes that do not move are not used.
    /// All readings within [`CORRELATED_FOR`] count as one.
    fn use_with_inflated_noise(
        &mut self,
        place: usize,
        innovation: &Innovation<3>,
        moving: [bool; 3],
    ) {
        let count = self.climber.readings_in(CORRELATED_FOR);
        let stuck = self.climber.may_be_stuck();
        // Beside an axis that is stuck the others keep their own noise.
        let residuals = Vector3::from_fn(|i, _| {
            let residual = innovation.residual[i].abs();
            let fits = residual * residual <= CONTRADICTION * innovation.covariance[(i, i)];
            if stuck && fits { 0.0 } else { residual }
        });
        if let Some(entry) = self.history.get_mut(place)
            && let Event::Encoders { reading, excluded, .. } = &mut entry.event
        {
            let mut sigmas = residuals;
            (0..3).filter(|i| !moving[*i]).for_each(|i| sigmas[i] = UNMEASURED);
            reading.variance = reading.variance.sup(&(sigmas.component_mul(&sigmas) * count));
            *excluded = false;
        }
        self.history.rewind(place);
    }

    /// Continues without encoders of which one stands, where the images contradict the prediction:
    /// it may be stuck while the climber drives. Returns whether it does.
    pub(super) fn try_without_encoders(&mut self, place: usize) -> bool {
        let Some(Entry { stamp: at, state, .. }) = self.history.get(place) else { return false };
        let (at, rates, sigmas) = (*at, state.climber_rate, state.sigmas(CLIMBER_RATE));
        let read = at.plus_seconds(-self.encoder_offset());
        let (shown, unreported) =
            (self.images.climber_motion.is_shown(), self.trust.directions.unreported());
        let mut standing = self.climber.may_have_stuck(read);
        let stands = self.climber.standing_since();
        for (i, since) in standing.iter_mut().enumerate() {
            *since = match unreported[i] {
                true => stands[i],
                false => since.filter(|_| shown[i] || rates[i].abs() > MOVES * sigmas[i]),
            };
        }
        let Some(since) = standing.into_iter().flatten().max() else { return false };
        let suspected = self.suspect_stuck(standing, since, at);
        if suspected {
            self.trust.note_trial(at);
        }
        suspected
    }

    /// Suspends encoders that may be stuck: `axes` has since when each axis has stood, `since` is
    /// the one from which readings are excluded (encoder time), `at` the instant of the image that
    /// contradicts (IMU time). Returns whether they are suspended: not if they already were, or
    /// were tried without for the same stop.
    pub(super) fn suspect_stuck(
        &mut self,
        axes: [Option<Stamp>; 3],
        since: Stamp,
        at: Stamp,
    ) -> bool {
        let from = since.plus_seconds(self.encoder_offset());
        // What images contradicted before is not the fault of an axis that stopped later.
        let calm = self.images.calm.is_some_and(|calm| since.seconds_since(calm) < CALM);
        // Without the IMU images do not tell the climber's motion from the platform's.
        let suspected = calm && self.trust.may_suspect(from, at) && !self.is_without_imu();
        if suspected {
            self.climber.suspect_stuck(axes);
            if self.history.get(0).is_some_and(|first| first.stamp > from) {
                self.trust.followed = Some(axes);
            }
            self.exclude_since(from);
            // What explained the images until then.
            self.images.model_error = Default::default();
            self.disturbances.forget_shocks(from);
            self.withdraw_doubt(from);
            self.publisher.warn(Warning::EncodersStuck { since });
            // Stuck once the climber certainly moves meanwhile: where the images are at fault, it
            // only drifts.
            self.trust.suspend(at, Cause::Contradiction, false);
        }
        suspected
    }

    /// Forgets what the state has followed of readings that were stuck for longer than the history
    /// is, once images and IMU show that the climber moves: it may have moved on since then, and
    /// the biases have explained that.
    fn forget_stuck_readings(&mut self) {
        if self.trust.directions.unreported() == [false; 3] {
            return;
        }
        let Some(axes) = self.trust.followed.take() else { return };
        let (offset, imu) = (self.encoder_offset(), &self.setup.config.imu);
        let biases =
            [(ACCELEROMETER_BIAS, imu.accelerometer_bias), (GYROSCOPE_BIAS, imu.gyroscope_bias)];
        let Some(first) = self.history.get_mut(0) else { return };
        for (i, since) in axes.into_iter().enumerate() {
            if let Some(since) = since {
                let stood = first.stamp.seconds_since(since.plus_seconds(offset));
                let error = SPEED[i] * stood.clamp(0.0, LONGEST_UNSEEN);
                first.state.loosen_climber(i, error, SPEED[i]);
            }
        }
        for (bias, sigma) in biases {
            for i in bias..bias + 3 {
                first.state.covariance[(i, i)] += sigma * sigma;
            }
        }
        self.history.rewind(0);
    }

    /// Compares the directions of the encoders with what images and IMU show of the climber, at the
    /// place of an image.
    pub(super) fn compare_directions(&mut self, place: usize, image: Stamp) {
        let climber = self.climber_at(image).filter(|climber| climber.distance <= CLIMBER_NEAR);
        match climber.filter(|_| !self.arrival.is_imu_silent()) {
            Some(climber) => self.trust.directions.add(&self.history, place, &climber.values),
            None => self.trust.directions.interrupt(),
        }
    }

    /// Returns the offset to place an encoder reading on the IMU's time line with, s.
    pub(super) fn encoder_offset(&self) -> f64 {
        self.time_offset() + self.setup.config.clock.climber_offset
    }

    fn set_excluded(&mut self, place: usize, exclude: bool) {
        if let Some(entry) = self.history.get_mut(place)
            && let Event::Encoders { excluded, .. } = &mut entry.event
        {
            self.publisher.counts.excluded_readings += u64::from(exclude && !*excluded);
            *excluded = exclude;
        }
    }

    /// Returns the stamp of the encoder reading at a place, whose time offset may be an older one.
    fn read_at(&self, place: usize) -> Option<Stamp> {
        let entry = self.history.get(place)?;
        let Event::Encoders { reading, .. } = &entry.event else { return None };
        Some(entry.stamp.plus_seconds(-reading.time_offset))
    }

    fn suspend_encoders(&mut self, place: usize, at: Stamp, innovation: &Innovation<3>) {
        if !self.trust.is_suspended() {
            let distance_m = innovation.residual.xy().norm();
            let turn_rad = innovation.residual.z.abs();
            self.publisher.warn(Warning::EncodersSuspended { stamp: at, distance_m, turn_rad });
        }
        let read = self.read_at(place).unwrap_or(at);
        let returns = self.climber.moves_on(read);
        let leaps = returns || self.climber.leaps_near(read);
        let cause = if leaps { Cause::Leap } else { Cause::Contradiction };
        self.trust.suspend(at, cause, returns);
    }

    /// Excludes the readings from an instant of the IMU's time line on, and processes it again.
    pub(super) fn exclude_since(&mut self, from: Stamp) {
        let first = self.history.place_of(from);
        for place in first..self.history.len() {
            self.set_excluded(place, true);
        }
        self.history.rewind(first);
    }
}
