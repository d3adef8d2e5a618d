//! A pose from images alone: three markers fit a tilt and its mirror image, four decide.

use super::common::{scoring, simulated};
use pose_fusion::{FusionConfig, Input, PoseState, PoseStatus};
use rig_model::{MarkerColor, MarkerObservation};
use rig_simulator::{inertial::SensorConfig, motion::MotionConfig};

/// No IMU sample comes from this time on, s.
const LOST: f64 = 4.0;
/// Length of a run, s.
const END: f64 = 9.0;
/// A pose that is off by more than this has the wrong tilt, rad.
const WRONG: f64 = 0.3;

/// A pose: time, s; rotation error, rad; status.
type Pose = (f64, f64, PoseStatus);

/// Poses from a second after [`LOST`] on, of four runs with a swing of 30°. The red marker is
/// hidden at the times (s) for which `hidden` is true.
fn poses(hidden: fn(f64) -> bool) -> Vec<Pose> {
    let run = |seed: u64| {
        let motion = MotionConfig {
            duration: END,
            swing: 0.5,
            frequency: 0.8,
            still_until: -10.0,
            ..MotionConfig::nominal(seed)
        };
        let sensors = SensorConfig::nominal(seed);
        let run = simulated::run(motion, &sensors);
        let inputs = run.inputs.iter().filter_map(|(at, input)| {
            let at = at.seconds_since(sensors.epoch);
            let mut input = input.clone();
            if let (Input::Markers(sample), true) = (&mut input, hidden(at)) {
                sample.markers[MarkerColor::Red] = MarkerObservation::lost(1);
            }
            (at <= LOST || !matches!(input, Input::Imu(_))).then_some(input)
        });
        let (_, outputs) = scoring::follow(FusionConfig::default(), inputs);
        let pose = |o: &pose_fusion::Odometry| {
            let at = o.stamp.seconds_since(sensors.epoch);
            let truth = scoring::pose_at(&run.truth, o.stamp).filter(|_| at > LOST + 1.0)?;
            let status = outputs.status.iter().find(|status| status.stamp == o.stamp)?;
            Some((at, o.world_from_volant.rotation.angle_to(&truth.rotation), status.clone()))
        };
        outputs.odometry.iter().filter_map(pose).collect::<Vec<_>>()
    };
    (1..=4).flat_map(run).collect()
}

/// Number of poses, of those that are valid, of those with the wrong tilt, and of those with both.
fn counted(name: &str, poses: &[Pose]) -> [usize; 4] {
    let count = |of: fn(&Pose) -> bool| poses.iter().filter(|pose| of(pose)).count();
    let found = [
        count(|_| true),
        count(|p| p.2.valid),
        count(|p| p.1 > WRONG),
        count(|p| p.2.valid && p.1 > WRONG),
    ];
    println!("{name}: poses, valid, of the wrong tilt, both: {found:?}");
    found
}

#[test]
fn four_markers_decide_between_a_tilt_and_its_mirror_image() {
    let [all, valid, wrong, _] = counted("four markers", &poses(|_| false));
    assert!(valid as f64 > 0.95 * all as f64 && wrong == 0);
}

/// Before, the wrong tilt was valid.
#[test]
fn the_mirrored_tilt_that_three_markers_fit_is_not_valid() {
    let poses = poses(|at| at > LOST);
    let [_, _, wrong, both] = counted("three markers", &poses);
    assert!(wrong > 0, "nothing to detect");
    assert_eq!(both, 0);
    let lost = poses.iter().find(|(_, _, status)| status.state == PoseState::Lost).unwrap();
    assert!(lost.2.reason.contains("two tilts"), "{}", lost.2.reason);
}

#[test]
fn a_single_image_with_four_markers_corrects_the_tilt() {
    // One image of nine.
    let poses = poses(|at| at > LOST && (at / 0.3).fract() > 0.11);
    let (four, three): (Vec<Pose>, Vec<Pose>) =
        poses.into_iter().partition(|(_, _, status)| status.markers_used == 4);
    assert!(counted("three markers", &three)[2] > 0, "nothing to correct");
    let [all, _, wrong, _] = counted("four markers", &four);
    assert!(all > 40 && wrong == 0);
}
