//! What an operator does to the filter: put the platform somewhere, keep what is known, and take it up again.

use super::{
    AHEAD, BRIDGED, Tight, start,
    state::{ATTITUDE, Covariance, N, POSITION, State, VELOCITY},
    tie::Prior,
};
use crate::output::{Output, PoseEstimate};
use nalgebra::{Cholesky, Const, Matrix6, Quaternion, UnitQuaternion, Vector3};
use rig_model::Stamp;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use thiserror::Error;

/// Everything that the filter knows at an instant, in plain numbers (SI units; see [`super::state`]).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Checkpoint {
    /// Of this format: 1.
    pub version: u32,
    /// The instant, ns of the inertial unit's clock.
    pub stamp_ns: i64,
    /// Position of the inertial unit, world.
    pub position: [f64; 3],
    /// Its velocity, world.
    pub velocity: [f64; 3],
    /// `world_from_imu`: x, y, z, w.
    pub attitude: [f64; 4],
    /// Accelerometer bias, imu axes.
    pub accelerometer_bias: [f64; 3],
    /// Gyroscope bias, imu axes.
    pub gyroscope_bias: [f64; 3],
    /// x, y, turn of the climber.
    pub climber: [f64; 3],
    /// Their rates.
    pub climber_rate: [f64; 3],
    /// Their accelerations.
    pub climber_acceleration: [f64; 3],
    /// Camera clock offset.
    pub camera_clock: f64,
    /// Climber clock offset against the camera's: mean where it is not 0.
    pub climber_clock: f64,
    /// Its standard deviation.
    pub climber_clock_sigma: f64,
    /// Probability that it is 0.
    pub climber_clock_tied: f64,
    /// Covariance of the error, row by row.
    pub covariance: Vec<f64>,
}

/// Why something cannot be done.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Refusal {
    /// There is no estimate.
    #[error("the filter has not started: there is nothing to keep")]
    NotStarted,
    /// Camera model or inertial samples are missing.
    #[error("no {what} has come yet")]
    Missing {
        /// Which.
        what: &'static str,
    },
    /// The instant is out of reach.
    #[error(
        "the stamp is {away_s:.3} s away from the newest inertial sample; at most {limit_s:.1} s back can be reached"
    )]
    OutOfReach {
        /// How far.
        away_s: f64,
        /// How far it may be.
        limit_s: f64,
    },
    /// Numbers that cannot be.
    #[error("{what} is not usable: {why}")]
    NotUsable {
        /// Which.
        what: &'static str,
        /// Why.
        why: &'static str,
    },
}

impl Checkpoint {
    /// Of a state.
    pub fn of(state: &State, stamp: Stamp) -> Self {
        let q = state.attitude.coords;
        let three = |v: &Vector3<f64>| [v.x, v.y, v.z];
        Self {
            version: 1,
            stamp_ns: stamp.as_nanos(),
            position: three(&state.position),
            velocity: three(&state.velocity),
            attitude: [q.x, q.y, q.z, q.w],
            accelerometer_bias: three(&state.accelerometer_bias),
            gyroscope_bias: three(&state.gyroscope_bias),
            climber: three(&state.climber),
            climber_rate: three(&state.climber_rate),
            climber_acceleration: three(&state.climber_acceleration),
            camera_clock: state.camera_clock,
            climber_clock: 0.0,
            climber_clock_sigma: 0.0,
            climber_clock_tied: 1.0,
            covariance: state.covariance.transpose().as_slice().to_vec(),
        }
    }

    /// The state.
    ///
    /// # Errors
    /// Another version, a number that is not finite, an attitude that is none, a covariance that is none.
    pub fn state(&self) -> Result<State, Refusal> {
        let refuse = |what, why| Err(Refusal::NotUsable { what, why });
        if self.version != 1 {
            return refuse("the checkpoint", "it is of another version");
        }
        let numbers = [&self.position, &self.velocity, &self.accelerometer_bias, &self.gyroscope_bias]
            .into_iter()
            .chain([&self.climber, &self.climber_rate, &self.climber_acceleration])
            .flatten()
            .chain(&self.attitude)
            .chain([&self.camera_clock, &self.climber_clock, &self.climber_clock_sigma])
            .chain([&self.climber_clock_tied])
            .chain(&self.covariance);
        if !numbers.into_iter().all(|x| x.is_finite()) {
            return refuse("the checkpoint", "a number in it is not finite");
        }
        let [x, y, z, w] = self.attitude;
        let attitude = Quaternion::new(w, x, y, z);
        if (attitude.norm() - 1.0).abs() > 1e-3 {
            return refuse("the checkpoint's attitude", "its norm is not 1");
        }
        if self.covariance.len() != N * N {
            return refuse("the checkpoint's covariance", "it has another size");
        }
        if !(0.0..=1.0).contains(&self.climber_clock_tied) || self.climber_clock_sigma < 0.0 {
            return refuse("the checkpoint's climber clock", "a probability or a sigma that cannot be");
        }
        let covariance = Covariance::from_row_slice(&self.covariance);
        let scale = covariance.amax().max(1e-12);
        let asymmetric = (covariance - covariance.transpose()).amax() > 1e-9 * scale;
        let indefinite =
            Cholesky::<f64, Const<N>>::new(covariance + Covariance::identity() * (1e-9 * scale)).is_none();
        if asymmetric || indefinite {
            return refuse("the checkpoint's covariance", "it is not symmetric and positive");
        }
        let mut state = State::zero();
        state.position = self.position.into();
        state.velocity = self.velocity.into();
        state.attitude = UnitQuaternion::from_quaternion(attitude);
        state.accelerometer_bias = self.accelerometer_bias.into();
        state.gyroscope_bias = self.gyroscope_bias.into();
        state.climber = self.climber.into();
        state.climber_rate = self.climber_rate.into();
        state.climber_acceleration = self.climber_acceleration.into();
        state.camera_clock = self.camera_clock;
        state.covariance = (covariance + covariance.transpose()) * 0.5;
        Ok(state)
    }
}

impl Tight {
    /// What is known now.
    ///
    /// # Errors
    /// There is no estimate.
    pub fn checkpoint(&self) -> Result<Checkpoint, Refusal> {
        let node = self.history.run().checked_sub(1).and_then(|p| self.history.get(p));
        match node {
            Some(node) if self.started => {
                let belief = self.belief();
                let (mean, _) = belief.moments();
                let mut state = node.state.clone();
                state.recentre(mean - self.climber_clock, &node.felt, self.config.gravity);
                let mut checkpoint = Checkpoint::of(&state, node.stamp);
                checkpoint.climber_clock = belief.mean;
                checkpoint.climber_clock_sigma = belief.variance.sqrt();
                checkpoint.climber_clock_tied = belief.tied;
                Ok(checkpoint)
            }
            _ => Err(Refusal::NotStarted),
        }
    }

    /// Takes up what was known at `stamp`: all of it where the next inertial sample is near, else clocks and biases, and
    /// the next image gives the pose.
    pub fn restore(&mut self, state: State, stamp: Stamp, prior: Prior) {
        self.restart();
        self.prior = prior;
        self.climber_clock = prior.belief().moments().0;
        self.kept = Some(Box::new(state));
        self.kept_at = Some(stamp);
    }

    /// Begins with a restored state, where it is so fresh that an inertial sample at `stamp` can go on from it.
    pub(super) fn take_up(&mut self, stamp: Stamp, out: &mut VecDeque<Output>) -> bool {
        let Some(at) = self.kept_at.take() else { return false };
        if !(0.0..BRIDGED).contains(&stamp.seconds_since(at)) || self.geometry.is_none() {
            return false;
        }
        let Some(state) = self.kept.take() else { return false };
        self.started = true;
        self.begin(at, *state, out);
        true
    }

    /// Puts the platform at a pose with its covariance (position and rotation about world axes); velocity becomes the
    /// climber's within the usual uncertainty, clocks and biases stay.
    ///
    /// # Errors
    /// No camera model or inertial sample yet, a stamp that the history does not reach, numbers that cannot be.
    pub fn set_pose(&mut self, pose: &PoseEstimate, out: &mut VecDeque<Output>) -> Result<(), Refusal> {
        let Some(geometry) = self.geometry.clone() else {
            return Err(Refusal::Missing { what: "camera_info" });
        };
        let Some((newest, _)) = self.newest_imu else {
            return Err(Refusal::Missing { what: "inertial sample" });
        };
        let symmetric = (pose.covariance + pose.covariance.transpose()) * 0.5;
        let p = &pose.pose;
        let finite = symmetric.iter().chain(p.translation.vector.iter()).chain(p.rotation.coords.iter());
        if !finite.into_iter().all(|x| x.is_finite()) {
            return Err(Refusal::NotUsable { what: "the pose", why: "a number in it is not finite" });
        }
        if symmetric.cholesky().is_none() {
            let why = "its covariance is not positive: say how well the pose is known";
            return Err(Refusal::NotUsable { what: "the pose", why });
        }
        // What somebody says now is ahead of the newest sample by its delay.
        let ahead = pose.stamp.seconds_since(newest);
        let at = if (0.0..AHEAD).contains(&ahead) { newest } else { pose.stamp };
        let away_s = newest.seconds_since(at);
        let limit_s = self.config.history;
        if !(0.0..limit_s).contains(&away_s) {
            return Err(Refusal::OutOfReach { away_s, limit_s });
        }
        let climber = self.climber_at(at).map(|(climber, _)| climber);
        let mut state = match (self.state().cloned(), climber) {
            (Some(state), _) => state,
            (None, Some(climber)) => {
                let mut state = State::zero();
                start::unknown(&mut state, &self.config, &climber);
                state.camera_clock = self.config.camera_clock_offset;
                self.remember(&mut state);
                state
            }
            (None, None) => return Err(Refusal::Missing { what: "climber transform" }),
        };
        let world_from_imu = p * geometry.volant_from_imu;
        state.position = world_from_imu.translation.vector;
        state.attitude = world_from_imu.rotation;
        for first in [POSITION, VELOCITY, ATTITUDE] {
            state.set_variance(first, &Vector3::repeat(self.config.initial_velocity));
        }
        state.velocity = Vector3::new(state.climber_rate.x, state.climber_rate.y, 0.0);
        // Where it is now was said in the world, whatever the climber's clock is.
        for first in [POSITION, VELOCITY, ATTITUDE] {
            state.tie.by_offset.fixed_rows_mut::<3>(first).fill(0.0);
            state.by_pixel.fixed_rows_mut::<3>(first).fill(0.0);
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
        state.unseen = 0.0;
        self.started = true;
        self.begin(at, state, out);
        Ok(())
    }
}
