//! IMU samples: checked, with the process noise of the step to each, and what the IMU knows of
//! "up".

use crate::{
    adaptation::{
        imu_integrity::ImuIntegrity,
        imu_noise::{Densities, ImuNoise},
        stationary::Stationary,
    },
    ekf::propagation::ImuReading,
    input::imu_stamps::ImuStamps,
    timeline::{
        clock_step::ClockSteps,
        history::{Entry, Event, History},
    },
};
use nalgebra::{UnitQuaternion, Vector3};
use rig_model::{ImuMounting, ImuSample, Stamp};
use std::collections::VecDeque;

/// Attitudes are kept for the longest history with its delays, s, …
const KEPT: f64 = 1.5;
/// … at most one in this time, s: they change slowly against their error.
const SPACING: f64 = 0.01;
/// An attitude further from an instant does not serve it, s.
const ATTITUDE_NEAR: f64 = 0.1;
/// Tilt that a swing hides from the accelerometer, rad (1 sigma).
pub const SWING_TILT: f64 = 0.15;
/// The mean specific force over this time around an instant points up but for that, s.
const FORCE_AVERAGED: f64 = 0.3;
/// Its upward part in units of gravity: a swing of 60 degrees is within.
const GRAVITY: std::ops::Range<f64> = 0.5..2.0;

/// What is known of "up".
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Up {
    /// World's up in IMU axes, unit vector.
    pub in_imu: Vector3<f64>,
    /// Its uncertainty about each horizontal axis, rad.
    pub sigma: f64,
    /// It is the mean specific force: in a swing, the direction of the rope.
    pub is_specific_force: bool,
}

impl Up {
    /// Returns the world's direction that it measures, unit vector: of a specific force half way
    /// between up (a platform that is carried) and `rope` (one that hangs), the vector from the
    /// platform to the climber's attachment, world.
    pub fn in_world(&self, rope: &Vector3<f64>) -> Vector3<f64> {
        let up = Vector3::z();
        match rope.try_normalize(0.1) {
            Some(rope) if self.is_specific_force && rope.z > 0.0 => (up + rope).normalize(),
            _ => up,
        }
    }
}

/// The IMU's own directions of "up" by their instants.
#[derive(Clone, Debug, Default)]
pub struct VerticalReferences(VecDeque<(Stamp, Up)>);

impl VerticalReferences {
    /// Adds that of a sample that has a usable attitude, with a sigma of at least `floor` rad.
    pub fn add(&mut self, sample: &ImuSample, floor: f64) {
        let Some(up) = up_of(sample, floor) else { return };
        let since = |(at, _): &(Stamp, Up)| sample.stamp.seconds_since(*at);
        if self.0.back().is_some_and(|last| (0.0..SPACING).contains(&since(last))) {
            return;
        }
        while self.0.front().is_some_and(|first| !(0.0..KEPT).contains(&since(first))) {
            self.0.pop_front();
        }
        self.0.push_back((sample.stamp, up));
    }

    /// Returns the one nearest to an instant, within 0.1 s.
    pub fn at(&self, stamp: Stamp) -> Option<Up> {
        let distance = |s: &Stamp| (s.as_nanos() - stamp.as_nanos()).unsigned_abs();
        let (at, up) = self.0.iter().min_by_key(|(s, _)| distance(s))?;
        (at.seconds_since(stamp).abs() < ATTITUDE_NEAR).then_some(*up)
    }
}

/// State of the IMU input.
#[derive(Clone, Debug, Default)]
pub struct ImuInput {
    /// Stamps with which samples count.
    pub stamps: ImuStamps,
    /// Steps of the IMU's clock against that of camera and encoders.
    pub clocks: ClockSteps,
    /// Whether samples are sound.
    pub integrity: ImuIntegrity,
    /// Noise of the samples.
    pub noise: ImuNoise,
    stationary: Stationary,
    /// The IMU's own directions of "up".
    pub verticals: VerticalReferences,
    ignores_attitude: bool,
    /// The noise was known at some time.
    known: bool,
}

impl ImuInput {
    /// Discards what was identified with stamps of which it is now known that they were wrong.
    pub fn keep_stamps_only(&mut self) {
        let (stamps, clocks) = (std::mem::take(&mut self.stamps), std::mem::take(&mut self.clocks));
        *self = Self { stamps, clocks, ..Self::default() };
    }

    /// Returns the event of a reading `dt` seconds after the previous one (`None`: the first).
    /// `model_error` is the factor on the sigma of its scale factors.
    pub fn event(
        &mut self,
        reading: &ImuReading,
        dt: Option<f64>,
        mounting: &ImuMounting,
        model_error: f64,
    ) -> Event {
        let given = given(mounting);
        self.noise.add(reading, dt.unwrap_or(0.0));
        let noise = self.noise.densities(&given);
        let Some(dt) = dt else {
            return Event::Imu { noise, doubt: Densities::default(), at_rest: None };
        };
        let period = self.noise.period();
        let found = self.noise.sample_variances();
        let variances = found.zip(&given, |found, given| found.max(given / period));
        let at_rest = self.stationary.add(reading, dt, &variances);
        let nonlinear = self.integrity.nonlinearity(reading, dt);
        let more = self.integrity.additional(reading, dt, &variances);
        let doubt = nonlinear.map(|density| density * (model_error.powi(2) - 1.0));
        let noise =
            [nonlinear, more, doubt].iter().fold(noise, |sum, part| sum.zip(part, |a, b| a + b));
        Event::Imu { noise, doubt, at_rest }
    }

    /// Ignores the IMU's own attitude from now on.
    pub fn ignore_attitude(&mut self) {
        self.ignores_attitude = true;
        self.verticals = VerticalReferences::default();
    }

    /// Remembers the IMU's own attitude, where the sample has a usable one.
    pub fn remember_attitude(&mut self, sample: &ImuSample, floor: f64) {
        if !self.ignores_attitude {
            self.verticals.add(sample, floor);
        }
    }

    /// Returns by how much the noise exceeds the rig file's, once, when it becomes known: the
    /// samples before were weighed with the rig file's.
    pub fn newly_known_noise(&mut self, mounting: &ImuMounting) -> Option<Densities> {
        if self.known || !self.noise.is_known() {
            return None;
        }
        self.known = true;
        let more = self.densities(mounting).zip(&given(mounting), |now, given| now - given);
        (more.force > 0.0 || more.rate > 0.0).then_some(more)
    }

    /// Discards what a gap interrupts.
    pub fn interrupt(&mut self) {
        self.stationary = Stationary::default();
        self.integrity.clear();
    }

    /// Returns the densities identified now, those of the rig file at least.
    pub fn densities(&self, mounting: &ImuMounting) -> Densities {
        self.noise.densities(&given(mounting))
    }

    /// Returns the mean direction of the specific force around an instant.
    pub fn force_up_at(&self, stamp: Stamp, history: &History) -> Option<Up> {
        mean_force(stamp, history)?.try_normalize(1e-3).map(|in_imu| Up {
            in_imu,
            sigma: SWING_TILT,
            is_specific_force: true,
        })
    }

    /// Returns the upward part (by its magnitude, without an attitude of the IMU) of the mean
    /// specific force around an instant, m/s², where it is not that of `gravity`: of samples in g,
    /// negated ones, ones without gravity.
    pub fn wrong_gravity(&self, stamp: Stamp, history: &History, gravity: f64) -> Option<f64> {
        let force = mean_force(stamp, history)?;
        let upward = match self.verticals.at(stamp) {
            Some(up) => force.dot(&up.in_imu),
            None => force.norm(),
        };
        (!GRAVITY.contains(&(upward / gravity))).then_some(upward)
    }
}

/// Mean specific force around an instant, IMU axes, m/s².
fn mean_force(stamp: Stamp, history: &History) -> Option<Vector3<f64>> {
    let is_near = |entry: &Entry| entry.stamp.seconds_since(stamp).abs() < FORCE_AVERAGED;
    let near = history.iter().filter(|entry| entry.is_imu() && is_near(entry));
    let (count, sum) = near.fold((0.0, Vector3::zeros()), |(count, sum), entry| {
        (count + 1.0, sum + entry.reading.specific_force)
    });
    (count > 0.0).then(|| sum / count)
}

/// Returns the noise densities of the rig file.
pub fn given(mounting: &ImuMounting) -> Densities {
    Densities {
        force: mounting.accelerometer_noise_density.powi(2),
        rate: mounting.gyroscope_noise_density.powi(2),
    }
}

/// Returns the IMU's own direction of "up" in a sample, with a sigma of at least `floor` rad.
/// `None` without a usable attitude.
fn up_of(sample: &ImuSample, floor: f64) -> Option<Up> {
    let orientation = sample.orientation.as_ref()?;
    let enu_from_imu: &UnitQuaternion<f64> = &orientation.enu_from_imu;
    let coords = enu_from_imu.coords;
    if !coords.iter().all(|x| x.is_finite()) || (coords.norm() - 1.0).abs() > 0.01 {
        return None;
    }
    let variance = orientation.covariance.map_or(0.0, |c| c[(0, 0)].max(c[(1, 1)]));
    let sigma = if variance.is_finite() { variance.max(0.0).sqrt() } else { 0.0 };
    Some(Up {
        in_imu: enu_from_imu.inverse() * Vector3::z(),
        sigma: sigma.max(floor),
        is_specific_force: false,
    })
}
