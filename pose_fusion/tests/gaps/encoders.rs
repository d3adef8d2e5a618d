//! Encoders that are silent, late, or stand while the IMU is silent.

use super::*;
use nalgebra::{Isometry3, Vector3};
use pose_fusion::ekf::consider::CLIMBER_OFFSET;

/// The climber stands until then, s.
const DRIVES: f64 = 5.0;
const END: f64 = 9.0;
/// Speed of the climber, m/s.
const SPEED: f64 = 0.3;

/// A climber that sets off with about 1 m/s², and the platform hangs freely below it.
fn drive(seed: u64, ramp: f64) -> MotionConfig {
    MotionConfig {
        duration: END,
        still_until: DRIVES,
        ramp,
        climber_speed: SPEED,
        swing: 0.0,
        wobble: 0.0,
        yaw: 0.0,
        free: true,
        ..MotionConfig::nominal(seed)
    }
}

/// Largest error (m), and its square over the variance, of the poses from 3 s on; `change` makes
/// the inputs of the time of their arrival, s, `None` for those that do not come.
fn worst(
    motion: impl Fn(u64) -> MotionConfig,
    change: impl Fn(f64, Input) -> Option<Input>,
) -> (f64, f64) {
    let (mut error, mut nees) = (0.0_f64, 0.0_f64);
    for seed in 1..=4 {
        let run = simulated::run(motion(seed), &SensorConfig::nominal(seed));
        let inputs = run.timed().into_iter().filter_map(|(at, input)| change(at, input));
        let mut config = FusionConfig::default();
        // Known: at rest it is not found.
        config.tight.clock.camera_sigma = 0.0;
        let (_, outputs) = scoring::follow(config, inputs);
        let start = run.start();
        for o in outputs.odometry.iter().filter(|o| o.stamp.seconds_since(start) > 3.0) {
            let Some(truth) = run.pose_at(o.stamp) else { continue };
            let off: Vector3<f64> =
                o.world_from_volant.translation.vector - truth.translation.vector;
            let covariance = o.pose_covariance.fixed_view::<3, 3>(0, 0).into_owned();
            error = error.max(off.norm());
            nees = nees.max(off.dot(&(covariance.try_inverse().unwrap() * off)));
        }
        println!("seed {seed}: {:.1} mm, {nees:.1}", 1e3 * error);
    }
    (error, nees)
}

fn encoders(input: &Input) -> bool {
    matches!(input, Input::Climber(_))
}

/// Before, images contradicted a climber that was assumed to stand: the platform seemed to be
/// struck, and was lost.
#[test]
fn a_climber_that_sets_off_while_its_encoders_are_silent_moves_no_platform() {
    let silent = DRIVES - 0.1..DRIVES + 1.4;
    let (error, nees) = worst(
        |seed| drive(seed, 0.7),
        |at, input| (!encoders(&input) || !silent.contains(&at)).then_some(input),
    );
    assert!(error < 0.03 && nees < 40.0, "{error} m, NEES {nees}");
}

/// Before, they were excluded for ever, and the platform drifted away.
#[test]
fn late_encoders_bound_the_drift_by_their_delay() {
    let late = 0.1;
    let (error, _) = worst(
        |seed| drive(seed, 1.5),
        |at, mut input| {
            if encoders(&input) {
                // Every third.
                if (at * 50.0 / 3.0).fract() > 0.34 {
                    return None;
                }
                let stamp = simulated::stamp_of(&mut input)?;
                *stamp = stamp.plus_seconds(late);
            }
            Some(input)
        },
    );
    // The covariance contains `clock.climber_sigma`, 2 ms.
    assert!(error < 0.1, "{error} m");
}

/// Before, encoders that stood were taken for stuck where images alone do not follow the platform.
#[test]
fn standing_encoders_are_right_while_the_imu_is_silent() {
    let motion =
        MotionConfig { climber_speed: 0.0, climber_turn_rate: 0.0, ..MotionConfig::fast_swing(1) };
    let run = simulated::run(motion, &SensorConfig::nominal(1));
    let silent = 4.0..5.5;
    let inputs = run.timed().into_iter().filter_map(|(at, input)| match input {
        Input::Imu(_) => (!silent.contains(&at)).then_some(input),
        Input::Markers(_) => ((at * 10.0).fract() < 0.34).then_some(input),
        _ => Some(input),
    });
    let (_, outputs) = scoring::follow(FusionConfig::default(), inputs);
    let stuck = |w: &Warning| matches!(w, Warning::EncodersStuck { .. });
    assert_eq!(outputs.warnings.iter().find(|w| stuck(w)), None);
}

/// Before, it was valid at once: with a wrong unit the adopted encoders contradict again.
#[test]
fn a_pose_with_adopted_encoders_must_hold_for_a_second_before_it_is_valid() {
    let run = simulated::run(MotionConfig::nominal(1), &SensorConfig::nominal(1));
    let inputs = run.timed().into_iter().map(|(at, mut input)| {
        if let Input::Climber(sample) = &mut input
            && at > 4.0
        {
            sample.world_from_climber.translation.x += 0.3;
        }
        input
    });
    let (_, outputs) = scoring::follow(FusionConfig::default(), inputs);
    let adopted: Vec<_> = (outputs.warnings.iter())
        .filter_map(|w| if let Warning::EncoderStep { stamp } = w { Some(*stamp) } else { None })
        .collect();
    let [adopted] = adopted[..] else { panic!("adopted at {adopted:?}") };
    // Those before were published when the reading arrived.
    let [_, delay] = SensorConfig::nominal(1).climber_delay;
    for s in outputs.status.iter().filter(|s| s.stamp > adopted.plus_seconds(delay)) {
        let after = s.stamp.seconds_since(adopted);
        assert_eq!(s.valid, after > 1.0, "{after:.2} s: {s:?}");
    }
}

/// Encoders in wrong directions: the pose follows them the wrong way, and only the changes of the
/// climber's speed contradict them. Before, the pose was valid, up to a meter off.
#[test]
fn encoders_in_wrong_directions_are_named_and_the_pose_is_lost() {
    type Wrong = fn(&mut Isometry3<f64>);
    let wrong: [(Wrong, Option<&str>); 6] = [
        (|_| {}, None),
        (|pose| pose.translation.vector.x *= -1.0, Some("`rail_x` is reversed")),
        (|pose| pose.translation.vector.y *= -1.0, Some("`rail_y` is reversed")),
        (
            |pose| pose.translation.vector.component_mul_assign(&Vector3::new(-1.0, -1.0, 1.0)),
            Some("both rails are reversed"),
        ),
        (
            |pose| {
                pose.translation.vector.swap_rows(0, 1);
                pose.translation.vector.x *= -1.0;
            },
            Some("exchanged and one reversed"),
        ),
        (|pose| pose.rotation = pose.rotation.inverse(), Some("`turn` is reversed")),
    ];
    for (change, named) in wrong {
        for seed in 1..=2 {
            let nominal = MotionConfig::nominal(seed);
            let motion = MotionConfig { duration: 20.0, climber_speed: 0.5, ..nominal };
            let mut run = simulated::run(motion, &SensorConfig::nominal(seed));
            for (_, input) in &mut run.inputs {
                if let Input::Climber(sample) = input {
                    change(&mut sample.world_from_climber);
                }
            }
            let (fusion, outputs) = scoring::follow(FusionConfig::default(), run.inputs());
            let status = fusion.status();
            let about = format!("seed {seed}, {named:?}: {:?}", status.encoders);
            let found = status.encoders.wrong_directions;
            let Some(named) = named else {
                assert_eq!(found, None, "{about}");
                continue;
            };
            let unclear = "the rails are reversed or exchanged";
            let names = |text: &str| {
                text.contains(named) || (!named.contains("turn") && text.contains(unclear))
            };
            assert!(found.is_some_and(names), "{about}");
            assert!(names(&outputs.status.last().unwrap().reason), "{about}");
            let reported = outputs.status.iter().position(|status| names(&status.reason)).unwrap();
            let after = outputs.status[reported].stamp.seconds_since(run.start());
            assert!(after < 12.0, "{about}: after {after:.1} s");
            assert!(outputs.status[reported..].iter().all(|s| !s.valid), "{about}: valid again");
        }
    }
}

/// A reversed rail on a climber that drives slowly: the pose follows the encoders and tilts with them.
/// Before, it was valid and up to 0.9 m off throughout the run for half of the seeds.
#[test]
fn a_reversed_rail_of_a_slow_climber_is_found_within_fifteen_seconds() {
    for axis in 0..2 {
        for seed in 46..52 {
            let motion = MotionConfig { duration: 25.0, ..MotionConfig::nominal(seed) };
            let run = simulated::run(motion, &SensorConfig::nominal(seed));
            let inputs = run.changed(|_, input| {
                if let Input::Climber(sample) = input {
                    sample.world_from_climber.translation.vector[axis] *= -1.0;
                }
            });
            let (_, outputs) = scoring::follow(FusionConfig::default(), inputs);
            let late =
                |status: &&pose_fusion::PoseStatus| status.stamp.seconds_since(run.start()) > 15.5;
            let valid = outputs.status.iter().filter(late).filter(|status| status.valid).count();
            assert_eq!(valid, 0, "axis {axis}, seed {seed}");
        }
    }
}

/// Encoders whose stamps are late or early beside the images'. Before, the pose was valid and wrong
/// by speed times delay with a sigma below 2 mm, unless the climber was fast.
#[test]
fn late_and_early_stamps_of_the_encoders_widen_the_covariance_and_are_named() {
    // Seed, delay (s), and poses of the last 20 s that may be beyond three sigma: the longer the
    // delay, the less of it is found.
    let rows = [
        (1, 0.0, 0),
        (2, 0.0, 0),
        (1, 0.07, 20),
        (2, -0.07, 20),
        (3, -0.15, 20),
        (3, 0.15, 20),
        (4, 0.4, 200),
    ];
    for (seed, delay, allowed) in rows {
        let motion = MotionConfig { duration: 40.0, ..MotionConfig::nominal(900 + seed) };
        let run = simulated::run(motion, &SensorConfig::nominal(seed));
        let inputs = run.inputs().map(|mut input| {
            if let Input::Climber(sample) = &mut input {
                sample.stamp = sample.stamp.plus_seconds(delay);
            }
            input
        });
        let (fusion, outputs) = scoring::follow(FusionConfig::default(), inputs);
        let status = fusion.status();
        let about = format!("seed {seed}, {delay} s: {}", status.file_errors.transpose());
        assert_eq!(status.encoders.wrong_directions, None, "{about}");
        let found = status.file_errors[CLIMBER_OFFSET];
        if delay == 0.0 {
            assert_eq!(found, 0.0, "{about}");
            continue;
        }
        assert!(found * delay < 0.0, "{about}");
        let begin = SensorConfig::nominal(0).epoch.plus_seconds(20.0);
        let beyond = (outputs.odometry.iter().filter(|o| o.stamp > begin)).filter(|o| {
            let truth = run.truth.at(o.stamp).unwrap().world_from_volant.translation;
            let error = (o.world_from_volant.translation.vector - truth.vector).norm();
            error > 3.0 * o.pose_covariance.fixed_view::<3, 3>(0, 0).trace().sqrt()
        });
        let beyond = beyond.count();
        assert!(beyond < allowed, "{about}: {beyond} of 2000 beyond 3 sigma");
        let lost = outputs.status.iter().filter(|s| s.state == PoseState::Lost).count();
        // Of 4000 statuses.
        let most = if delay > 0.2 { 20 } else { 0 };
        assert!(lost <= most, "{about}: {lost} lost");
    }
}
