//! Requests of an operator: save and restore what is known, put the platform at a pose.

use super::Filter;
use crate::{
    ekf::state::{ATTITUDE, POSITION, State, TIME_OFFSET, VELOCITY},
    health::sanity,
    initialization::{
        checkpoint::{Checkpoint, Refusal},
        from_image::{self, INITIAL_VELOCITY},
    },
    output::PoseEstimate,
    timeline::arrival::AHEAD,
};
use nalgebra::{Matrix6, Vector3};
use rig_model::{Stamp, topics};

/// A restored time offset that is better known than this needs no search, s.
const RESTORED_OFFSET_KNOWN: f64 = 5e-3;

impl Filter {
    /// See [`crate::Fusion::checkpoint`].
    pub fn checkpoint(&self) -> Result<Checkpoint, Refusal> {
        let newest = self.history.newest_processed().ok_or(Refusal::NotInitialized)?;
        Ok(Checkpoint::of(&newest.state, newest.stamp))
    }

    /// See [`crate::Fusion::restore`]; a state beyond physical bounds is refused, too.
    pub fn restore(&mut self, checkpoint: &Checkpoint) -> Result<(), Refusal> {
        let state = checkpoint.state()?;
        self.check("the checkpoint", &state)?;
        self.restart();
        self.publisher.continuity.reset();
        let known = state.sigma(TIME_OFFSET) < RESTORED_OFFSET_KNOWN;
        self.search = super::search(&self.setup.config).filter(|_| !known);
        (self.start.offset_doubt, self.start.searches_again) = (None, false);
        self.start.kept = Some(Box::new(state));
        self.start.kept_at = Some(Stamp::from_nanos(checkpoint.stamp_ns));
        Ok(())
    }

    /// Refuses a state beyond physical bounds, with which the filter would reinitialize at once.
    fn check(&self, what: &'static str, state: &State) -> Result<(), Refusal> {
        match sanity::violation(state, &self.setup.config, self.setup.camera_offset) {
            Some(why) => Err(Refusal::Invalid { what, why }),
            None => Ok(()),
        }
    }

    /// Puts the platform at a pose with its covariance (position and rotation about world axes).
    /// Its velocity becomes the climber's within `INITIAL_VELOCITY`; time offset and biases stay.
    ///
    /// # Errors
    /// No camera model, IMU sample or encoder reading yet; a stamp that the history does not reach;
    /// invalid numbers; a pose beyond physical bounds. Nothing is changed then.
    pub fn set_pose(&mut self, pose: &PoseEstimate) -> Result<(), Refusal> {
        let missing = |what| Refusal::Missing { what };
        let geometry = self.setup.geometry.clone().ok_or(missing(topics::CAMERA_INFO))?;
        let (newest, _) = self.arrival.newest_imu().ok_or(missing(topics::IMU))?;
        let symmetric = (pose.covariance + pose.covariance.transpose()) * 0.5;
        let p = &pose.pose;
        let numbers =
            symmetric.iter().chain(p.translation.vector.iter()).chain(p.rotation.coords.iter());
        if !numbers.into_iter().all(|x| x.is_finite()) {
            return Err(Refusal::Invalid { what: "the pose", why: "a number in it is not finite" });
        }
        if symmetric.cholesky().is_none() {
            let why = "its covariance is not positive: give the uncertainty of the pose";
            return Err(Refusal::Invalid { what: "the pose", why });
        }
        // A pose given now is ahead of the newest sample by that sample's latency.
        let ahead = pose.stamp.seconds_since(newest);
        let at = if (0.0..AHEAD).contains(&ahead) { newest } else { pose.stamp };
        let away_s = newest.seconds_since(at);
        let limit_s = self.setup.config.history;
        if !(0.0..limit_s).contains(&away_s) {
            return Err(Refusal::OutOfReach { away_s, limit_s });
        }
        let read = at.plus_seconds(-self.encoder_offset());
        let before = self.history.place_of(at).min(self.history.processed()).checked_sub(1);
        let before = before.and_then(|place| self.history.get(place));
        let initialized = before.is_some();
        let mut state = match (before, self.climber.at(read)) {
            (Some(entry), _) => {
                let mut state = entry.state.clone();
                state.climber += state.climber_rate * at.seconds_since(entry.stamp);
                state
            }
            (None, Some(climber)) => {
                let mut state = from_image::unknown(&self.setup.config, &climber);
                state.time_offset = self.time_offset();
                state.calibration = self.calibration();
                state
            }
            (None, None) => return Err(missing(topics::CLIMBER_TRANSFORM)),
        };
        let world_from_imu = p * geometry.volant_from_imu;
        state.position = world_from_imu.translation.vector;
        state.attitude = world_from_imu.rotation;
        for first in [POSITION, VELOCITY, ATTITUDE] {
            state.set_sigmas(first, &INITIAL_VELOCITY.into());
        }
        state.velocity = Vector3::new(state.climber_rate.x, state.climber_rate.y, 0.0);
        self.check("the pose", &state)?;
        if !initialized {
            self.remember(&mut state);
        }
        // δp_imu = δp − [R t]× δθ.
        let lever = p.rotation * geometry.volant_from_imu.translation.vector;
        let mut by = Matrix6::identity();
        by.fixed_view_mut::<3, 3>(0, 3).copy_from(&-lever.cross_matrix());
        let spread = by * symmetric * by.transpose();
        for (a, i) in [POSITION, ATTITUDE].into_iter().enumerate() {
            for (b, j) in [POSITION, ATTITUDE].into_iter().enumerate() {
                let block = spread.fixed_view::<3, 3>(3 * a, 3 * b);
                state.covariance.fixed_view_mut::<3, 3>(i, j).copy_from(&block);
            }
        }
        self.publisher.continuity.reset();
        self.set_state(at, state);
        Ok(())
    }
}
