//! Directions and scales of the encoders. A rail that is reversed or exchanged with the other, a
//! reversed turn or a camera turned about the vertical gives a pose that moves the wrong way in the
//! world; images and IMU contradict it only while the climber's speed changes.
//!
//! Images show where the platform is beside the climber, the IMU (its specific force integrated
//! twice) where the platform is up to a linear drift: the difference is the climber. From one
//! [`SPAN`] to the next its mean velocity changes by an amount that does not depend on that drift.
//! Where a linear map of the encoders' changes explains that change far better than they do, they
//! are wrong. The pose follows wrong encoders and tilts with them, which blurs what the IMU shows:
//! the map of a reversed rail is between -1 and 0.5. The turn is compared by its change within a
//! span. The same changes show whether an axis moves that repeats its reading: its encoder is stuck.

use crate::{
    ekf::propagation::ImuReading,
    timeline::{
        dropout::GAP,
        history::{Entry, History},
    },
};
use nalgebra::{Matrix2, Matrix4, UnitQuaternion, Vector2, Vector3, Vector4};
use rig_model::{Stamp, wrap_angle};
use std::collections::VecDeque;

/// Time over which velocities are taken, s.
const SPAN: f64 = 0.4;
/// Largest distance of a sample from the instant one span earlier that it is used for, s.
const NEAR: f64 = 0.1;
/// Images that follow each other faster are left out, s.
const CLOSE: f64 = 0.02;
/// Memory, s.
const MEMORY: f64 = 20.0;
/// Factor on the sum of squares that the best map leaves from which the encoders are wrong.
const RATIO: f64 = 4.0;
/// Smallest excess over that which counts: rails, (m/s)² s; turn, rad² s. With correct files the sum
/// of the turn is at most 0.0004, and the excess of the rails at most 0.006 in 460 simulated
/// starts and seven recordings, three of them with real IMU samples; an IMU mounted 5° off gives
/// 0.011.
const LEAST: [f64; 2] = [0.012, 0.002];
/// Time over which rails must have differed, s: a slip, a leap or an error of the initial attitude
/// differs for up to two spans.
const LASTS: f64 = 1.2;
/// Sum of squares of the encoders' changes below which a map of them is uncertain, (m/s)² s, rad² s.
const UNCERTAIN: f64 = 0.0005;
/// Time over which the rails must have been compared before motion that an axis does not report
/// counts, s: within the first spans an error of the initial attitude resembles it.
const COMPARED: f64 = 4.0;
/// Process noise of specific force, (m/s²)² s, and of angular velocity, (rad/s)² s, from which on
/// the IMU may have missed motion: a saturated or stuck axis, a shock.
const MISSED: [f64; 2] = [1.0, 0.5];
/// Changes of velocity that no climber makes in a span, m/s: readings that leap.
const LEAPS: f64 = 1.0;

/// Memory of motion that an axis does not report, s, and its smallest sums of squares: x and y,
/// (m/s)² s; turn without and with the errors of the gyroscope, rad² s.
const RECENT: f64 = 1.0;
const UNREPORTED: Vector4<f64> = Vector4::new(0.0012, 0.0012, 0.0004, 0.0007);
/// Readings that differ by less repeat, m and rad.
const EQUAL: f64 = 1e-6;

/// What the difference of a linear map from the given directions means, row by row.
const RAILS: [([f64; 4], &str); 7] = [
    ([-1.0, 0.0, 0.0, 0.0], "`rail_x` is reversed or its scale is wrong"),
    ([0.0, 0.0, 0.0, -1.0], "`rail_y` is reversed or its scale is wrong"),
    ([-1.0, 1.0, 1.0, -1.0], "`rail_x` and `rail_y` are exchanged"),
    ([-1.0, -1.0, -1.0, -1.0], "`rail_x` and `rail_y` are exchanged and reversed"),
    (
        [-1.0, 0.0, 0.0, -1.0],
        "both rails are reversed or their scale is wrong, or `camera.orientation` or \
         `imu.orientation` is turned by 180°",
    ),
    (
        [-1.0, 1.0, -1.0, -1.0],
        "the rails are exchanged and one reversed, or `camera.orientation` is turned by 90°",
    ),
    (
        [-1.0, -1.0, 1.0, -1.0],
        "the rails are exchanged and one reversed, or `camera.orientation` is turned by 90°",
    ),
];
/// The same for the turn.
const TURN: &str = "`turn` is reversed or its scale is wrong";
/// The same for differences that resemble none of [`RAILS`], or several.
const UNCLEAR: &str = "the rails are reversed or exchanged, their scale is wrong, or \
                       `camera.orientation` is turned about the vertical";
/// Largest share of the encoders' changes that rails which move alike do not have in common.
const ALIKE: f64 = 0.05;
/// Least cosine between a difference and one of [`RAILS`] that it resembles.
const RESEMBLES: f64 = 0.85;

/// Climber at an image: x, y (m) and turn (rad).
#[derive(Clone, Copy, Debug)]
struct ClimberInstant {
    stamp: Stamp,
    /// As images and IMU show it: x and y up to a linear drift, turn up to a constant.
    shown: Vector3<f64>,
    /// The same by IMU readings without their estimated errors.
    calibrated: Vector3<f64>,
    /// As the encoders report it.
    read: Vector3<f64>,
}

/// Where the sums continue.
#[derive(Clone, Copy, Debug)]
struct InertialTrack {
    stamp: Stamp,
    /// By readings as the IMU sends them, and without their estimated errors.
    inertial: [Inertial; 2],
    attitude: UnitQuaternion<f64>,
    climber_turn: f64,
}

/// Motion since the first sample, from the IMU alone.
#[derive(Clone, Copy, Debug, Default)]
struct Inertial {
    /// m/s.
    velocity: Vector2<f64>,
    /// m.
    position: Vector2<f64>,
    /// Difference of the yaws of IMU and images, with the climber's turn, rad.
    turn: f64,
}

/// What is given, and the linear map of the encoders' changes that explains the motion best.
#[derive(Clone, Copy, Debug)]
struct Explanation {
    /// Sums of squares of the differences with what is given, and with the best map.
    given: f64,
    best: f64,
    /// Smallest excess of `given` over `best` that counts.
    least: f64,
}

impl Explanation {
    fn refutes(&self) -> bool {
        self.given - self.best > self.least && self.given > RATIO * self.best
    }

    fn holds(&self) -> bool {
        self.given - self.best > self.least / 2.0
    }
}

/// Comparison of the encoders' directions with images and IMU.
#[derive(Clone, Debug, Default)]
pub struct EncoderDirections {
    newest: Option<InertialTrack>,
    samples: VecDeque<ClimberInstant>,
    /// Seconds, and the sums over them of changes (encoders x, y; shown minus encoders x, y), m/s,
    /// and of their products.
    seconds: f64,
    sum: Vector4<f64>,
    products: Matrix4<f64>,
    /// Sum of the squares of the differences' squares, (m/s)⁴ s.
    squares_squared: f64,
    /// Sums of products of the turn's changes (encoders, shown minus encoders), rad² s.
    turn_products: Matrix2<f64>,
    /// Sum over the seconds of what calibrated readings show beside the encoders, m/s · s.
    drift: Vector2<f64>,
    /// Sums of squares over [`RECENT`] of what is shown of axes that repeat their readings, as in
    /// [`UNREPORTED`].
    unreported: Vector4<f64>,
    /// What is wrong, and whether it is the turn.
    wrong: Option<(&'static str, bool)>,
}

impl EncoderDirections {
    /// Returns what is wrong, if other directions or scales explain what images and IMU show.
    pub fn wrong(&self) -> Option<&'static str> {
        self.wrong.map(|(text, _)| text)
    }

    /// Returns for each axis whether it repeats its reading while images and IMU show that the
    /// climber moves along it.
    pub fn unreported(&self) -> [bool; 3] {
        let [x, y, calibrated, raw] =
            self.unreported.zip_map(&UNREPORTED, |sum, least| sum > least).into();
        [x, y, calibrated || raw]
    }

    /// Begins a new stretch of the time line: the next sample is not compared with those before.
    pub fn interrupt(&mut self) {
        self.newest = None;
    }

    /// Adds the image at a place of the time line, whose markers corrected the state; `read` is the
    /// climber by the encoders there (m, m, rad).
    pub fn add(&mut self, history: &History, place: usize, read: &Vector3<f64>) {
        let Some(entry) = history.get(place) else { return };
        let (stamp, state) = (entry.stamp, &entry.state);
        // Late images add nothing.
        if self.newest.is_some_and(|n| stamp.seconds_since(n.stamp) < CLOSE) {
            return;
        }
        let moved = self.newest.and_then(|newest| newest.to(history, place));
        if moved.is_none() {
            self.samples.clear();
            self.unreported = Vector4::zeros();
        }
        let (attitude, climber_turn) = (state.attitude, state.climber.z);
        let newest = moved.unwrap_or(InertialTrack {
            stamp,
            inertial: [Inertial::default(); 2],
            attitude,
            climber_turn,
        });
        self.newest = Some(newest);
        let beside = state.position.xy() - state.climber.xy();
        let [shown, calibrated] =
            newest.inertial.map(|inertial| (inertial.position - beside).push(inertial.turn));
        self.compare(ClimberInstant { stamp, shown, calibrated, read: *read });
        let old = |s: &ClimberInstant| stamp.seconds_since(s.stamp) > 2.0 * SPAN + NEAR;
        while self.samples.front().is_some_and(old) {
            self.samples.pop_front();
        }
    }

    /// Returns the sample about this many seconds before a stamp.
    fn before(&self, stamp: Stamp, seconds: f64) -> Option<&ClimberInstant> {
        let away = |s: &&ClimberInstant| (stamp.seconds_since(s.stamp) - seconds).abs();
        // They are in the order of time.
        let behind = self.samples.partition_point(|s| stamp.seconds_since(s.stamp) > seconds);
        let beside = [behind.checked_sub(1), Some(behind)].into_iter().flatten();
        let nearest = beside
            .filter_map(|place| self.samples.get(place))
            .min_by(|a, b| away(a).total_cmp(&away(b)));
        nearest.filter(|s| away(s) < NEAR)
    }

    fn compare(&mut self, last: ClimberInstant) {
        let before = self.samples.back().map(|s| last.stamp.seconds_since(s.stamp));
        self.samples.push_back(last);
        let (Some(middle), Some(before)) = (self.before(last.stamp, SPAN).copied(), before) else {
            return;
        };
        let dt = before.min(NEAR);
        let fade = 1.0 - dt / MEMORY;
        let turn = wrap_angle(last.shown.z - middle.shown.z);
        let read = wrap_angle(last.read.z - middle.read.z);
        let both = Vector2::new(read, turn - read);
        self.turn_products = self.turn_products * fade + both * both.transpose() * dt;
        let stood = (middle.read - last.read).map(|way| way.abs() < EQUAL);
        // The estimate takes the turn of an encoder stuck before the first pose for a bias of the
        // gyroscope, which the raw readings show; they contain the true bias and need more.
        let calibrated = wrap_angle(last.calibrated.z - middle.calibrated.z);
        self.add_unreported(2, stood.z, calibrated, dt);
        self.add_unreported(3, stood.z, turn, dt);
        let read = self.change(&last, |s| s.read.xy());
        let shown = self.change(&last, |s| s.shown.xy());
        if let Some((read, shown)) = read.zip(shown)
            && read.amax() < LEAPS
        {
            let moved = self.change(&last, |s| s.calibrated.xy()).unwrap_or_default();
            // A lasting difference is a bias or a tilt.
            let drift = self.drift / self.seconds.max(NEAR);
            for i in 0..2 {
                let stood = stood[i] && read[i].abs() < EQUAL && self.seconds > COMPARED;
                self.add_unreported(i, stood, moved[i] - drift[i], dt);
            }
            self.drift = self.drift * fade + (moved - read) * dt;
            let both = Vector4::new(read.x, read.y, shown.x - read.x, shown.y - read.y);
            self.seconds = self.seconds * fade + dt;
            self.sum = self.sum * fade + both * dt;
            let square = (shown - read).norm_squared();
            self.squares_squared = self.squares_squared * fade + square * square * dt;
            self.products = self.products * fade + both * both.transpose() * dt;
        }
        self.judge();
    }

    /// Adds a motion shown along an axis within `dt` seconds; `stood`: its encoder did not move.
    fn add_unreported(&mut self, axis: usize, stood: bool, moved: f64, dt: f64) {
        let sum = self.unreported[axis] * (1.0 - dt / RECENT) + moved * moved * dt;
        self.unreported[axis] = if stood { sum } else { 0.0 };
    }

    /// Returns the change of the mean velocity over the two spans before an instant, m/s.
    fn change(
        &self,
        last: &ClimberInstant,
        of: fn(&ClimberInstant) -> Vector2<f64>,
    ) -> Option<Vector2<f64>> {
        let middle = self.before(last.stamp, SPAN)?;
        let first = self.before(last.stamp, 2.0 * SPAN)?;
        let span = last.stamp.seconds_since(middle.stamp);
        let earlier = middle.stamp.seconds_since(first.stamp);
        Some((of(last) - of(middle)) / span - (of(middle) - of(first)) / earlier)
    }

    /// Returns how the rails explain the motion, and what the best map of their changes means; a
    /// lasting difference is a bias or a tilt.
    fn rails(&self) -> (Explanation, &'static str) {
        let products = self.products - self.sum * self.sum.transpose() / self.seconds.max(NEAR);
        let read = products.fixed_view::<2, 2>(0, 0);
        let beside = products.fixed_view::<2, 2>(2, 0);
        let certain = (read + Matrix2::identity() * UNCERTAIN).try_inverse();
        let map = beside * certain.unwrap_or_default();
        let given = products.fixed_view::<2, 2>(2, 2).trace();
        let best = given - (map * (beside * 2.0 - map * read).transpose()).trace();
        // Rails that move alike fit several maps.
        let alike = read.determinant() < ALIKE * read[(0, 0)] * read[(1, 1)];
        let text = if alike { UNCLEAR } else { named(&map) };
        (Explanation { given, best, least: LEAST[0] }, text)
    }

    /// Returns how the turn explains the motion.
    fn turn(&self) -> Explanation {
        let [[read, beside], [_, given]] = self.turn_products.into();
        let scale = beside / (read + UNCERTAIN);
        let best = given - scale * (2.0 * beside - scale * read);
        Explanation { given, best, least: LEAST[1] }
    }

    /// Returns for how long encoders and what is shown have differed, s: a single leap, slip or
    /// beginning lasts for about a span.
    fn lasts(&self) -> f64 {
        let squares = self.products.fixed_view::<2, 2>(2, 2).trace();
        squares * squares / self.squares_squared.max(f64::MIN_POSITIVE)
    }

    fn judge(&mut self) {
        let ((rails, text), turn) = (self.rails(), self.turn());
        // A wrong turn shows the rails in wrong directions, too.
        let found = if turn.refutes() {
            Some((TURN, true))
        } else {
            (rails.refutes() && self.lasts() > LASTS).then_some((text, false))
        };
        let held = self.wrong.filter(|(_, turned)| if *turned { turn } else { rails }.holds());
        self.wrong = found.or(held);
    }
}

/// Returns what a map means that differs from the given directions by `map`.
fn named(map: &Matrix2<f64>) -> &'static str {
    let resembles = |directions: &[f64; 4]| {
        let other = Matrix2::from_row_slice(directions);
        let cosine = map.dot(&other) / (map.norm() * other.norm());
        // A scale may be too small or too large.
        if other[(0, 1)] == 0.0 { cosine.abs() } else { cosine }
    };
    let best = RAILS
        .iter()
        .map(|(directions, text)| (resembles(directions), *text))
        .max_by(|(a, _), (b, _)| a.total_cmp(b));
    best.filter(|(cosine, _)| *cosine > RESEMBLES).map_or(UNCLEAR, |(_, text)| text)
}

impl Inertial {
    /// Goes on from one entry of the history to the next, after `dt` seconds.
    fn advance(&mut self, from: &Entry, to: &Entry, dt: f64, of: fn(&Entry) -> ImuReading) {
        let [force, rate] = [from, to].iter().fold([Vector3::zeros(); 2], |[f, r], e| {
            let ImuReading { specific_force, angular_velocity } = of(e);
            [f + e.state.attitude * specific_force, r + e.state.attitude * angular_velocity]
        });
        let gained = force.xy() * (dt / 2.0);
        self.position += (self.velocity + gained / 2.0) * dt;
        self.velocity += gained;
        self.turn += rate.z * (dt / 2.0);
    }
}

impl InertialTrack {
    /// Returns what follows at a later place; `None` where the IMU samples do not lead there.
    fn to(mut self, history: &History, place: usize) -> Option<Self> {
        let first = history.place_of(self.stamp).checked_sub(1)?;
        if first >= place || history.get(first)?.stamp != self.stamp {
            return None;
        }
        for k in first..place {
            let (from, to) = (history.get(k)?, history.get(k + 1)?);
            let dt = to.stamp.seconds_since(from.stamp);
            if dt > GAP || to.noise.force > MISSED[0] || to.noise.rate > MISSED[1] {
                return None;
            }
            // For the directions the biases would be estimated so that they explain what is wrong.
            self.inertial[0].advance(from, to, dt, |e| e.reading);
            self.inertial[1].advance(from, to, dt, |e| e.state.motion(&e.reading));
        }
        let state = &history.get(place)?.state;
        let turned = (state.attitude * self.attitude.inverse()).scaled_axis().z;
        for inertial in &mut self.inertial {
            inertial.turn += wrap_angle(state.climber.z - self.climber_turn) - turned;
        }
        self.stamp = history.get(place)?.stamp;
        (self.attitude, self.climber_turn) = (state.attitude, state.climber.z);
        Some(self)
    }
}

#[cfg(test)]
mod tests;
