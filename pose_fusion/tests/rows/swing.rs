//! `volant/swing` against the simulated rig: its angles and rates by differences of the true poses.

use super::common::{scoring, simulated};
use nalgebra::{Matrix6, Point3, Vector3, Vector6};
use pose_fusion::{FusionConfig, Swing};
use rig_simulator::{
    inertial::SensorConfig,
    motion::{Motion, MotionConfig},
};

/// Climber's and platform's end of the rope; neither is the origin of its frame.
const ENDS: [Vector3<f64>; 2] = [Vector3::new(0.05, -0.02, -0.1), Vector3::new(0.02, 0.03, 0.15)];
/// Step of the differences, s.
const STEP: f64 = 1e-4;

/// Rope in the climber's axes at `t`.
fn rope(motion: &Motion, t: f64) -> Vector3<f64> {
    let climber_from_volant = motion.world_from_climber(t).inverse() * motion.world_from_volant(t);
    climber_from_volant * Point3::from(ENDS[1]) - Point3::from(ENDS[0])
}

fn truth(motion: &Motion, t: f64) -> Vector6<f64> {
    let values = |t: f64| {
        let rope = rope(motion, t);
        Vector3::new(rope.norm(), (rope.x / -rope.z).atan(), (rope.y / -rope.z).atan())
    };
    let rates = (values(t + STEP) - values(t - STEP)) / (2.0 * STEP);
    let now = values(t);
    Vector6::new(now.x, now.y, now.z, rates.x, rates.y, rates.z)
}

fn values(s: &Swing) -> Vector6<f64> {
    Vector6::new(s.rope_length, s.angles[0], s.angles[1], s.rope_rate, s.rates[0], s.rates[1])
}

fn config() -> FusionConfig {
    let mut config = simulated::config();
    let pendulum = &mut config.tight.pendulum;
    [pendulum.climber_attachment, pendulum.platform_attachment] = ENDS.map(Into::into);
    config
}

fn swings(motion: MotionConfig, config: FusionConfig) -> (Motion, Vec<(f64, Swing)>) {
    let sensors = SensorConfig::nominal(2);
    let run = simulated::run(motion, &sensors);
    let (_, outputs) = scoring::follow(config, run.inputs());
    let timed = outputs.swing.into_iter().map(|s| (s.stamp.seconds_since(sensors.epoch), s));
    (run.motion, timed.filter(|(t, _)| *t > 2.0).collect())
}

#[test]
fn swing_and_its_rates_agree_with_the_true_poses() {
    let motion =
        MotionConfig { duration: 12.0, climber_turn_rate: 0.2, ..MotionConfig::fast_swing(2) };
    let (motion, swings) = swings(motion, config());
    assert!(swings.len() > 900, "with every odometry: {}", swings.len());
    let mut squares = Matrix6::zeros();
    let (mut nees, mut largest) = (0.0, 0.0_f64);
    for (t, swing) in &swings {
        let error = values(swing) - truth(&motion, *t);
        squares += error * error.transpose() / swings.len() as f64;
        let normalized = swing.covariance.cholesky().unwrap().solve(&error);
        nees += error.dot(&normalized) / swings.len() as f64;
        largest = largest.max(swing.angles[0].hypot(swing.angles[1]));
        let (a, b) = (&swing.climber_from_volant, motion.world_from_climber(*t).inverse());
        let difference = a.inverse() * b * motion.world_from_volant(*t);
        assert!(difference.translation.vector.norm() < 5e-3 && difference.rotation.angle() < 5e-3);
    }
    let rmse = Vector6::from_fn(|i, _| squares[(i, i)].sqrt());
    assert!(largest > 0.05, "the platform swings: {largest} rad");
    assert!(rmse[0] < 1e-3 && rmse[1] < 1e-3 && rmse[2] < 1e-3, "{rmse}");
    assert!(rmse[3] < 10e-3 && rmse[4] < 10e-3 && rmse[5] < 10e-3, "{rmse}");
    assert!((2.0..12.0).contains(&nees), "{nees}");
}

/// The twist is the derivative of the pose, in the climber's axes.
#[test]
fn the_twist_is_the_derivative_of_the_pose() {
    let motion =
        MotionConfig { duration: 6.0, climber_turn_rate: 0.2, ..MotionConfig::fast_swing(3) };
    let (motion, swings) = swings(motion, config());
    for (t, swing) in swings.iter().step_by(7) {
        let pose = |t: f64| motion.world_from_climber(t).inverse() * motion.world_from_volant(t);
        let (before, after) = (pose(t - STEP), pose(t + STEP));
        let linear = (after.translation.vector - before.translation.vector) / (2.0 * STEP);
        let turned = after.rotation * before.rotation.inverse();
        let angular = turned.scaled_axis() / (2.0 * STEP);
        assert!((swing.linear_velocity - linear).norm() < 0.05, "{swing:?}, truth {linear}");
        assert!((swing.angular_velocity - angular).norm() < 0.05, "{swing:?}, truth {angular}");
    }
}

#[test]
fn the_swing_can_be_switched_off() {
    let mut config = config();
    config.tight.swing = false;
    let motion = MotionConfig { duration: 4.0, ..MotionConfig::nominal(2) };
    assert!(swings(motion, config).1.is_empty());
}
