//! IMU samples that arrive in bursts: with the stamps of their arrival, and late with the right ones.

use super::common::{
    scoring,
    simulated::{self, Run},
};
use pose_fusion::{FusionConfig, Input, Warning};
use rig_model::{ImuSample, score::Score};
use rig_simulator::inertial::SensorConfig;

/// Position RMSE over that with right stamps; with the stamps as they are it is above 13.
const FACTOR: f64 = 1.3;

/// Holds back the IMU's samples until `count` are there, and stamps them then, `on_arrival` apart
/// (s); `None`: they keep their stamps.
fn arrive_in_bursts(inputs: &[Input], count: usize, on_arrival: Option<f64>) -> Vec<Input> {
    let (mut held, mut arrived) = (Vec::new(), Vec::new());
    for input in inputs {
        let Input::Imu(sample) = input else {
            arrived.push(input.clone());
            continue;
        };
        held.push(*sample);
        if held.len() == count {
            arrived.extend(held.drain(..).enumerate().map(|(k, held)| {
                let later = (count - 1 - k) as f64;
                let stamp = on_arrival
                    .map_or(held.stamp, |apart| sample.stamp.plus_seconds(-apart * later));
                Input::Imu(ImuSample { stamp, ..held })
            }));
        }
    }
    arrived
}

/// Returns the score of a run with these inputs, and whether the filter names bursts.
fn follow(inputs: Vec<Input>, run: &Run) -> (Score, bool) {
    let (fusion, outputs) = scoring::follow(FusionConfig::default(), inputs);
    let named = outputs.warnings.iter().any(|w| matches!(w, Warning::ImuBursts { .. }));
    assert_eq!(fusion.status().imu_bursts.is_some(), named);
    (scoring::score(&outputs.odometry, &run.truth, 2.0), named)
}

#[test]
fn samples_that_arrive_in_bursts_cost_no_accuracy_and_are_named() {
    for (seed, motion) in simulated::motions() {
        let run = simulated::run(motion, &SensorConfig::nominal(seed));
        let inputs: Vec<Input> = run.inputs().collect();
        let (usual, named) = follow(inputs.clone(), &run);
        assert!(!named, "seed {seed}: right stamps");
        for (count, apart) in [(2, 1e-4), (5, 1e-4), (8, 1e-4), (2, 0.0), (5, 0.0), (8, 0.0)] {
            let (score, named) = follow(arrive_in_bursts(&inputs, count, Some(apart)), &run);
            let factor = score.position_rmse() / usual.position_rmse();
            let about = format!("seed {seed}, {count} samples, {apart} s apart");
            assert!(named && factor < FACTOR, "{about}: named {named}, {factor:.2} x, {score}");
        }
    }
}

/// A link that delivers the samples late, every 140 ms: images have carried the pose meanwhile, and
/// what they did is computed again. Before, the motion between two bursts began with a sample of no
/// motion: 4.4 mm, NEES 45.
#[test]
fn samples_that_arrive_late_replace_what_images_did_without_them() {
    for (seed, motion) in simulated::motions() {
        let run = simulated::run(motion, &SensorConfig::nominal(seed));
        let inputs: Vec<Input> = run.inputs().collect();
        let (score, named) = follow(arrive_in_bursts(&inputs, 14, None), &run);
        let (position, rotation) = score.nees();
        let right = !named && score.position_rmse() < 1.0 && position < 4.0 && rotation < 4.0;
        assert!(right, "seed {seed}: named {named}, {score}");
    }
}
