//! What an operator does: set the pose, freeze, reset, keep what is known and take it up again.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#[path = "../common/mod.rs"]
mod common;
mod live;

use common::{scoring, simulated};
use nalgebra::Matrix6;
use pose_fusion::{Fusion, FusionConfig, Input, PoseEstimate, PoseState, Refusal};
use rig_model::{MarkerColor, score::PoseError, topics};
use rig_simulator::{inertial::SensorConfig, motion::MotionConfig};

fn fusion() -> Fusion {
    Fusion::new(simulated::rig(), FusionConfig::default())
}

/// The run, cut at `cut` seconds of arrival.
fn cut(run: &simulated::Run, sensors: &SensorConfig, cut: f64) -> (Vec<Input>, Vec<Input>) {
    let (before, after): (Vec<_>, Vec<_>) =
        run.inputs.iter().cloned().partition(|(at, _)| at.seconds_since(sensors.epoch) < cut);
    (before.into_iter().map(|(_, i)| i).collect(), after.into_iter().map(|(_, i)| i).collect())
}

#[test]
fn a_restored_checkpoint_continues_the_run() {
    let sensors = SensorConfig::nominal(1);
    let run = simulated::run(MotionConfig::nominal(1), &sensors);
    let (before, after) = cut(&run, &sensors, 8.0);
    let mut first = fusion();
    assert_eq!(first.checkpoint(), Err(Refusal::NotInitialized));
    scoring::run(&mut first, before);
    let checkpoint = first.checkpoint().unwrap();
    let mut second = fusion();
    second.handle(Input::Camera(simulated::camera()));
    second.restore(&checkpoint).unwrap();
    let outputs = scoring::run(&mut second, after.clone());
    let expected = scoring::run(&mut first, after);
    // From the very next sample on, and better than a fresh start.
    assert!(outputs.odometry[0].stamp.seconds_since(expected.odometry[0].stamp).abs() < 0.02);
    let score = scoring::score(&outputs.odometry, &run.truth, 0.0);
    let reference = scoring::score(&expected.odometry, &run.truth, 8.0);
    let most = 1.1 * reference.position_rmse() + 0.05;
    assert!(score.position_rmse() < most, "restored {score}\nwent on  {reference}");
    assert!(!second.status().time_offset.searching);
    assert!((second.status().biases[0] - first.status().biases[0]).norm() < 0.01);
    // Not lost while its first images are due, and valid once they agree with it.
    let begin = outputs.odometry[0].stamp;
    let valid = outputs.status.iter().find(|s| s.valid).map(|s| s.stamp.seconds_since(begin));
    assert!(valid.is_some_and(|after| after < 0.4), "{valid:?}");
    let lost = outputs.status.iter().filter(|s| s.state == PoseState::Lost).count();
    assert_eq!(lost, 0);
}

#[test]
fn an_old_checkpoint_gives_clocks_and_biases() {
    let sensors = SensorConfig {
        camera_clock_ahead: 0.06,
        climber_clock_ahead: 0.06,
        ..SensorConfig::nominal(2)
    };
    let run = simulated::run(MotionConfig::nominal(2), &sensors);
    let all: Vec<Input> = run.inputs().collect();
    let mut first = fusion();
    scoring::run(&mut first, all.clone());
    let checkpoint = first.checkpoint().unwrap();
    let mut second = fusion();
    second.restore(&checkpoint).unwrap();
    let outputs = scoring::run(&mut second, all);
    // Without it the first seconds search for the clock.
    let early = |o: &[pose_fusion::Odometry]| {
        let until = sensors.epoch.plus_seconds(3.0);
        let first: Vec<_> = o.iter().filter(|o| o.stamp < until).cloned().collect();
        scoring::score(&first, &run.truth, 0.3)
    };
    let score = early(&outputs.odometry);
    assert!(score.position_rmse() < 1.5, "{score}");
    assert!((second.status().time_offset.offset + 0.06).abs() < 1e-3);
}

#[test]
fn an_invalid_checkpoint_is_rejected() {
    let sensors = SensorConfig::nominal(1);
    let run = simulated::run(MotionConfig { duration: 3.0, ..MotionConfig::nominal(1) }, &sensors);
    let mut first = fusion();
    scoring::run(&mut first, run.inputs());
    let good = first.checkpoint().unwrap();
    assert!(first.restore(&good).is_ok());
    type Corruption = fn(&mut pose_fusion::Checkpoint);
    let corruptions: [Corruption; 13] = [
        |c| c.version = 99,
        |c| c.position[1] = f64::NAN,
        |c| c.position[0] += 100.0,
        |c| c.time_offset = 2.0,
        |c| c.attitude = [0.0; 4],
        |c| c.covariance.truncate(100),
        |c| c.covariance[1] += 1.0,
        |c| c.covariance[0] = -1.0,
        |c| c.constants[3] = f64::INFINITY,
        |c| c.constants[0] = 1.5,
        |c| c.constants_covariance.truncate(12),
        |c| c.constants_covariance[1] += 1.0,
        |c| c.constants_covariance[13] = -1.0,
    ];
    for corrupt in corruptions {
        let mut bad = good.clone();
        corrupt(&mut bad);
        let refusal = first.restore(&bad).unwrap_err();
        assert!(matches!(refusal, Refusal::Invalid { .. }), "{refusal}");
    }
}

#[test]
fn a_set_pose_is_used_and_an_invalid_one_rejected() {
    let sensors = SensorConfig {
        hidden: MarkerColor::ALL.map(|m| (m, 4.0, 20.0)).to_vec(),
        ..SensorConfig::nominal(3)
    };
    let run = simulated::run(MotionConfig::nominal(3), &sensors);
    let (before, after) = cut(&run, &sensors, 9.0);
    let mut fusion = fusion();
    let stamp = sensors.epoch.plus_seconds(8.9);
    let truth = run.pose_at(stamp).unwrap();
    let covariance =
        Matrix6::from_diagonal(&nalgebra::Vector6::new(1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6));
    let pose = PoseEstimate { stamp, pose: truth, covariance };
    assert!(matches!(fusion.set_pose(&pose), Err(Refusal::Missing { .. })));
    scoring::run(&mut fusion, before);
    let late = PoseEstimate { stamp: stamp.plus_seconds(-5.0), ..pose.clone() };
    assert!(matches!(fusion.set_pose(&late), Err(Refusal::OutOfReach { .. })));
    let vague = PoseEstimate { covariance: Matrix6::zeros(), ..pose.clone() };
    assert!(matches!(fusion.set_pose(&vague), Err(Refusal::Invalid { .. })));
    let mut far = pose.clone();
    far.pose.translation.vector.x += 100.0;
    assert!(matches!(fusion.set_pose(&far), Err(Refusal::Invalid { .. })));
    assert!(fusion.status().initialized);
    fusion.set_pose(&pose).unwrap();
    let outputs = scoring::run(&mut fusion, after);
    let next = &outputs.odometry[0];
    let age = next.stamp.seconds_since(stamp);
    let truth = run.pose_at(next.stamp).unwrap();
    let error = PoseError::new(&next.world_from_volant, &truth);
    let (p, r) = (error.position, error.rotation);
    // The velocity is not known: within its three sigmas.
    assert!(p.norm() < 3.0 * 1.5 * age + 5e-3 && r.norm() < 0.02, "after {age:.3} s: {p} {r}");
    let c = next.pose_covariance;
    assert!((0..3).all(
        |i| p[i].abs() < 5.0 * c[(i, i)].sqrt() && r[i].abs() < 5.0 * c[(i + 3, i + 3)].sqrt()
    ));
}

#[test]
fn a_pose_set_at_an_older_stamp_finds_the_climber_where_it_was() {
    let sensors = SensorConfig::nominal(2);
    let run = simulated::run(MotionConfig::nominal(2), &sensors);
    for at in [3.0, 5.0, 7.0, 9.0] {
        let (before, after) = cut(&run, &sensors, at);
        let mut fusion = fusion();
        scoring::run(&mut fusion, before);
        let stamp = sensors.epoch.plus_seconds(at - 0.4);
        let pose = run.pose_at(stamp).unwrap();
        let covariance = Matrix6::identity() * 1e-6;
        fusion.set_pose(&PoseEstimate { stamp, pose, covariance }).unwrap();
        let outputs = scoring::run(&mut fusion, after);
        let suspended = (outputs.warnings.iter())
            .filter(|w| matches!(w, pose_fusion::Warning::EncodersSuspended { .. }));
        assert_eq!(suspended.count(), 0, "{at}");
        let early: Vec<_> = (outputs.odometry.into_iter())
            .filter(|o| o.stamp < sensors.epoch.plus_seconds(at + 1.0))
            .collect();
        let score = scoring::score(&early, &run.truth, 0.0);
        assert!(score.position_max() < 5.0, "{at} s: {score}");
    }
}

#[test]
fn a_frozen_filter_ignores_markers_and_a_reset_reinitializes() {
    let sensors = SensorConfig::nominal(1);
    let run = simulated::run(MotionConfig { duration: 8.0, ..MotionConfig::nominal(1) }, &sensors);
    let (before, after) = cut(&run, &sensors, 5.0);
    let mut fusion = fusion();
    scoring::run(&mut fusion, before);
    fusion.freeze(true).unwrap();
    let used = fusion.status().counts.used_markers;
    let (while_frozen, rest) = after.split_at(after.len() / 3);
    let outputs = scoring::run(&mut fusion, while_frozen.to_vec());
    assert_eq!(fusion.status().counts.used_markers, used);
    assert!(
        outputs.records().any(|r| r.outcome == pose_fusion::Outcome::Frozen && r.nis.is_finite())
    );
    // A reset ends freezing.
    fusion.reset();
    assert!(!fusion.status().initialized);
    let outputs = scoring::run(&mut fusion, rest.to_vec());
    let score = scoring::score(&outputs.odometry, &run.truth, 0.0);
    assert!(fusion.status().initialized && score.position_max() < 50.0, "{score}");
}

/// Before, images that a frozen filter compared were used where a late reading was processed after
/// it had been unfrozen, and the ones before them were taken back while it was frozen.
#[test]
fn what_a_frozen_filter_compared_is_not_used_later() {
    let sensors = SensorConfig::nominal(1);
    let run = simulated::run(MotionConfig { duration: 8.0, ..MotionConfig::nominal(1) }, &sensors);
    let (before, after) = cut(&run, &sensors, 5.0);
    let mut fusion = fusion();
    scoring::run(&mut fusion, before);
    let used = fusion.status().position_sigma;
    fusion.freeze(true).unwrap();
    let (while_frozen, rest) = after.split_at(after.len() / 3);
    let is_reading = |input: &Input| matches!(input, Input::Climber(_));
    let late = while_frozen.iter().rfind(|input| is_reading(input)).cloned();
    let in_time = while_frozen.iter().filter(|input| Some(*input) != late.as_ref());
    scoring::run(&mut fusion, in_time.cloned());
    let frozen = fusion.status().position_sigma;
    assert!(frozen > 5.0 * used, "{used} {frozen}");
    fusion.freeze(false).unwrap();
    scoring::run(&mut fusion, late);
    let unfrozen = fusion.status().position_sigma;
    assert!(unfrozen > 0.99 * frozen, "{frozen} {unfrozen}");
    let outputs = scoring::run(&mut fusion, rest.to_vec());
    let score = scoring::score(&outputs.odometry, &run.truth, 0.0);
    assert!(fusion.status().position_sigma < 2.0 * used && score.position_max() < 50.0, "{score}");
}

/// Before, it dropped the pose, which no image could initialize again.
#[test]
fn a_frozen_filter_keeps_its_pose_where_all_messages_stall() {
    let sensors = SensorConfig::nominal(1);
    let run = simulated::run(MotionConfig { duration: 8.0, ..MotionConfig::nominal(1) }, &sensors);
    let (before, after) = cut(&run, &sensors, 5.0);
    let mut fusion = fusion();
    scoring::run(&mut fusion, before);
    fusion.freeze(true).unwrap();
    let late = sensors.epoch.plus_seconds(5.6);
    let after = after.into_iter().filter_map(|mut input| {
        simulated::stamp_of(&mut input).is_some_and(|at| *at > late).then_some(input)
    });
    let outputs = scoring::run(&mut fusion, after);
    assert!(fusion.status().initialized && outputs.odometry.len() > 200);
}
