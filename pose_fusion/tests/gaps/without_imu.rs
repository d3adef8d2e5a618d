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
            let truth = run.pose_at(o.stamp).filter(|_| at > LOST + 1.0)?;
            let status = outputs.status.iter().find(|status| status.stamp == o.stamp)?;
            Some((at, o.world_from_volant.rotation.angle_to(&truth.rotation), status.clone()))
        };
        outputs.odometry.iter().filter_map(pose).collect::<Vec<_>>()
    };
    (1..=4).flat_map(run).collect()
}

/// Number of poses, of those that are valid, of those with the wrong tilt, and of those with both.
fn counted(poses: &[Pose]) -> [usize; 4] {
    let count = |of: fn(&Pose) -> bool| poses.iter().filter(|pose| of(pose)).count();
    [
        count(|_| true),
        count(|p| p.2.valid),
        count(|p| p.1 > WRONG),
        count(|p| p.2.valid && p.1 > WRONG),
    ]
}

#[test]
fn four_markers_decide_between_a_tilt_and_its_mirror_image() {
    let [all, valid, wrong, _] = counted(&poses(|_| false));
    assert!(valid as f64 > 0.95 * all as f64 && wrong == 0, "{valid} of {all}, {wrong} wrong");
}

/// Before, the wrong tilt was valid.
#[test]
fn the_mirrored_tilt_that_three_markers_fit_is_not_valid() {
    let poses = poses(|at| at > LOST);
    let [_, _, wrong, both] = counted(&poses);
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
    assert!(counted(&three)[2] > 0, "nothing to correct");
    let [all, _, wrong, _] = counted(&four);
    assert!(all > 40 && wrong == 0, "{wrong} of {all}");
}

/// Nine seconds of a swing with inputs as `change` makes them of the time of their arrival, s;
/// `None` for those that do not come.
fn changed(change: impl Fn(f64, Input) -> Option<Input>) -> (simulated::Run, scoring::Outputs) {
    let sensors = SensorConfig::nominal(1);
    let motion = MotionConfig { duration: END, still_until: -10.0, ..MotionConfig::nominal(1) };
    let run = simulated::run(motion, &sensors);
    let inputs: Vec<Input> =
        run.timed().into_iter().filter_map(|(at, input)| change(at, input)).collect();
    let (_, outputs) = scoring::follow(FusionConfig::default(), inputs);
    (run, outputs)
}

fn earlier(mut input: Input, seconds: f64) -> Input {
    if let Some(stamp) = simulated::stamp_of(&mut input) {
        *stamp = stamp.plus_seconds(-seconds);
    }
    input
}

/// Before, it was published as zero with the standard deviation of a gyroscope.
#[test]
fn the_angular_velocity_is_as_uncertain_as_images_leave_it() {
    let (run, outputs) =
        changed(|at, input| (at <= LOST || !matches!(input, Input::Imu(_))).then_some(input));
    let after = run.start().plus_seconds(LOST + 1.0);
    let nees: Vec<f64> = (outputs.odometry.iter().filter(|o| o.stamp > after))
        .filter_map(|o| {
            let truth =
                run.motion.kinematics(o.stamp.seconds_since(SensorConfig::nominal(1).epoch));
            let error = o.angular_velocity - truth.angular_velocity;
            let covariance = o.twist_covariance.fixed_view::<3, 3>(3, 3).into_owned();
            Some(error.dot(&(covariance.try_inverse()? * error)))
        })
        .collect();
    let mean = nees.iter().sum::<f64>() / nees.len() as f64;
    assert!(nees.len() > 60 && mean < 6.0, "{mean} of {}", nees.len());
}

/// A sensor or its driver may hang while it goes on publishing.
#[test]
fn an_imu_that_repeats_one_sample_leaves_the_pose_to_the_images_and_is_named() {
    let held = std::cell::Cell::new(None);
    let (run, outputs) = changed(|at, mut input| {
        if let Input::Imu(sample) = &mut input {
            let values = held.get().filter(|_| at > LOST);
            let [force, rate] = values.unwrap_or([sample.specific_force, sample.angular_velocity]);
            (sample.specific_force, sample.angular_velocity) = (force, rate);
            held.set(Some([force, rate]));
        }
        Some(input)
    });
    let from = run.start().plus_seconds(LOST + 1.5);
    let late: Vec<_> = outputs.status.iter().filter(|s| s.stamp > from).collect();
    assert!(late.len() > 100);
    let named = |s: &PoseStatus| s.reason.starts_with("the IMU repeats one sample for ");
    assert!(late.iter().all(|s| s.state == PoseState::VisionOnly && named(s)), "{:?}", late[0]);
    for o in outputs.odometry.iter().filter(|o| o.stamp > from) {
        let truth = run.pose_at(o.stamp).unwrap();
        let off = (o.world_from_volant.translation.vector - truth.translation.vector).norm();
        assert!(off < 0.02, "{off} m");
    }
}

/// Before, no pose was published for as long as the step.
#[test]
fn clocks_that_are_set_back_are_followed() {
    let (run, outputs) = changed(|at, input| match input {
        Input::Imu(_) if at > LOST => None,
        input if at > 6.0 => Some(earlier(input, 3.0)),
        input => Some(input),
    });
    let start = run.start();
    let second = outputs.odometry.iter().position(|o| o.stamp.seconds_since(start) > 5.8).unwrap();
    let set_back = |o: &&pose_fusion::Odometry| o.stamp.seconds_since(start) < 5.8;
    let count = outputs.odometry[second..].iter().filter(set_back).count();
    assert!(count > 45, "{count} poses of 54 that are 0.8 s or more after the step");
}

/// Before, its samples, which are of no use, made images and encoders wait for it.
#[test]
fn an_imu_that_starts_with_a_clock_behind_leaves_the_pose_to_the_images() {
    let (_, outputs) = changed(|at, input| match input {
        Input::Imu(_) if at < 3.0 => None,
        input @ Input::Imu(_) => Some(earlier(input, 6.0)),
        input => Some(input),
    });
    let last = outputs.odometry.last().unwrap().stamp;
    let late = outputs.status.iter().filter(|status| last.seconds_since(status.stamp) < 3.0);
    let valid = late.clone().filter(|s| s.valid && s.state == PoseState::VisionOnly).count();
    assert!(valid > 60 && valid as f64 > 0.9 * late.count() as f64, "{valid} valid poses");
}
