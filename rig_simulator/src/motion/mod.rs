//! Swing of the platform and drive of the climber: smooth functions of time, fixed by a seed.
//!
//! A [`MotionConfig`] determines poses and their derivatives at any instant. The platform hangs as
//! a pendulum below the climber's center: it tilts along the rope (so its accelerometer measures
//! hardly any tilt), turns about the rope and wobbles a little. The climber's path is prescribed.
//! So is the swing, unless it is free: then the platform is a pendulum whose pivot the climber
//! moves.

mod config;
#[cfg(test)]
mod tests;

pub use config::MotionConfig;

use crate::random::Random;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rig_model::Rig;
use std::f64::consts::TAU;

/// Pose and derivatives of the platform at an instant.
#[derive(Clone, Debug, PartialEq)]
pub struct Kinematics {
    /// Pose.
    pub world_from_volant: Isometry3<f64>,
    /// Velocity of the origin, world axes, m/s.
    pub velocity: Vector3<f64>,
    /// Acceleration of the origin, world axes, m/s².
    pub acceleration: Vector3<f64>,
    /// Rate of turn, volant axes, rad/s.
    pub angular_velocity: Vector3<f64>,
    /// Its derivative, volant axes, rad/s².
    pub angular_acceleration: Vector3<f64>,
}

/// A sum of two sines that stays within ±amplitude.
#[derive(Clone, Debug)]
struct Wave {
    amplitude: [f64; 2],
    rate: [f64; 2],
    phase: [f64; 2],
}

impl Wave {
    fn new(random: &mut Random, amplitude: f64, frequency: f64) -> Self {
        let first = random.within(0.6, 0.8);
        Self {
            amplitude: [amplitude * first, amplitude * (1.0 - first)],
            rate: [1.0, random.within(0.55, 0.8)].map(|r| r * TAU * frequency),
            phase: [random.within(0.0, TAU), random.within(0.0, TAU)],
        }
    }

    fn at(&self, t: f64) -> f64 {
        (0..2).map(|i| self.amplitude[i] * (self.rate[i] * t + self.phase[i]).sin()).sum()
    }
}

/// A run's motion.
#[derive(Clone, Debug)]
pub struct Motion {
    config: MotionConfig,
    rope: f64,
    swing: [Wave; 2],
    wobble: [Wave; 2],
    yaw: Wave,
    heave: Wave,
    drive: [Wave; 2],
    turn: Wave,
    /// Yaw of the stationary climber, rad.
    heading: f64,
    /// Free swing: direction of the rope (downwards) and its derivatives, every [`STEP`] from
    /// [`BEFORE`] on.
    path: Vec<[Vector3<f64>; 3]>,
}

/// Between two entries of a free swing, s.
const STEP: f64 = 5e-3;
/// Time by which it begins before 0 and ends after the run, s.
const BEFORE: f64 = 0.2;

impl Motion {
    /// The motion of a configuration.
    pub fn new(config: MotionConfig) -> Self {
        let mut r = Random::fork(config.seed, "motion");
        let f = config.frequency.max(0.05);
        // A path of period T that is never faster than v has an amplitude of at most v·T/2π.
        let drive_frequency = r.within(0.09, 0.13);
        let drive = config.climber_speed / (TAU * drive_frequency);
        let turn_frequency = r.within(0.09, 0.13);
        let turn = config.climber_turn_rate / (TAU * turn_frequency);
        // The two swings together stay within the tilt that was asked for.
        let direction = r.within(0.0, TAU);
        let shares = [direction.cos().abs().max(0.2), direction.sin().abs().max(0.2)];
        let scale = 1.0 / (shares[0] * shares[0] + shares[1] * shares[1]).sqrt();
        let mut motion = Self {
            rope: 9.81 / (TAU * f).powi(2),
            swing: shares.map(|s| Wave::new(&mut r, config.swing * s * scale, f)),
            wobble: [0; 2].map(|_| Wave::new(&mut r, config.wobble * 0.7, 1.3)),
            yaw: Wave::new(&mut r, config.yaw, 0.2),
            heave: Wave::new(&mut r, if config.swing > 0.0 { 0.01 } else { 0.0 }, 0.25),
            drive: [0; 2].map(|_| Wave::new(&mut r, drive, drive_frequency)),
            turn: Wave::new(&mut r, turn, turn_frequency),
            heading: r.within(-0.6, 0.6),
            path: Vec::new(),
            config,
        };
        if motion.config.free {
            motion.path = motion.let_go();
        }
        motion
    }

    /// Lean of the rope in the prescribed swing.
    fn prescribed(&self, t: f64) -> UnitQuaternion<f64> {
        let e = self.envelope(t);
        UnitQuaternion::from_scaled_axis(Vector3::new(
            e * self.swing[0].at(t),
            e * self.swing[1].at(t),
            0.0,
        ))
    }

    /// Integrates the free swing with the fourth-order Runge–Kutta method: `q¨ = (1 − q qᵀ) (g −
    /// pivot¨)/L − |q˙|² q`.
    fn let_go(&self) -> Vec<[Vector3<f64>; 3]> {
        let slope = |t: f64, q: Vector3<f64>, v: Vector3<f64>| {
            let h = 1e-3;
            let pivot = (self.pivot(t - h) + self.pivot(t + h) - self.pivot(t) * 2.0) / (h * h);
            let pull = (Vector3::new(0.0, 0.0, -9.81) - pivot) / self.rope;
            pull - q * (q.dot(&pull) + v.norm_squared())
        };
        let mut t = -BEFORE;
        let prescribed = |t: f64| self.prescribed(t) * -Vector3::z();
        let mut q = prescribed(t);
        let mut v = (prescribed(t + 1e-4) - prescribed(t - 1e-4)) / 2e-4;
        let count = ((self.config.duration + 2.0 * BEFORE) / STEP).ceil() as usize + 1;
        let mut path = Vec::with_capacity(count);
        for _ in 0..count {
            let a1 = slope(t, q, v);
            path.push([q, v, a1]);
            let (h, middle) = (STEP / 2.0, t + STEP / 2.0);
            let (v2, a2) = (v + a1 * h, slope(middle, q + v * h, v + a1 * h));
            let (v3, a3) = (v + a2 * h, slope(middle, q + v2 * h, v + a2 * h));
            let (v4, a4) = (v + a3 * STEP, slope(t + STEP, q + v3 * STEP, v + a3 * STEP));
            q = (q + (v + (v2 + v3) * 2.0 + v4) * (STEP / 6.0)).normalize();
            v += (a1 + (a2 + a3) * 2.0 + a4) * (STEP / 6.0);
            v -= q * q.dot(&v);
            t += STEP;
        }
        path
    }

    /// How the rope leans at `t` seconds.
    fn lean(&self, t: f64) -> UnitQuaternion<f64> {
        let place = ((t + BEFORE) / STEP).clamp(0.0, self.path.len().saturating_sub(2) as f64);
        let [Some(a), Some(b)] = [0, 1].map(|k| self.path.get(place as usize + k)) else {
            return self.prescribed(t);
        };
        // The polynomial of fifth order with place, speed and acceleration of both ends.
        let s = place.fract();
        let (s3, r) = (s * s * s, 1.0 - s);
        let r3 = r * r * r;
        let from = r3 * (1.0 + 3.0 * s + 6.0 * s * s);
        let hang = a[0] * from
            + b[0] * (1.0 - from)
            + (a[1] * (r3 * s * (1.0 + 3.0 * s)) - b[1] * (s3 * r * (1.0 + 3.0 * r))) * STEP
            + (a[2] * (r3 * s * s) + b[2] * (s3 * r * r)) * (STEP * STEP / 2.0);
        UnitQuaternion::rotation_between(&-Vector3::z(), &hang)
            .unwrap_or_else(UnitQuaternion::identity)
    }

    /// The configuration of this motion.
    pub fn config(&self) -> &MotionConfig {
        &self.config
    }

    /// How long the run is, s.
    pub fn duration(&self) -> f64 {
        self.config.duration
    }

    /// Length of the rope between pivot and platform, m.
    pub fn rope_length(&self) -> f64 {
        self.rope
    }

    /// 0 while stationary, smoothly to 1, and back.
    fn envelope(&self, t: f64) -> f64 {
        let since = (t - self.config.still_until).min(self.config.still_from - t);
        let s = (since / self.config.ramp).clamp(0.0, 1.0);
        s * s * s * s * (35.0 + s * (-84.0 + s * (70.0 - 20.0 * s)))
    }

    /// x, y (m) and turn (rad) of the climber at `t` seconds.
    pub fn climber(&self, t: f64) -> [f64; 3] {
        let e = self.envelope(t);
        let from_rest = |w: &Wave| e * w.at(t);
        [from_rest(&self.drive[0]), from_rest(&self.drive[1]), self.heading + from_rest(&self.turn)]
    }

    /// Pose of the climber at `t` seconds.
    pub fn world_from_climber(&self, t: f64) -> Isometry3<f64> {
        self.climber_pose(self.climber(t))
    }

    /// Pose of the climber with this x, y (m) and turn (rad).
    pub(crate) fn climber_pose(&self, [x, y, turn]: [f64; 3]) -> Isometry3<f64> {
        Isometry3::from_parts(
            Translation3::new(x, y, self.config.climber_height),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn),
        )
    }

    /// Pose of the camera at `t` seconds.
    pub fn world_from_camera(&self, t: f64, rig: &Rig) -> Isometry3<f64> {
        self.world_from_climber(t) * rig.climber_from_camera
    }

    /// Pose of the platform at `t` seconds.
    pub fn world_from_volant(&self, t: f64) -> Isometry3<f64> {
        let e = self.envelope(t);
        let [.., turn] = self.climber(t);
        let wobble = [e * self.wobble[0].at(t), e * self.wobble[1].at(t)];
        // Along the rope: leaning by φ about x moves the platform towards −y … and lifts it.
        let rope = self.lean(t);
        let hang = rope * Vector3::new(0.0, 0.0, -self.rope);
        let position = self.pivot(t) + hang;
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn + e * self.yaw.at(t));
        let lean = UnitQuaternion::from_scaled_axis(Vector3::new(wobble[0], wobble[1], 0.0));
        Isometry3::from_parts(position.into(), rope * yaw * lean)
    }

    /// Upper end of the rope at `t` seconds (the pivot of the swing), world axes, m.
    pub fn pivot(&self, t: f64) -> Vector3<f64> {
        let [x, y, _] = self.climber(t);
        Vector3::new(
            x,
            y,
            self.config.platform_height + self.rope + self.envelope(t) * self.heave.at(t),
        )
    }

    /// Pose and derivatives of the platform at `t` seconds, by fourth-order differences (error
    /// about 1e-8).
    pub fn kinematics(&self, t: f64) -> Kinematics {
        let h = 1e-3;
        let pose = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|k| self.world_from_volant(t + k * h));
        let p = pose.map(|x| x.translation.vector);
        let rate = |t: f64| {
            let step = 1e-4;
            let turn = |s: f64| {
                let (a, b) = (self.world_from_volant(t - s), self.world_from_volant(t + s));
                (a.rotation.inverse() * b.rotation).scaled_axis() / (2.0 * s)
            };
            (turn(step) * 4.0 - turn(2.0 * step)) / 3.0
        };
        Kinematics {
            world_from_volant: pose[2],
            velocity: (p[0] - p[4] + (p[3] - p[1]) * 8.0) / (12.0 * h),
            acceleration: (-p[0] - p[4] + (p[1] + p[3]) * 16.0 - p[2] * 30.0) / (12.0 * h * h),
            angular_velocity: rate(t),
            angular_acceleration: (rate(t - 2.0 * h) - rate(t + 2.0 * h)
                + (rate(t + h) - rate(t - h)) * 8.0)
                / (12.0 * h),
        }
    }
}
