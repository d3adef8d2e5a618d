//! Clocks that are set: of all sensors, or of the IMU or the camera alone.

use super::*;

/// A clock that is set back by less than a second after three seconds: of all sensors, or of the
/// IMU alone, whose samples were ahead of the images by that before.
#[test]
fn a_clock_set_back_by_less_than_a_second_starts_again() {
    let run = recording();
    let step = run.start().plus_seconds(3.0);
    for (back, imu_alone) in [(0.05, true), (0.2, true), (0.05, false), (0.2, false), (0.7, false)]
    {
        let mut fusion = Fusion::new(simulated::rig(), FusionConfig::default());
        let moved = |at: Stamp, input: &Input| {
            let moves = at < step && (!imu_alone || matches!(input, Input::Imu(_)));
            shifted(input, if moves { back } else { 0.0 })
        };
        let (before, after): (Vec<_>, Vec<_>) = run.inputs.iter().partition(|(at, _)| *at < step);
        scoring::run(&mut fusion, before.iter().map(|(at, input)| moved(*at, input)));
        let outputs = scoring::run(&mut fusion, after.iter().map(|(at, input)| moved(*at, input)));
        let jumps = fusion.status().counts.resets.time_jumps;
        let score = scoring::score(&outputs.odometry, &run.truth, 3.15);
        // The filter knows of the step after four IMU samples.
        let noticed = step.plus_seconds(0.1);
        for visual in outputs.visual.iter().filter(|visual| visual.stamp > noticed) {
            let truth = run.pose_at(visual.stamp).unwrap();
            let error = PoseError::new(&visual.pose, &truth).position.norm();
            assert!(error < 0.03, "one image alone {back} {imu_alone}: {error} m");
        }
        let about = format!("{back} s, the IMU's alone: {imu_alone}");
        assert_eq!(jumps, 1, "{about}");
        assert!(outputs.odometry.len() > 200 && score.nees().0 < 6.0, "{about}: {score}");
        let warned =
            |w: &Warning| matches!(w, Warning::TimeJump { by_s } if (by_s - back).abs() < 0.02);
        assert!(outputs.warnings.iter().any(warned), "{about}");
    }
}

/// From two seconds on the IMU's clock is ahead by `by`, or behind, or that of camera and encoders
/// is: the time offset follows within 1.5 s, also beyond the 0.3 s that are searched.
#[test]
fn a_step_of_one_clock_moves_the_time_offset() {
    let run = recording();
    let step = run.start().plus_seconds(2.0);
    for (by, imu) in [
        (0.08, true),
        (0.2, true),
        (0.5, true),
        (-0.2, true),
        (-0.5, true),
        (0.2, false),
        (0.45, false),
        (-0.2, false),
        (-0.5, false),
    ] {
        let mut fusion = Fusion::new(simulated::rig(), FusionConfig::default());
        let (before, after): (Vec<_>, Vec<_>) = run.inputs.iter().partition(|(at, _)| *at < step);
        scoring::run(&mut fusion, before.iter().map(|(_, input)| input.clone()));
        let after = after.iter().map(|(_, input)| {
            let moves = imu == matches!(input, Input::Imu(_));
            shifted(input, if moves { by } else { 0.0 })
        });
        let outputs = scoring::run(&mut fusion, after);
        let moved = if imu { by } else { 0.0 };
        for visual in outputs.visual.iter().filter(|v| v.stamp > step.plus_seconds(1.2)) {
            let shift = if imu { 0.0 } else { -by };
            let truth = run.pose_at(visual.stamp.plus_seconds(shift));
            let error = truth.map(|truth| PoseError::new(&visual.pose, &truth).position.norm());
            assert!(
                error.is_none_or(|error| error < 0.03),
                "one image alone {by} {imu}: {error:?}"
            );
        }
        let (mut score, mut wrong) = (scoring::Score::default(), 0.0f64);
        for (odometry, status) in outputs.odometry.iter().zip(valid(&outputs)) {
            let at = odometry.stamp.plus_seconds(-moved);
            let truth = run.pose_at(at).unwrap();
            let since = at.seconds_since(step);
            if since > 1.5 {
                score.add(&odometry.world_from_volant, &odometry.pose_covariance, &truth);
            } else if status {
                let error = PoseError::new(&odometry.world_from_volant, &truth).position.norm();
                wrong = wrong.max(error);
            }
        }
        let offset = fusion.status().time_offset.offset;
        let expected = if imu { by } else { -by };
        assert!((offset - expected).abs() < 2e-3, "{by} {imu}: {offset}");
        assert!(score.position_rmse() < 2.5 && score.nees().0 < 6.0, "{by} {imu}: {score}");
        assert!(wrong < 0.15, "{by} {imu}: valid and {wrong} m off");
        let warned = |w: &Warning| matches!(w, Warning::ClockStep { by_s } if (by_s - expected).abs() < 0.02);
        assert!(outputs.warnings.iter().any(warned), "{by} {imu}");
    }
}

/// A frozen filter keeps its pose through a step of the IMU's clock and follows it afterwards; a
/// reset takes the clocks to be those of the configuration.
#[test]
fn a_frozen_filter_follows_a_step_of_a_clock_afterwards() {
    let run = recording();
    let start = run.start();
    let mut fusion = Fusion::new(simulated::rig(), FusionConfig::default());
    let mut frozen = false;
    for (at, input) in &run.inputs {
        let since = at.seconds_since(start);
        if frozen != (1.8..3.0).contains(&since) {
            frozen = !frozen;
            fusion.freeze(frozen).unwrap();
        }
        let steps = since >= 2.0 && matches!(input, Input::Imu(_));
        scoring::run(&mut fusion, [shifted(input, if steps { 0.3 } else { 0.0 })]);
        assert!(!frozen || fusion.status().initialized, "{since}");
    }
    let status = fusion.status();
    assert_eq!((status.counts.resets.clock_steps, status.counts.resets.time_jumps), (1, 0));
    assert_eq!(status.time_offset.configured, 0.0);
    assert!((status.time_offset.offset - 0.3).abs() < 2e-3, "{:?}", status.time_offset);
    fusion.reset();
    assert_eq!(fusion.status().time_offset.offset, 0.0);
}

/// Whether each odometry was called valid.
fn valid(outputs: &scoring::Outputs) -> Vec<bool> {
    let status = |stamp| outputs.status.iter().find(|s| s.stamp == stamp);
    outputs.odometry.iter().map(|o| status(o.stamp).is_some_and(|s| s.valid)).collect()
}

#[test]
fn a_looped_recording_reinitializes() {
    let run = recording();
    let mut fusion = Fusion::new(simulated::rig(), FusionConfig::default());
    let first = scoring::run(&mut fusion, run.inputs());
    let second = scoring::run(&mut fusion, run.inputs());
    assert_eq!(fusion.status().counts.resets.time_jumps, 1);
    assert!(second.warnings.iter().any(|w| matches!(w, Warning::TimeJump { .. })));
    let score = scoring::score(&second.odometry, &run.truth, 1.0);
    assert!(score.position_rmse() < 1.2, "{score}");
    assert!(second.odometry.len() + 10 > first.odometry.len());
}

/// Before, everything behind a clock that was set back was dropped, and kept in memory until then.
#[test]
fn what_comes_behind_a_clock_that_was_set_back_is_smoothed() {
    let run = recording();
    let mut fusion = Fusion::new(simulated::rig(), FusionConfig::default());
    fusion.keep_for_smoothing();
    let mut count = 0;
    for back in [0.0, 1000.0] {
        let inputs = run.inputs.iter().map(|(_, input)| shifted(input, -back));
        count += scoring::run(&mut fusion, inputs).odometry.len();
    }
    let smoothed = [fusion.smoothed(false), fusion.smoothed(true)].map(|part| part.len());
    assert!(smoothed[0] > 500 && smoothed[0] + smoothed[1] + 20 > count, "{smoothed:?} of {count}");
}

/// Clocks that were never synchronized: the reason names them, instead of the markers.
#[test]
fn clocks_that_are_apart_from_the_start_are_named() {
    let run = recording();
    for by in [-3600.0, -3.0, 3.0, 3600.0] {
        let mut fusion = Fusion::new(simulated::rig(), FusionConfig::default());
        let inputs = run.inputs.iter().map(|(_, input)| {
            shifted(input, if matches!(input, Input::Imu(_)) { by } else { 0.0 })
        });
        let outputs = scoring::run(&mut fusion, inputs);
        let side = if by > 0.0 { "before" } else { "after" };
        let reason = fusion.missing();
        let named = reason.contains("synchronize the clocks") && reason.contains(side);
        assert!(outputs.odometry.is_empty() && named, "{by} s: {reason}");
    }
}
