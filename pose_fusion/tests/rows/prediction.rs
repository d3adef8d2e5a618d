//! `volant/predicted_odometry` against the truth at its own stamp.

use super::common::{scoring, simulated};
use pose_fusion::{Input, Odometry};
use rig_simulator::{inertial::SensorConfig, motion::MotionConfig};

/// The covariance grows with the motion at hand, calm or fast, and with the horizon.
#[test]
fn predictions_are_consistent_in_calm_and_fast_motion() {
    for (name, motion) in [
        ("nominal", MotionConfig::nominal as fn(u64) -> MotionConfig),
        ("fast", MotionConfig::fast_swing),
    ] {
        for horizon in [0.02, 0.05, 0.1, 0.2] {
            let (mut position, mut rotation, mut rate) = (0.0, 0.0, 0.0);
            for seed in 1..=4 {
                let run = simulated::run(motion(seed), &SensorConfig::nominal(seed));
                let mut config = simulated::config();
                config.tight.prediction_horizon = horizon;
                let (_, outputs) = scoring::follow(config, run.inputs());
                let score = scoring::score(&outputs.predicted, &run.truth, 3.0);
                position += score.nees().0 / 4.0;
                rotation += score.nees().1 / 4.0;
                rate += rate_nees(&run, &outputs.predicted) / 4.0;
            }
            assert!(
                (1.0..6.0).contains(&position) && (1.0..6.0).contains(&rotation) && rate < 6.0,
                "{name} {horizon} s: NEES {position:.2} / {rotation:.2} / {rate:.2}"
            );
        }
    }
}

/// Mean NEES of the angular velocity from 3 s on.
fn rate_nees(run: &simulated::Run, predicted: &[Odometry]) -> f64 {
    let start = run.start();
    let nees = |o: &Odometry| {
        let at = o.stamp.seconds_since(SensorConfig::nominal(1).epoch);
        let error = o.angular_velocity - run.motion.kinematics(at).angular_velocity;
        let covariance = o.twist_covariance.fixed_view::<3, 3>(3, 3).into_owned();
        covariance.try_inverse().map_or(f64::INFINITY, |inverse| error.dot(&(inverse * error)))
    };
    let later = predicted.iter().filter(|o| o.stamp.seconds_since(start) > 3.0);
    let count = later.clone().count();
    later.map(nees).sum::<f64>() / count as f64
}

/// Encoders that step by half a meter: the prediction contains the step as the estimate does.
#[test]
fn a_prediction_contains_what_encoders_and_estimate_disagree_about() {
    let run = simulated::run(MotionConfig::nominal(1), &SensorConfig::nominal(1));
    let mut config = simulated::config();
    config.tight.prediction_horizon = 0.02;
    let step = run.start().plus_seconds(6.0);
    let inputs = run.recording.inputs.into_iter().map(|(at, mut input)| {
        if let (true, Input::Climber(sample)) = (at > step, &mut input) {
            sample.world_from_climber.translation.x += 0.5;
        }
        input
    });
    let (_, outputs) = scoring::follow(config, inputs);
    let sigma = |o: &Odometry| o.pose_covariance[(0, 0)].sqrt();
    let mut disputed = 0;
    for predicted in &outputs.predicted {
        let now = predicted.stamp.plus_seconds(-0.02);
        let Some(estimate) = outputs.odometry.iter().find(|o| o.stamp == now) else { continue };
        disputed += usize::from(sigma(estimate) > 0.4);
        assert!(sigma(predicted) > 0.9 * sigma(estimate), "{predicted:?} {estimate:?}");
    }
    assert!(disputed > 10, "{disputed}");
}
