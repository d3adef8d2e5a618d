//! IMU samples that arrive in bursts: with the stamps of their arrival, and late with the right
//! ones.

use super::common::{scoring, simulated};
use pose_fusion::{FusionConfig, Warning};
use rig_model::score::Score;
use rig_simulator::{inertial::SensorConfig, recording::Recording};

/// Position RMSE over that with right stamps; with the stamps as they are it is above 13.
const FACTOR: f64 = 1.3;

/// Returns the score of a recording, and whether the filter names bursts.
fn follow(recording: &Recording) -> (Score, bool) {
    let (fusion, outputs) = scoring::follow(FusionConfig::default(), recording.inputs());
    let named = outputs.warnings.iter().any(|w| matches!(w, Warning::ImuBursts { .. }));
    assert_eq!(fusion.status().imu_bursts.is_some(), named);
    (scoring::score(&outputs.odometry, &recording.truth, 2.0), named)
}

/// The same of one whose samples arrive in bursts; see [`Recording::arrive_in_bursts`].
fn in_bursts(recording: &Recording, count: usize, apart: Option<f64>) -> (Score, bool) {
    let mut late = recording.clone();
    late.arrive_in_bursts(count, apart);
    follow(&late)
}

#[test]
fn samples_that_arrive_in_bursts_cost_no_accuracy_and_are_named() {
    for (seed, motion) in simulated::motions() {
        let run = simulated::run(motion, &SensorConfig::nominal(seed));
        let (usual, named) = follow(&run);
        assert!(!named, "seed {seed}: right stamps");
        for (count, apart) in [(2, 1e-4), (5, 1e-4), (8, 1e-4), (2, 0.0), (5, 0.0), (8, 0.0)] {
            let (score, named) = in_bursts(&run, count, Some(apart));
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
        let (score, named) = in_bursts(&run, 14, None);
        let (position, rotation) = score.nees();
        let right = !named && score.position_rmse() < 1.0 && position < 4.0 && rotation < 4.0;
        assert!(right, "seed {seed}: named {named}, {score}");
    }
}
