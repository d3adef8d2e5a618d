//! Neither images nor IMU samples.

use super::*;

/// Encoder readings alone: the status reports at 10 Hz that there is no pose.
#[test]
fn the_status_reports_that_only_encoder_readings_arrive() {
    let run = simulated::run(
        MotionConfig { duration: 8.0, ..MotionConfig::nominal(3) },
        &SensorConfig::nominal(3),
    );
    let epoch = SensorConfig::nominal(3).epoch;
    let absent = |stamp: Stamp| (3.0..5.0).contains(&stamp.seconds_since(epoch));
    let inputs = run.inputs().filter(|input| match input {
        Input::Imu(s) => !absent(s.stamp),
        Input::Markers(s) => !absent(s.stamp),
        _ => true,
    });
    let (mut alone, mut again) = (Vec::new(), None);
    for status in scoring::follow(simulated::config(), inputs).1.status {
        let t = status.stamp.seconds_since(epoch);
        if (3.2..4.95).contains(&t) {
            assert!(status.state == PoseState::Lost && !status.valid, "{status:?}");
            assert!(status.reason.contains("no usable IMU sample and no image"), "{status:?}");
            alone.push(t);
        } else if t > 5.0 && status.valid {
            again.get_or_insert(t);
        }
    }
    assert!((14..=18).contains(&alone.len()), "{alone:?}");
    assert!(again.is_some_and(|t| t < 5.3), "{again:?}");
}

/// The encoders' clock is ahead by longer than a pose may be missing.
#[test]
fn encoders_from_the_future_are_no_silence_of_the_others() {
    let ahead = SensorConfig { climber_clock_ahead: 0.5, ..SensorConfig::nominal(3) };
    let run = simulated::run(MotionConfig { duration: 8.0, ..MotionConfig::nominal(3) }, &ahead);
    let outputs = scoring::follow(simulated::config(), run.inputs()).1;
    assert!(outputs.odometry.len() > 600, "{}", outputs.odometry.len());
    let silent = "no usable IMU sample and no image";
    let silent = outputs.status.iter().filter(|s| s.reason.contains(silent)).count();
    assert_eq!(silent, 0, "of {}", outputs.status.len());
}

/// The computer of camera and IMU is off for half a minute.
#[test]
fn half_a_minute_with_encoder_readings_alone_costs_no_knowledge() {
    let run = simulated::run(
        MotionConfig { duration: 42.0, ..MotionConfig::nominal(3) },
        &SensorConfig::nominal(3),
    );
    let epoch = SensorConfig::nominal(3).epoch;
    let mut fusion = Fusion::new(simulated::rig(), simulated::config());
    let (mut alone, mut lost) = (0, 0);
    let mut outputs = Outputs::default();
    for (at, input) in &run.inputs {
        let t = at.seconds_since(epoch);
        let off = (5.0..36.0).contains(&t);
        if off && !matches!(input, Input::Climber(_)) {
            continue;
        }
        let more = scoring::run(&mut fusion, [input.clone()]);
        if off {
            alone += more.status.len();
            lost += more.status.iter().filter(|s| s.state == PoseState::Lost).count();
        }
        outputs.odometry.extend(more.odometry);
        outputs.warnings.extend(more.warnings);
    }
    let counts = fusion.status().counts;
    assert!(alone > 240 && alone < 320 && lost == alone, "{lost} of {alone}");
    assert_eq!((counts.inputs.overflows, counts.resets.divergences), (0, 0));
    let score = scoring::score(&outputs.odometry, &run.truth, 36.5);
    assert!(score.position_rmse() < 1.0 && score.nees().0 < 6.0, "{score}");
    let offset = fusion.status().time_offset;
    assert!(!offset.searching, "{offset:?}");
}
