//! Is the climber's clock the camera's? One filter tells, and until it does both answers are in the covariance.
//!
//! Camera and climber are mostly read by one computer: then their offset `d` is 0 exactly. Where somebody has put a second
//! computer in between, `d` may be anything within some [`Prior::sigma`]. So there are two hypotheses, "tied" (`d = 0`) and
//! "free" (`d` normal), as likely as each other before the data ([`crate::TightConfig::climber_clock_tied`]). The covariance holds both, each with
//! its probability; what is said is the tied answer until the other is [`LOTH`] times as likely, and the covariance is about that.
//!
//! `d` is an unknown constant that biases the encoders: a reading stamped t tells where the climber was `d` later. For
//! such a constant the filter falls into two (Friedland 1969, "Treatment of bias in recursive filtering"): one that knows nothing
//! of it, and beside it how much its estimate and each innovation would differ, per second of `d`:
//!
//! `S = H V + D`, `V ← V − K S` at a measurement, `V ← F V` between two; and with an image's innovation ν of covariance Σ
//! `J += Sᵀ Σ⁻¹ S`, `b += Sᵀ Σ⁻¹ ν`.
//!
//! `J` is the information on `d` and `b / J` the estimate that the data alone give. `x + V d` is the estimate of a filter
//! that was told `d`. All this costs one column beside the covariance's 25.
//!
//! `D` is the climber's speed, and here lies a trap: `d` times a speed is a product of two unknowns, and a filter that takes the
//! speed from its own state (whose noise is some mm/s) makes up information from its own corrections: ten seconds of rest
//! "showed" it to 2 ms. So `D` comes from the readings *before* this one ([`speed`]), seven times calmer, and is 0 where they do
//! not say for certain that the climber moves. Known before the innovation, it makes `b` a martingale of variance `J` where
//! `d = 0`: nothing is found where nothing is. The innovations of the readings themselves are left out: what rounding adds to
//! them is no white noise but hangs on the way that was driven, as `D` does.
//!
//! What the data tell: the climber's turns, since the gyroscope feels them, and hardly its way, since the platform's tilt takes
//! up its acceleration. 0.15 rad/s to and fro in ten seconds show `d` to 6 ms.
//!
//! How likely `d = 0` is after all data is the ratio of the free posterior's density at 0 to the prior's (Dickey 1971, "The
//! weighted likelihood ratio"), times the odds before.

use super::{climber::wrapped, geometry::ClimberRest, state::Error};
use nalgebra::{Matrix3, Vector3};
use rig_model::Stamp;
use std::collections::VecDeque;

/// The climber's speed is found from the readings of so long, s.
pub const SPAN: f64 = 1.0;
/// A speed below so many of its sigmas is none.
const CERTAIN: f64 = 4.0;
/// No more is claimed to be known of a constant than this, s (1 sigma): what is known fades as more comes in, so that
/// clocks which come apart in the middle of a run are noticed.
const FLOOR: f64 = 1e-3;
/// "One clock" speaks until the other answer is so many times as likely: the other's mean is worse by an order of magnitude at first, and a
/// rig with one clock should not pay for the question with more than a wider covariance.
pub const LOTH: f64 = 30.0;
/// Moved to another offset, what was found at the old one is off by this share of the way.
const BENT: f64 = 0.1;

/// What one filter finds of the offset, about the one that it takes as given.
#[derive(Clone, Debug, PartialEq)]
pub struct Tie {
    /// V: by how much the estimate would differ, per second of the offset.
    pub by_offset: Error,
    /// The climber's speed was known once: before, V is zero.
    pub known: bool,
    /// J, 1/s².
    pub information: f64,
    /// b, 1/s.
    pub pull: f64,
}

impl Tie {
    /// Nothing is known and nothing would differ.
    pub fn none() -> Self {
        Self { by_offset: Error::zeros(), known: false, information: 0.0, pull: 0.0 }
    }

    /// Takes in a measurement that says so much.
    pub fn learn(&mut self, information: f64, pull: f64) {
        if !(information.is_finite() && pull.is_finite()) {
            return;
        }
        let fade = 1.0 - (information * FLOOR * FLOOR).min(1.0);
        self.information = self.information * fade + information;
        self.pull = self.pull * fade + pull;
    }

    /// What was found so far counts no more; what would differ stays.
    pub fn forget(&mut self) {
        (self.information, self.pull) = (0.0, 0.0);
    }

    /// What the data alone say: how far the offset is from the one that is taken as given, s, and the information on that, 1/s². Seen from
    /// there, it is off by a share of the way.
    pub fn found(&self) -> (f64, f64) {
        if self.information <= 0.0 {
            return (0.0, 0.0);
        }
        let away = self.pull / self.information;
        (away, 1.0 / (1.0 / self.information + (BENT * away).powi(2)))
    }

    /// The same seen from an offset that is `by` seconds further.
    pub fn recentre(&mut self, by: f64) {
        if self.information <= 0.0 {
            return;
        }
        let mean = self.pull / self.information - by;
        self.information = 1.0 / (1.0 / self.information + (BENT * by).powi(2));
        self.pull = mean * self.information;
    }
}

/// What is thought before the first datum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// Probability that climber and camera have one clock.
    pub tied: f64,
    /// Where they have not: the likeliest offset, s.
    pub mean: f64,
    /// And its standard deviation, s.
    pub sigma: f64,
}

/// What is thought of the offset after the data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Belief {
    /// Probability that it is 0 exactly.
    pub tied: f64,
    /// Else: the likeliest, s.
    pub mean: f64,
    /// And its variance, s².
    pub variance: f64,
}

impl Prior {
    /// Without any data.
    pub fn belief(&self) -> Belief {
        Belief { tied: self.tied, mean: self.mean, variance: self.sigma * self.sigma }
    }

    /// After what a filter found that takes the offset to be `centre`.
    pub fn after(&self, centre: f64, tie: &Tie) -> Belief {
        let before = self.sigma.powi(-2);
        let (away, information) = tie.found();
        let precision = before + information;
        let mean = (self.mean * before + (centre + away) * information) / precision;
        let variance = 1.0 / precision;
        let log_density = |mean: f64, variance: f64| -0.5 * (mean * mean / variance + variance.ln());
        let odds = log_density(mean, variance) - log_density(self.mean, self.sigma * self.sigma);
        let free = (1.0 - self.tied) * (-odds).exp();
        let tied = if self.tied >= 1.0 { 1.0 } else { self.tied / (self.tied + free) };
        Belief { tied, mean, variance }
    }
}

impl Belief {
    /// What is said of the offset, s, and the mean square of what that may be off by, over both answers, s².
    pub fn moments(&self) -> (f64, f64) {
        let free = 1.0 - self.tied;
        let said = self.mean * free * free / (free * free + (LOTH * self.tied).powi(2));
        (said, self.tied * said * said + free * (self.variance + (self.mean - said).powi(2)))
    }
}

/// The newest readings: stamp; x, y, turn; the rest.
pub type Readings = VecDeque<(Stamp, Vector3<f64>, ClimberRest)>;

/// The speed of the climber at `stamp`, by the parabola through its readings of [`SPAN`] seconds before; 0 on an axis where it is
/// not certain, given the readings' variance; `None` while there are too few of them.
pub fn speed(readings: &Readings, stamp: Stamp, variance: &Vector3<f64>) -> Option<Vector3<f64>> {
    let mut normal = Matrix3::zeros();
    let mut right = Matrix3::zeros();
    let mut newest: Option<Vector3<f64>> = None;
    let mut oldest = 0.0;
    for (at, value, _) in readings.iter().rev() {
        let t = at.seconds_since(stamp);
        if t >= 0.0 {
            continue;
        }
        if t < -SPAN {
            break;
        }
        oldest = t;
        let reference = *newest.get_or_insert(*value);
        let mut away = value - reference;
        away.z = wrapped(away.z);
        let row = Vector3::new(1.0, t, t * t);
        normal += row * row.transpose();
        right += row * away.transpose();
    }
    if -oldest < SPAN / 3.0 {
        return None;
    }
    let inverse = normal.try_inverse()?;
    let slope = inverse.row(1) * right;
    Some(Vector3::from_fn(|i, _| {
        let sigma = (variance[i] * inverse[(1, 1)]).sqrt();
        if slope[i].abs() > CERTAIN * sigma { slope[i] } else { 0.0 }
    }))
}

#[cfg(test)]
mod tests {
    use super::super::{
        markers::{biased_update, scalar_update},
        propagate::{Felt, Process, propagate},
        state::{CLIMBER, POSITION, State, VELOCITY},
    };
    use super::*;
    use nalgebra::UnitQuaternion;

    const PRIOR: Prior = Prior { tied: 0.999, mean: 0.0, sigma: 0.05 };

    fn found(mean: f64, sigma: f64) -> Tie {
        let information = sigma.powi(-2);
        Tie { information, pull: mean * information, ..Tie::none() }
    }

    #[test]
    fn the_data_decide_and_without_data_nothing_is_decided() {
        assert_eq!(PRIOR.after(0.0, &Tie::none()), PRIOR.belief());
        let agree = PRIOR.after(0.0, &found(0.001, 0.004));
        assert!(agree.tied > 0.9999 && (agree.variance.sqrt() - 0.004).abs() < 1e-4, "{agree:?}");
        let differ = PRIOR.after(0.0, &found(0.04, 0.004));
        assert!(differ.tied < 1e-6 && (differ.mean - 0.04).abs() < 1e-3, "{differ:?}");
        // The same found about another centre, which is nearer: it is a little surer.
        let about = PRIOR.after(0.03, &found(0.01, 0.004));
        assert!((about.mean - differ.mean).abs() < 1e-3 && about.tied < 1e-6, "{about:?}");
        assert!(about.variance < differ.variance && about.variance > 1.6e-5);
        let (mean, variance) = PRIOR.after(0.0, &found(0.02, 0.005)).moments();
        assert!(mean > 0.0 && mean < 0.02 && variance.sqrt() > 0.005, "both answers are in it");
        let certain = Prior { tied: 1.0, ..PRIOR };
        assert_eq!(certain.after(0.0, &found(0.04, 0.001)).tied, 1.0);
    }

    #[test]
    fn a_clock_that_comes_apart_after_an_hour_is_noticed() {
        let mut tie = Tie::none();
        for _ in 0..3600 {
            tie.learn(2e3, 0.0);
        }
        assert!((tie.information.powf(-0.5) / FLOOR - 1.0).abs() < 0.01);
        let mut seconds = 0;
        while PRIOR.after(0.0, &tie).tied > 0.01 {
            tie.learn(2e3, 2e3 * 0.03);
            seconds += 1;
        }
        assert!(seconds < 150, "{seconds}");
    }

    #[test]
    fn seen_from_another_offset_it_is_the_same_a_little_wider() {
        let mut tie = found(0.03, 0.004);
        tie.recentre(0.03);
        let after = PRIOR.after(0.03, &tie);
        assert!((after.mean - 0.03).abs() < 5e-4);
        assert!((after.variance.sqrt() - 0.005).abs() < 1e-4, "{after:?}");
    }

    #[test]
    fn beside_the_filter_runs_the_one_that_was_told_the_offset() {
        let process = Process {
            gravity: 9.81,
            force: 1e-4,
            rate: 0.0,
            accelerometer_bias: 0.0,
            gyroscope_bias: 0.0,
            jerk: Vector3::repeat(0.05),
            clock: 0.0,
        };
        let felt = Felt { force: Vector3::new(0.0, 0.0, 9.81), rate: Vector3::zeros() };
        let mut knows_nothing = State::zero();
        knows_nothing.attitude = UnitQuaternion::identity();
        // Nothing that turns: then the filter is linear, and what is claimed is exact.
        for i in (POSITION..POSITION + 6).chain(CLIMBER..CLIMBER + 9) {
            knows_nothing.covariance[(i, i)] = 1e-2;
        }
        let mut told = knows_nothing.clone();
        let offset = 0.02;
        for step in 0..300 {
            let t = f64::from(step) * 0.01;
            let speed = 0.3 * (2.0 * t).cos();
            for (state, offset) in [(&mut knows_nothing, 0.0), (&mut told, offset)] {
                propagate(state, &felt, &felt, 0.01, &process);
                let reading = 0.15 * (2.0 * t).sin() - state.climber.x - speed * offset;
                biased_update(state, &[(CLIMBER, 1.0)], speed, reading, 1e-7);
                let seen = 0.01 * (3.0 * t).cos() - (state.position.x - state.climber.x);
                scalar_update(state, &[(POSITION, 1.0), (CLIMBER, -1.0)], seen, 1e-7);
            }
        }
        let error = told.minus(&knows_nothing) - knows_nothing.tie.by_offset * offset;
        assert!(error.amax() < 1e-6, "{error}");
        let moved = told.minus(&knows_nothing);
        assert!(moved[POSITION].abs() > 1e-3 && moved[VELOCITY].abs() > 1e-4, "{moved}");
    }

    #[test]
    fn the_speed_is_that_of_rounded_readings_and_none_where_they_stand() {
        let rest = ClimberRest { height: 2.8, tilt: UnitQuaternion::identity() };
        let variance = Vector3::new(1e-6, 1e-6, 7.6e-7) / 12.0;
        let start = Stamp::from_nanos(1_000_000_000);
        let mut readings = Readings::new();
        assert_eq!(speed(&readings, start, &variance), None);
        for i in 0..100 {
            let t = f64::from(i) * 0.02;
            let x = ((0.3 * t - 0.1 * t * t) * 1e3).round() * 1e-3;
            readings.push_back((start.plus_seconds(t), Vector3::new(x, 0.4, wrapped(3.0 + 0.15 * t)), rest));
        }
        let found = speed(&readings, start.plus_seconds(2.0), &variance).unwrap();
        assert!((found.x - (0.3 - 0.2 * 2.0)).abs() < 3e-3, "{found}");
        assert!(found.y == 0.0 && (found.z - 0.15).abs() < 1e-6, "{found}");
        assert_eq!(speed(&readings, start.plus_seconds(0.2), &variance), None, "too few readings before it");
    }
}
