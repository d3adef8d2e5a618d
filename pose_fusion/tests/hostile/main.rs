//! Invalid, late, repeated, reordered input, or input of another time: rejected and counted,
//! without effect on later output.
mod clocks;
#[path = "../common/mod.rs"]
mod common;

use common::{scoring, simulated};
use pose_fusion::{
    Fusion, FusionConfig, Input, Odometry, Source, Warning, config::CalibrationSigmas,
};
use rig_model::{ClimberSample, ImuSample, Stamp, score::PoseError, topics};
use rig_simulator::{inertial::SensorConfig, motion::MotionConfig};

fn recording() -> simulated::Run {
    simulated::run(
        MotionConfig { duration: 6.0, ..MotionConfig::nominal(4) },
        &SensorConfig::nominal(4),
    )
}

fn shifted(input: &Input, seconds: f64) -> Input {
    let mut input = input.clone();
    if let Some(stamp) = simulated::stamp_of(&mut input) {
        *stamp = stamp.plus_seconds(seconds);
    }
    input
}

#[test]
fn the_same_inputs_give_the_same_outputs() {
    let run = recording();
    let once = || scoring::follow(FusionConfig::default(), run.inputs()).1.odometry;
    assert_eq!(once(), once());
}

#[test]
fn an_input_without_a_stamp_is_named_and_has_no_effect() {
    let run = recording();
    let with_copies = |copies: bool| {
        let inputs = run.inputs.iter().flat_map(|(at, input)| {
            let mut unset = input.clone();
            if let Some(stamp) = simulated::stamp_of(&mut unset) {
                *stamp = Stamp::default();
            }
            let copy = copies && !matches!(input, Input::Camera(_)) && at.as_nanos() % 3 != 0;
            copy.then_some(unset).into_iter().chain([input.clone()])
        });
        let (fusion, outputs) = scoring::follow(FusionConfig::default(), inputs);
        (outputs, fusion.status().counts.rejected)
    };
    let (clean, _) = with_copies(false);
    let (outputs, rejected) = with_copies(true);
    assert_eq!(outputs.odometry, clean.odometry);
    assert!(rejected.imu > 100 && rejected.images > 20 && rejected.climber > 50, "{rejected:?}");
    for (source, topic) in [
        (Source::Imu, topics::IMU),
        (Source::Image, topics::MARKERS),
        (Source::Encoders, topics::CLIMBER_TRANSFORM),
    ] {
        let expected = Warning::NoStamp { from: source };
        assert!(expected.to_string().contains(topic) && outputs.warnings.contains(&expected));
    }
}

#[test]
fn invalid_input_is_rejected_and_has_no_effect() {
    let run = recording();
    let clean = scoring::follow(FusionConfig::default(), run.inputs()).1.odometry;
    let mut inputs = Vec::new();
    for (n, (_, input)) in run.inputs.iter().enumerate() {
        let mut broken = input.clone();
        if n % 5 == 0 {
            match &mut broken {
                Input::Imu(s) if n % 2 == 0 => s.specific_force.y = f64::NAN,
                Input::Imu(s) => s.angular_velocity.x = f64::INFINITY,
                Input::Climber(s) => s.world_from_climber.translation.vector.x = f64::NAN,
                Input::Markers(s) => {
                    // Its own stamp, or the good one would be its duplicate.
                    s.stamp = s.stamp.plus_seconds(1e-6);
                    for m in &mut s.markers.0 {
                        m.centroid.x = f64::NAN;
                    }
                }
                Input::Camera(_) => {}
            }
            inputs.push(broken);
        }
        inputs.push(input.clone());
        if n % 7 == 0 && n > 0 {
            inputs.push(input.clone()); // a duplicate
        }
        if n % 211 == 210 {
            inputs.push(shifted(input, -100.0)); // from the past
            inputs.push(shifted(input, 1000.0)); // from the future
        }
    }
    let (fusion, outputs) = scoring::follow(FusionConfig::default(), inputs);
    let status = fusion.status();
    assert!(
        status.counts.rejected.imu > 50
            && status.counts.rejected.climber > 20
            && status.counts.rejected.markers > 20,
        "{status:?}"
    );
    assert!(status.counts.inputs.duplicates > 50);
    assert_eq!(status.counts.resets.time_jumps, 0);
    // The broken image shows no markers, so nothing changes but rounding of one more step.
    assert_eq!(outputs.odometry.len(), clean.len());
    let worst = outputs
        .odometry
        .iter()
        .zip(&clean)
        .map(|(a, b)| {
            (a.world_from_volant.translation.vector - b.world_from_volant.translation.vector).norm()
        })
        .fold(0.0, f64::max);
    assert!(worst < 1e-4, "{worst}");
}

#[test]
fn reordered_imu_samples_are_sorted() {
    let run = recording();
    let mut inputs: Vec<Input> = run.inputs().collect();
    let imu: Vec<usize> =
        (0..inputs.len()).filter(|i| matches!(inputs[*i], Input::Imu(_))).collect();
    for pair in imu.chunks_exact(7) {
        inputs.swap(pair[2], pair[3]);
    }
    let (fusion, outputs) = scoring::follow(FusionConfig::default(), inputs);
    let score = scoring::score(&outputs.odometry, &run.truth, 1.0);
    assert!(fusion.status().counts.inputs.late_imu > 50);
    assert!(score.position_rmse() < 1.2 && score.rotation_rmse() < 0.2, "{score}");
    assert!(outputs.odometry.windows(2).all(|w| w[1].stamp > w[0].stamp));
}

/// Each IMU sample is delivered up to 0.2 s late, so that they come in any order: every one of them
/// still counts, and none is taken for a clock that was set.
#[test]
fn imu_samples_in_any_order_within_a_fifth_of_a_second_cost_no_accuracy() {
    let run = recording();
    let mut random = rig_simulator::random::Random::new(7);
    let mut inputs = run.inputs.clone();
    for (at, input) in &mut inputs {
        if matches!(input, Input::Imu(_)) {
            *at = at.plus_seconds((0.1 + 0.05 * random.normal()).clamp(0.0, 0.2));
        }
    }
    inputs.sort_by_key(|(at, _)| *at);
    let (fusion, outputs) =
        scoring::follow(FusionConfig::default(), inputs.into_iter().map(|(_, input)| input));
    let score = scoring::score(&outputs.odometry, &run.truth, 1.0);
    let counts = fusion.status().counts;
    assert!(counts.inputs.late_imu > 200 && counts.resets.time_jumps == 0, "{counts:?}");
    assert!(score.position_rmse() < 1.2 && score.rotation_rmse() < 0.2, "{score}");
}

/// Single IMU samples whose stamp is wrong, and ones that are sent again and again.
#[test]
fn imu_samples_stamped_ahead_hold_up_nothing() {
    let run = recording();
    let step = run.start().plus_seconds(3.0);
    let followed = |strays: &[f64]| {
        let mut fusion = Fusion::new(simulated::rig(), FusionConfig::default());
        let mut done = false;
        let inputs = run.inputs.iter().flat_map(|(at, input)| {
            let now = !done && *at > step && matches!(input, Input::Imu(_));
            done |= now;
            let strays = if now { strays } else { &[] };
            std::iter::once(input.clone()).chain(strays.iter().map(|by| shifted(input, *by)))
        });
        let outputs = scoring::run(&mut fusion, inputs);
        let score = scoring::score(&outputs.odometry, &run.truth, 1.0);
        assert_eq!(fusion.status().counts.resets.time_jumps, 0);
        assert!(score.position_rmse() < 1.2, "{strays:?}: {score}");
        outputs.odometry.len()
    };
    let clean = followed(&[]);
    for strays in [&[0.25][..], &[0.4], &[0.9], &[0.4, 0.4, 0.4], &[5.0, 5.0, 5.0]] {
        assert_eq!(followed(strays), clean, "{strays:?}");
    }
}

#[test]
fn the_covariance_stays_consistent_without_vision() {
    let run = simulated::run(
        MotionConfig { duration: 12.0, ..MotionConfig::nominal(2) },
        &SensorConfig {
            hidden: rig_model::MarkerColor::ALL.map(|m| (m, 3.0, 9.0)).to_vec(),
            ..SensorConfig::nominal(2)
        },
    );
    // An unknown time offset comes and goes in the covariance with the speed: here it is known.
    let mut config = FusionConfig::default();
    config.tight.clock.camera_sigma = 0.0;
    config.tight.calibration = CalibrationSigmas::NONE;
    let (_, outputs) = scoring::follow(config, run.inputs());
    let epoch = SensorConfig::nominal(2).epoch;
    let mut last: Option<&Odometry> = None;
    for o in &outputs.odometry {
        let t = o.stamp.seconds_since(epoch);
        let truth = run.pose_at(o.stamp).unwrap();
        let p = PoseError::new(&o.world_from_volant, &truth).position;
        for i in 0..3 {
            let sigma = o.pose_covariance[(i, i)].sqrt();
            assert!(p[i].abs() < 5.0 * sigma + 1e-3, "{t} {i}: {} of {sigma}", p[i]);
        }
        if (3.1..9.0).contains(&t) {
            if let Some(before) = last {
                assert!(o.pose_covariance[(0, 0)] >= before.pose_covariance[(0, 0)] * 0.999);
            }
            last = Some(o);
        }
    }
    assert!(outputs.warnings.iter().any(|w| matches!(w, Warning::PoseLost { .. })));
    // Back within two images.
    let back = outputs.odometry.iter().find(|o| o.stamp.seconds_since(epoch) > 9.12).unwrap();
    let truth = run.pose_at(back.stamp).unwrap();
    let p = PoseError::new(&back.world_from_volant, &truth).position;
    assert!(p.norm() < 0.01, "{p}");
}

/// A driver holds back the first IMU samples until an image alone has initialized the pose.
#[test]
fn imu_samples_from_before_the_first_pose_are_rejected() {
    let run = recording();
    let begin = run.start();
    let held_until = |release: Stamp| {
        let early = |s: &ImuSample| s.stamp.seconds_since(begin) < 0.3;
        let mut inputs = run.inputs.clone();
        inputs.retain(|(_, input)| !matches!(input, Input::Imu(s) if early(s)));
        for (at, input) in &mut inputs {
            if matches!(input, Input::Imu(_)) {
                *at = release.max(*at);
            }
        }
        inputs.sort_by_key(|(at, _)| *at);
        inputs
    };
    let mut fusion = Fusion::new(simulated::rig(), simulated::config());
    let (first, _) = held_until(begin.plus_seconds(2.0))
        .into_iter()
        .find(|(_, input)| {
            fusion.handle(input.clone());
            fusion.status().initialized
        })
        .unwrap();
    let inputs = held_until(first.plus_seconds(1e-4));
    let (_, outputs) =
        scoring::follow(simulated::config(), inputs.into_iter().map(|(_, input)| input));
    let score = scoring::score(&outputs.odometry, &run.truth, 0.0);
    assert!(outputs.odometry.len() > 400 && score.position_max() < 100.0, "{score}");
}

/// Messages are stamped an hour ahead while no IMU sample contradicts them.
#[test]
fn stamps_an_hour_ahead_have_no_lasting_effect_without_the_imu() {
    let run = recording();
    let begin = run.start();
    let at = |seconds: f64| begin.plus_seconds(seconds);
    let silent = |stamp: Stamp| (at(3.0)..at(3.6)).contains(&stamp);
    let found = |wrong: &dyn Fn(&Input) -> bool, when: f64, imu_from: f64, aheads: &[f64]| {
        let (mut done, mut inputs) = (false, Vec::new());
        for (arrived, input) in &run.inputs {
            let is_imu = matches!(input, Input::Imu(_));
            if is_imu && (silent(*arrived) || *arrived < at(imu_from)) {
                continue;
            }
            inputs.push(input.clone());
            if !done && *arrived > at(when) && wrong(input) {
                done = true;
                inputs.extend(aheads.iter().map(|ahead| shifted(input, *ahead)));
            }
        }
        assert!(done);
        scoring::follow(FusionConfig::default(), inputs).1
    };
    let is_image = |input: &Input| matches!(input, Input::Markers(_));
    let is_climber = |input: &Input| matches!(input, Input::Climber(_));
    for (what, wrong, when, imu_from) in [
        ("encoders before the IMU", &is_climber as &dyn Fn(&Input) -> bool, 0.0, 1.0),
        ("image before the IMU", &is_image, 0.0, 1.0),
        ("encoders while the IMU is silent", &is_climber, 3.4, 0.0),
        ("image while the IMU is silent", &is_image, 3.4, 0.0),
    ] {
        // One, the same one twice, and a second one that confirms the first.
        for aheads in [&[3600.0][..], &[3600.0, 3600.0], &[3600.0, 3600.03, 3600.06]] {
            let count = aheads.len();
            let outputs = found(wrong, when, imu_from, aheads);
            let score = scoring::score(&outputs.odometry, &run.truth, 4.2);
            let poses = outputs.odometry.len();
            let near = score.position_rmse() < 1.5;
            assert!(poses > 380 && near, "{count} {what}: {poses} poses, {score}");
            let ahead = outputs.status.iter().any(|s| s.stamp > at(100.0));
            assert!(count > 2 || !ahead, "{count} {what}: a status an hour ahead");
        }
    }
}

/// A second publisher of encoder readings has another clock from the start.
#[test]
fn messages_of_another_clock_delay_no_odometry() {
    let run = recording();
    let reading = run.inputs.iter().find_map(|(_, input)| match input {
        Input::Climber(c) => Some(c),
        _ => None,
    });
    let reading = reading.unwrap();
    let followed = |ahead: Option<f64>| {
        let inputs = run.inputs.iter().flat_map(|(_, input)| {
            let wrong = match (input, ahead) {
                (Input::Imu(s), Some(ahead)) => {
                    let stamp = s.stamp.plus_seconds(ahead);
                    Some(Input::Climber(ClimberSample { stamp, ..reading.clone() }))
                }
                _ => None,
            };
            wrong.into_iter().chain([input.clone()])
        });
        scoring::follow(FusionConfig::default(), inputs).1.odometry.len()
    };
    let (clean, other) = (followed(None), followed(Some(3600.0)));
    assert_eq!(clean, other);
}

/// Between the start and the first odometry nothing is lost, whatever the order of the inputs.
#[test]
fn no_start_is_reported_as_lost() {
    for ahead in (-10..=40).map(|k| 0.005 * f64::from(k)) {
        for seed in 1..=2 {
            let sensors = SensorConfig {
                camera_clock_ahead: ahead,
                climber_clock_ahead: ahead,
                ..SensorConfig::nominal(seed)
            };
            let motion = MotionConfig { duration: 1.0, ..MotionConfig::nominal(seed) };
            let run = simulated::run(motion, &sensors);
            let (_, outputs) = scoring::follow(FusionConfig::default(), run.inputs());
            let lost: Vec<_> = outputs
                .status
                .iter()
                .filter(|s| s.reason.contains("no usable IMU sample"))
                .collect();
            assert!(outputs.odometry.len() > 50 && lost.is_empty(), "{ahead} {seed}: {lost:?}");
        }
    }
}

/// Before, a copy was another sample where a reading lay at its instant.
#[test]
fn a_repeated_sample_is_a_copy_also_beside_a_reading_of_its_instant() {
    let mut inputs: Vec<Input> = Vec::new();
    let mut newest = None;
    for mut input in recording().inputs() {
        match &mut input {
            Input::Imu(sample) => newest = Some(*sample),
            Input::Climber(reading) => {
                let Some(sample) = newest.take() else { continue };
                reading.stamp = sample.stamp;
                inputs.extend([input, Input::Imu(sample)]);
                continue;
            }
            _ => {}
        }
        inputs.push(input);
    }
    let (fusion, _) = scoring::follow(FusionConfig::default(), inputs);
    let counts = fusion.status().counts.inputs;
    assert!(counts.duplicates > 100 && counts.late_imu == 0, "{counts:?}");
}
