//! Processing of the time line, and the responses to images that contradict the prediction.

use super::Filter;
use crate::{
    adaptation::{
        disturbances::CLIMBER_SETTLING,
        innovation_scale::{CONTRADICTION_GROWTH, MODEL_ERROR, PIXEL_NOISE},
    },
    ekf::{
        propagation::{Motion, ProcessNoise},
        state::{ATTITUDE, TIME_OFFSET, VELOCITY},
    },
    health::{
        contradiction_monitor::{Response, SUSPECT},
        sanity,
    },
    initialization::from_image,
    input::climber_track::JERK_LIMIT,
    measurements::{
        Outcome,
        markers::{ATTITUDE_KNOWN, Image, ImageInnovation},
    },
    output::Warning,
    timeline::{
        history::{Entry, Event},
        repropagation::{self, Context, Step},
    },
};
use nalgebra::{Vector2, Vector3};
use rig_model::Stamp;

/// NIS of four markers (8 degrees of freedom) above which the platform was struck: where all passed
/// the gates (0.999 quantile), and where some did not (0.9999 quantile).
const SHOCK_NIS: f64 = 26.12;
const SHOCK_NIS_GATED: f64 = 31.83;
/// Images that follow each other faster show a shock by two of them, s.
const SHORT: f64 = 0.02;
/// Largest factor of the model error with which a gated image means a shock.
const SUDDEN: f64 = 1.5;
/// Factor above which images contradict the prediction: a shock leaves 3.
const UNCALM: f64 = 6.0;
/// Factor on the images that must contradict where their markers may disagree with each other.
const DISAGREEING: u32 = 3;
/// Share of a residual that a shock explains by rotation, which the IMU measures better.
const ROTATION_SHARE: f64 = 0.3;
/// Largest distance (m) and angle (rad) of a shock; markers that contradict by more are false.
const LARGEST_SHOCK: (f64, f64) = (0.2, 0.1);
/// Density of the angular velocity's process noise, (rad/s)²/Hz, above which the IMU does not
/// propagate the attitude from one image to the next: a gap of 0.15 s, invalid samples, a shock.
const UNCARRIED: f64 = 0.01;
/// A time offset that is known worse than this explains a contradiction as well as a shock does, s,
/// where the velocity is known to this, m/s.
pub(super) const OFFSET_DOUBTED: f64 = 0.01;
const VELOCITY_KNOWN: f64 = 0.1;
/// Longest time that the IMU carries the state past such images, s; an alignment takes 0.2 s.
const CARRIED: f64 = 0.25;
/// Random walk of the camera time offset, s/√s: clocks that drift apart by up to 200 ppm.
const OFFSET_WALK: f64 = 1e-4;
/// Images that contradict for longer without encoder readings are a shock, s.
const UNREAD: f64 = 1.0;
/// Time after the initialization before errors of the rig file, rope, shocks and the stricter count
/// of contradicting images are judged, s.
const SETTLED: f64 = 2.0;

impl Filter {
    /// Processes everything on the time line up to its end.
    pub(super) fn process(&mut self) {
        if !self.is_started() {
            return;
        }
        let Some(end) = self.arrival.end() else { return };
        while let Some((place, step)) = self.step(end) {
            let Some(entry) = self.history.get_mut(place) else { return };
            let at = entry.stamp;
            if let Some(what) =
                sanity::violation(&entry.state, &self.setup.config, self.setup.camera_offset)
            {
                self.publisher.warn(Warning::Diverged { stamp: at, what });
                self.monitor.replaced(at.plus_seconds(-self.setup.camera_offset));
                return self.reset_estimate();
            }
            let done = match (step, &mut entry.event) {
                (Step::Encoders(innovation), Event::Encoders { excluded, fresh, .. }) => {
                    let (excluded, fresh) = (*excluded, std::mem::take(fresh));
                    self.on_encoders(place, at, &innovation, excluded, fresh)
                }
                (Step::Image(record, smoothing), Event::Image { image, stamp, fresh, .. }) => {
                    let (image, stamp) = (*image, *stamp);
                    if std::mem::take(fresh) {
                        self.history.smoothing = smoothing;
                        self.on_image(place, stamp, &image, &record)
                    } else {
                        self.images.shake.corrected(stamp, &record);
                        false
                    }
                }
                _ => false,
            };
            if done {
                return;
            }
        }
    }

    fn step(&mut self, end: Stamp) -> Option<(usize, Step)> {
        let config = &self.setup.config;
        let geometry = self.setup.geometry.as_ref()?;
        let rope = self.images.rope.rope(&config.pendulum, geometry);
        let context = Context {
            config,
            geometry,
            noise: self.process_noise(),
            disturbances: &self.disturbances,
            rope: rope.zip(self.climber.newest().map(|(_, _, rest)| *rest)),
            noise_of_changes: self.imu.noise.noise_of_changes(self.history.smoothing),
            imu_period: self.imu.noise.period(),
        };
        repropagation::step(&mut self.history, &context, end)
    }

    /// Returns for how long encoder readings that were due at an instant of the time line are
    /// missing, s.
    fn encoders_missing_for(&self, at: Stamp) -> Option<f64> {
        self.climber.missing_for(at.plus_seconds(-self.encoder_offset()))
    }

    /// Returns the variance of the error that the markers of an image share, x and y of the image,
    /// px²: the shake that is found, and the declared tilt of the camera.
    pub(super) fn shake_variance(&self) -> Vector2<f64> {
        let focal = self.setup.geometry.as_ref().map(|g| g.camera.focal_lengths());
        let tilt = focal.unwrap_or_default() * self.setup.config.markers.camera_tilt;
        self.images.shake.variance().sup(&tilt.component_mul(&tilt))
    }

    /// Process noise apart from the IMU's, which comes with each sample.
    pub(super) fn process_noise(&self) -> ProcessNoise {
        let c = &self.setup.config;
        let next = self.history.get(self.history.processed()).map(|entry| entry.stamp);
        let at = next.or(self.arrival.end());
        let missing = at.and_then(|at| self.encoders_missing_for(at)).is_some();
        let free = self.trust.is_suspended() || missing;
        let factor = if free { JERK_LIMIT } else { self.climber.jerk_factor };
        let densities = self.imu.densities(&self.setup.rig.imu);
        ProcessNoise {
            force: densities.force,
            rate: densities.rate,
            accelerometer_bias: c.imu.accelerometer_bias_walk.powi(2),
            gyroscope_bias: c.imu.gyroscope_bias_walk.powi(2),
            jerk: Vector3::new(c.climber.jerk, c.climber.jerk, c.climber.turn_jerk) * factor,
            time_offset: if c.clock.camera_sigma > 0.0 { OFFSET_WALK.powi(2) } else { 0.0 },
            change: Motion::default(),
        }
    }

    /// Responds to a new image. Returns whether the time line was replaced.
    fn on_image(
        &mut self,
        place: usize,
        stamp: Stamp,
        image: &Image,
        record: &ImageInnovation,
    ) -> bool {
        self.publisher.record(stamp, record, self.setup.frozen);
        if self.setup.frozen {
            return false;
        }
        self.images.shake.add(stamp, record);
        if self.images.model_error.factor <= UNCALM {
            self.images.calm = self.images.calm.max(Some(stamp));
        }
        if record.used >= 3 {
            self.compare_directions(place, stamp);
        }
        let (Some(entry), Some(geometry)) = (self.history.get(place), &self.setup.geometry) else {
            return false;
        };
        if entry.noise.rate > UNCARRIED && from_image::is_mirrored(geometry, &entry.state, image) {
            return self.reinitialize(stamp, image, stamp, false);
        }
        let at = entry.stamp;
        // While the time offset is unknown, it contradicts a platform that sets off; the IMU
        // carries a state that it knows well until the offset is found.
        let carried = self.monitor.last_used.is_some_and(|l| stamp.seconds_since(l) < CARRIED);
        let moves_off = carried
            && !self.start.searches_again
            && self.offset_doubt() > OFFSET_DOUBTED
            && entry.state.sigmas(VELOCITY).max() < VELOCITY_KNOWN;
        // A single marker may be false: it contradicts only an attitude that is not known.
        let seen = match image.detected() {
            1 if entry.state.sigmas(ATTITUDE).max() < ATTITUDE_KNOWN => record.used as usize,
            detected => detected,
        };
        // Without readings the climber may have moved, which is no shock of the platform; later its
        // covariance explains that.
        let missing = self.encoders_missing_for(at).is_some_and(|age| age < UNREAD);
        let excused =
            self.disturbances.is_climber_disturbed(at, CLIMBER_SETTLING) || moves_off || missing;
        let settled = self.monitor.initialized_at.is_some_and(|i| stamp.seconds_since(i) > SETTLED);
        // Early stamps look like missing readings: those are no excuse here.
        if record.used >= 3 && settled && !self.trust.is_suspended() && !self.is_without_imu() {
            self.evidence.add(stamp, &record.evidence);
        }
        if record.used >= 3 && !excused && settled {
            let c = &self.setup.config;
            self.images.rope.compare(
                &c.pendulum,
                geometry,
                &entry.state,
                &entry.reading,
                &image.rest,
                c.gravity,
            );
        }
        let last_used = self.monitor.last_used;
        let limit = self.setup.config.markers.lock_out_images;
        let agrees = record.agrees_with_itself() && self.images.agreed_before();
        // Encoders that just jumped may be what the image contradicts, and a shock
        // breaks a prediction that held until then: a marker that has been beside its prediction
        // is itself what is wrong.
        let rejected = record
            .markers
            .map(|marker| matches!(marker.outcome, Outcome::Gated | Outcome::Inconsistent));
        let rejects = self.monitor.rejects(rejected);
        let sudden = rejects
            && !self.disturbances.is_climber_disturbed(at, SUSPECT)
            && self.images.model_error.factor <= SUDDEN;
        let is_shock = match record.used {
            4 => record.nis > SHOCK_NIS,
            _ => record.against_prediction.is_some_and(|nis| nis > SHOCK_NIS_GATED) && sudden,
        };
        // Within a short interval the velocity that moves the markers so far is so large that false
        // markers are likelier; the next image confirms or refutes it.
        let short = last_used.is_some_and(|last| stamp.seconds_since(last) < SHORT);
        let before = last_used.unwrap_or(stamp);
        let confirmed = self.monitor.note_shock(is_shock, before);
        let since = if short { confirmed } else { Some(before) };
        if let Some(since) = since.filter(|_| is_shock && agrees && !excused && settled) {
            let read = at.plus_seconds(-self.encoder_offset());
            let [.., turn] = self.climber.may_have_stuck(read);
            let turn = turn.filter(|_| record.with_free_climber[2] < SHOCK_NIS);
            if let Some(stood) = turn
                && self.offset_doubt() <= OFFSET_DOUBTED
                && self.suspect_stuck([None, None, turn], stood, at)
            {
                return false;
            }
            self.add_shock_noise(place, since, record);
        }
        if let Some(misfit) = &record.misfit {
            if self.setup.config.calibration.marker > 0.0 {
                self.images.layout.add(&misfit.offsets);
            }
            self.images.add_misfit(&misfit.whitened, record.used < 4);
        }
        let internal = match (&record.misfit, record.used) {
            (Some(misfit), 4) => Some(misfit.squared()),
            // A pose explains whatever three markers show.
            (None, 3) => Some(0.0),
            _ => None,
        };
        // Images alone follow a swing roughly.
        let unpredicted = excused || self.arrival.is_imu_silent();
        if let (Some(internal), false) = (internal, unpredicted) {
            self.images.climber_motion.add(&record.evidence, self.climber.standing());
            let grows = self.images.model_error.add(record.nis - internal, &MODEL_ERROR);
            if self.search.is_none() && self.try_without_encoders(place) {
                return false;
            }
            if self.images.model_error.factor > SUDDEN {
                self.search_again(agrees && grows);
            }
        }
        let limit = if agrees || !settled { limit } else { DISAGREEING * limit };
        let response = self.monitor.note(stamp, seen, record.used, limit, excused);
        if response != Response::None && self.trust.restore_after_contradiction(at) {
            self.climber.clear_stuck();
            self.publisher.warn(Warning::EncodersResumed { stamp: at });
            self.monitor.responded(stamp);
            return self.reinitialize(stamp, image, stamp, true);
        }
        // Markers that contradict each other as well are noisier than they claim.
        if let (Response::FollowImages(_), Some(misfit), false) =
            (response, &record.misfit, record.agrees_with_itself())
        {
            self.images.pixel_noise.raise(misfit.noise_factor(), &PIXEL_NOISE);
            self.monitor.clear();
            return false;
        }
        match response {
            Response::None => false,
            Response::FollowImages(since) => {
                self.monitor.responded(stamp);
                self.follow_images(place, stamp, image, record, (last_used.unwrap_or(since), since))
            }
            Response::Reinitialize(since) => {
                self.monitor.responded(stamp);
                self.reinitialize(stamp, image, since, true)
            }
        }
    }

    /// Follows images that contradict the prediction, given the newest image that was used before
    /// this one and the first that contradicted. Returns whether the time line was replaced.
    fn follow_images(
        &mut self,
        place: usize,
        stamp: Stamp,
        image: &Image,
        record: &ImageInnovation,
        (last_used, since): (Stamp, Stamp),
    ) -> bool {
        let Some(entry) = self.history.get(place) else { return false };
        let at = entry.stamp;
        let repeated = self.monitor.note_followed(stamp);
        self.search_again(record.agrees_with_itself());
        self.images.model_error.raise(CONTRADICTION_GROWTH, &MODEL_ERROR);
        // An encoder that stopped while the images see the climber drive on is stuck, unless the
        // time offset is what they contradict.
        let known = self.offset_doubt() <= OFFSET_DOUBTED;
        let earliest = at.plus_seconds(-self.encoder_offset() - SUSPECT);
        let explaining = self.standing_that_explain(record);
        let mut stopped = self.climber.stopped_since();
        for (stopped, explains) in stopped.iter_mut().zip(explaining) {
            *stopped = stopped.filter(|since| known && *since > earliest).or(explains);
        }
        if let Some(since) = stopped.into_iter().flatten().min()
            && self.suspect_stuck(stopped, since, at)
        {
            return false;
        }
        if repeated {
            return self.reinitialize(stamp, image, since, true);
        }
        self.add_shock_noise(place, last_used, record);
        self.publisher.warn(Warning::Shock { since, stamp });
        false
    }

    /// Returns since when each axis of the climber has stood whose motion alone explains an image,
    /// while another axis moves: its encoder may be stuck.
    fn standing_that_explain(&self, record: &ImageInnovation) -> [Option<Stamp>; 3] {
        let (standing, since) = (self.climber.standing(), self.climber.standing_since());
        let known = self.offset_doubt() <= OFFSET_DOUBTED && standing != [true; 3];
        std::array::from_fn(|i| {
            let explains = known && standing[i] && record.with_free_climber[i] < SHOCK_NIS;
            since[i].filter(|_| explains)
        })
    }

    /// Re-propagates since the last used image with the noise of a shock that explains residuals.
    fn add_shock_noise(&mut self, place: usize, last_used: Stamp, record: &ImageInnovation) {
        let Some(entry) = self.history.get(place) else { return };
        let (at, from) = (entry.stamp, last_used.plus_seconds(entry.state.time_offset));
        if self.disturbances.has_shock(at) || from >= at {
            return;
        }
        let (distance, angle) = self.shock_size(entry, record);
        self.disturbances.add_shock(from, at, distance, angle);
        let first = self.history.place_of(from);
        self.history.rewind(first);
    }

    /// Returns distance (m) and angle (rad) of a shock that explains the markers' residuals.
    fn shock_size(&self, entry: &Entry, record: &ImageInnovation) -> (f64, f64) {
        let Some(geometry) = &self.setup.geometry else { return (0.1, 0.1) };
        let measured = record
            .markers
            .iter()
            .filter(|m| !matches!(m.outcome, Outcome::NotDetected | Outcome::NotPredictable));
        let residual = measured.map(|m| m.residual.norm()).fold(0.0, f64::max);
        let height = match self.climber.newest() {
            Some((_, _, rest)) => (rest.height - entry.state.position.z).abs(),
            None => 1.0,
        };
        let distance = (residual * height / geometry.camera.focal_lengths().x).min(LARGEST_SHOCK.0);
        let centers = geometry.markers.centers.iter();
        let radius = centers.map(|(_, c)| c.coords.xy().norm()).fold(0.05, f64::max);
        (distance, (ROTATION_SHARE * distance / radius).min(LARGEST_SHOCK.1))
    }

    /// Returns the camera time offset to place an image with, s.
    pub(super) fn time_offset(&self) -> f64 {
        let known = self.state().or(self.start.kept.as_deref());
        match (known, self.start.time_offset) {
            (Some(state), _) => state.time_offset,
            (None, Some(found)) => found.offset,
            (None, None) => self.setup.camera_offset,
        }
    }

    /// Returns the standard deviation of the camera time offset, s.
    pub(super) fn time_offset_sigma(&self) -> Option<f64> {
        self.state().map(|state| state.sigma(TIME_OFFSET))
    }
}
