//! Every rejection, every recovery, and the plausibility of every output.

use super::*;
use proptest::prelude::*;
use std::f64::consts::PI;

const T0: Stamp = Stamp::from_nanos(1_760_000_000_000_000_000);

fn reading(seconds: f64, x: f64, y: f64, turn: f64) -> JointReading {
    JointReading {
        stamp: T0.plus_seconds(seconds),
        names: ["hook", "turn", "rail_y", "rail_x"].map(str::to_owned).to_vec(),
        positions: vec![9.0, turn, y, x],
    }
}

fn climber() -> Climber {
    Climber::new(ClimberConfig { height: 2.8, ..ClimberConfig::default() }).unwrap()
}

/// Processes a reading 5 ms after its stamp and returns the outputs.
fn process(climber: &mut Climber, reading: &JointReading) -> Vec<Output> {
    climber.handle(reading, reading.stamp.plus_seconds(0.005));
    std::iter::from_fn(|| climber.poll()).collect()
}

fn rejection(climber: &mut Climber, reading: &JointReading) -> Warning {
    match process(climber, reading).as_slice() {
        [Output::Warning(rejection @ Warning::Rejected { .. })] => rejection.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn joints_are_found_by_name_and_scaled() {
    let mut config = ClimberConfig { height: 2.8, ..ClimberConfig::default() };
    for (joint, (scale, zero)) in
        config.joints.iter_mut().zip([(0.001, 500.0), (-1.0, 0.0), (0.5, 0.0)])
    {
        (joint.scale, joint.zero) = (scale, zero);
    }
    let mut climber = Climber::new(config).unwrap();
    let out = process(&mut climber, &reading(0.0, 1500.0, 0.25, 1.0));
    let [Output::Sample(sample)] = out.as_slice() else { panic!("{out:?}") };
    assert_eq!(sample.stamp, T0);
    assert_eq!(sample.world_from_climber.translation.vector, Vector3::new(1.0, -0.25, 2.8));
    let (roll, pitch, yaw) = sample.world_from_climber.rotation.euler_angles();
    assert!(roll.abs() + pitch.abs() < 1e-15 && (yaw - 0.5).abs() < 1e-15);
}

#[test]
fn each_rejection_is_named_and_the_next_valid_reading_is_accepted() {
    let good = |s| reading(s, 0.1, 0.2, 0.3);
    type Fault = fn(&mut JointReading);
    let faults: [(&str, Fault); 8] = [
        ("not finite", |r| r.positions[1] = f64::NAN),
        ("not finite", |r| r.positions[3] = f64::INFINITY),
        ("length mismatch", |r| {
            r.positions.truncate(2);
        }),
        ("missing joint", |r| r.names[3] = "rail_z".into()),
        ("duplicate joint", |r| r.names[0] = "rail_y".into()),
        ("jump", |r| r.positions[2] += 0.5),
        ("jump", |r| r.positions[1] += 3.2),
        ("not newer", |r| r.stamp = T0),
    ];
    for (kind, inject) in faults {
        let mut climber = climber();
        assert!(matches!(process(&mut climber, &good(0.0))[..], [Output::Sample(_)]));
        let mut bad = good(0.02);
        inject(&mut bad);
        let rejected = rejection(&mut climber, &bad);
        assert_eq!(rejected.kind(), kind, "{rejected}");
        assert_eq!(climber.counts().rejected[kind], 1);
        assert!(
            matches!(process(&mut climber, &good(0.04))[..], [Output::Sample(_)]),
            "after {kind}"
        );
    }
}

#[test]
fn stale_and_future_readings_are_rejected_by_their_time_of_receipt() {
    let mut climber = climber();
    let mut outcome = |reading: &JointReading, received: f64| {
        climber.handle(reading, T0.plus_seconds(received));
        match climber.poll() {
            Some(Output::Sample(_)) => "sample",
            Some(Output::Warning(warning)) => warning.kind(),
            None => "nothing",
        }
    };
    let at = |seconds| reading(seconds, 0.0, 0.0, 0.0);
    assert_eq!(outcome(&at(0.0), 0.6), "stale");
    let unset = JointReading { stamp: Stamp::from_nanos(0), ..at(0.0) };
    assert_eq!(outcome(&unset, 0.0), "no stamp");
    assert_eq!(outcome(&at(0.0), -0.3), "sample");
    assert_eq!(outcome(&at(1.0), 0.4), "from the future");
    // The rejected reading did not advance the last accepted stamp.
    assert_eq!(outcome(&at(0.41), 0.41), "sample");
}

#[test]
fn messages_without_configured_joints_are_ignored() {
    let mut climber = climber();
    let arm = JointReading { stamp: T0, names: vec!["elbow".into()], positions: vec![f64::NAN] };
    assert!(process(&mut climber, &arm).is_empty());
    assert_eq!(climber.counts().foreign, 1);
}

#[test]
fn messages_with_other_joints_only_are_named_and_so_is_the_parameter() {
    let named = |k: u32, names: &[&str]| JointReading {
        stamp: T0.plus_seconds(0.02 * f64::from(k)),
        names: names.iter().map(|n| (*n).to_owned()).collect(),
        positions: vec![0.0; names.len()],
    };
    let no_names: &[&str] = &[];
    for (names, found) in [
        (&["bridge", "trolley", "slew"][..], "the joints `bridge`, `trolley`, `slew`"),
        (&["a"; 12][..], "`a` and 4 more"),
        (no_names, "no joint names"),
    ] {
        let mut climber = climber();
        let out: Vec<_> = (0..20).flat_map(|k| process(&mut climber, &named(k, names))).collect();
        assert!(!out.is_empty() && out.len() < 20, "{out:?}");
        let Some(Output::Warning(warning)) = out.last() else { panic!("{out:?}") };
        let text = warning.to_string();
        for part in [found, "none of `rail_x`, `rail_y`, `turn`;", "joints.rail_x"] {
            assert!(text.contains(part), "{part}: {text}");
        }
        // Not beside readings of the climber.
        let _ = process(&mut climber, &reading(1.0, 0.0, 0.0, 0.0));
        assert!(process(&mut climber, &named(60, names)).is_empty());
    }
    // One joint per message: another name does not help.
    let mut climber = climber();
    let missing = rejection(&mut climber, &named(0, &["rail_x", "rail_y"])).to_string();
    assert!(missing.contains("publish all joints in one message"), "{missing}");
}

#[test]
fn an_axis_that_the_climber_does_not_have_is_zero() {
    let mut config = ClimberConfig::default();
    config.joints[2].name.clear();
    let mut climber = Climber::new(config).unwrap();
    let mut rails = JointReading {
        stamp: T0,
        names: ["", "rail_y", "rail_x"].map(str::to_owned).to_vec(),
        positions: vec![7.0, 0.2, 0.1],
    };
    let out = process(&mut climber, &rails);
    let [Output::Sample(sample)] = out.as_slice() else { panic!("{out:?}") };
    assert_eq!(sample.world_from_climber, Isometry3::translation(0.1, 0.2, 0.0));
    // The joints that it has are required as before.
    (rails.names[1], rails.stamp) = ("trolley".to_owned(), T0.plus_seconds(0.02));
    let missing = rejection(&mut climber, &rails).to_string();
    assert!(missing.contains("`rail_y` (rail_y) is missing"), "{missing}");
    let other = JointReading { names: vec!["arm".into()], positions: vec![0.0], ..rails };
    assert!(process(&mut climber, &other).is_empty(), "of another publisher");
}

#[test]
fn other_joints_do_not_hide_why_readings_of_the_climber_are_rejected() {
    for before in [0, 30] {
        let mut climber = climber();
        let arm = |k: i32| JointReading {
            stamp: T0.plus_seconds(0.02 * f64::from(k)),
            names: vec!["arm_1".into()],
            positions: vec![0.0],
        };
        let named = (0..before).filter(|k| !process(&mut climber, &arm(*k)).is_empty()).count();
        assert_eq!(named > 0, before > 0);
        for k in before..before + 30 {
            let own = reading(0.02 * f64::from(k), f64::NAN, 0.0, 0.0);
            assert_eq!(rejection(&mut climber, &own).kind(), "not finite");
            assert!(process(&mut climber, &arm(k)).is_empty(), "{before} {k}");
        }
    }
}

#[test]
fn spikes_are_rejected_and_a_lasting_step_is_accepted_after_the_patience() {
    let mut climber = climber();
    let patience = ClimberConfig::default().jump_patience;
    let _ = process(&mut climber, &reading(0.0, 0.0, 0.0, 0.0));
    // Every second reading is a different spike: no two of them are consistent.
    for i in 1..200 {
        let spike = i % 2 == 0;
        let x = if spike { 1.0 + f64::from(i) } else { 0.0 };
        let out = process(&mut climber, &reading(0.02 * f64::from(i), x, 0.0, 0.0));
        assert_eq!(matches!(out[..], [Output::Sample(_)]), !spike, "{i}");
    }
    // The climber could cover the smaller step within the patience.
    for (from, step) in [(200, 5.0), (300, 5.5)] {
        let mut rejected = 0;
        for i in from.. {
            let out = process(&mut climber, &reading(0.02 * f64::from(i), step, 0.0, 0.0));
            match out.as_slice() {
                [Output::Warning(warning)] if warning.kind() == "jump" => rejected += 1,
                [
                    Output::Warning(Warning::Relocated { change, rejected: n }),
                    Output::Sample(s),
                ] => {
                    assert_eq!((*n, rejected), (patience - 1, patience - 1));
                    assert_eq!(change[0], if from == 200 { 5.0 } else { 0.5 });
                    assert_eq!(s.world_from_climber.translation.x, step);
                    break;
                }
                other => panic!("{other:?}"),
            }
            assert!(i < from + 100);
        }
        for i in from + 50..from + 100 {
            let out = process(&mut climber, &reading(0.02 * f64::from(i), step, 0.0, 0.0));
            assert!(matches!(out[..], [Output::Sample(_)]), "{i}: {out:?}");
        }
    }
}

#[test]
fn a_moving_climber_is_followed_beside_spikes() {
    let mut climber = climber();
    for i in 0..100 {
        let seconds = 0.02 * f64::from(i);
        let spike = if i % 2 == 1 { 0.5 } else { 0.0 };
        let out = process(&mut climber, &reading(seconds, 1.9 * seconds + spike, 0.0, 0.0));
        assert_eq!(matches!(out[..], [Output::Sample(_)]), spike == 0.0, "{i}: {out:?}");
    }
}

#[test]
fn a_wrong_stamp_or_a_gap_costs_few_readings_of_a_moving_climber() {
    for (interval, speed, most) in [(0.02, 1.0, 1), (0.1, 1.0, 1), (0.02, 1.8, 10)] {
        let mut climber = climber();
        let mut rejected = Vec::new();
        for i in 0..100 {
            let seconds = interval * f64::from(i);
            // One reading is stamped 1 ms before the next one.
            let late = if i == 50 { interval - 0.001 } else { 0.0 };
            let out = process(&mut climber, &reading(seconds + late, speed * seconds, 0.0, 0.0));
            match out.as_slice() {
                [Output::Sample(_)] => {}
                [Output::Warning(warning)] => rejected.push(warning.to_string()),
                other => panic!("{i}: {other:?}"),
            }
        }
        assert!((1..=most).contains(&rejected.len()), "{interval} {speed}: {rejected:?}");
        assert!(rejected[0].contains("check the stamps"), "{rejected:?}");
    }
    // A spike before a second without readings.
    let mut climber = climber();
    for i in (0..=50).chain(100..150) {
        let seconds = 0.02 * f64::from(i);
        let spike = if i == 50 { 0.5 } else { 0.0 };
        let out = process(&mut climber, &reading(seconds, seconds + spike, 0.0, 0.0));
        assert_eq!(matches!(out[..], [Output::Sample(_)]), i != 50, "{i}: {out:?}");
    }
}

#[test]
fn a_step_of_readings_that_come_in_bursts_is_accepted_after_the_patience() {
    let mut climber = climber();
    let mut relocated = None;
    for i in 0..200 {
        // Five within 2 ms, every 100 ms.
        let seconds = 0.1 * f64::from(i / 5) + 4e-4 * f64::from(i % 5);
        let x = if i < 100 { 0.0 } else { 1.0 };
        let out = process(&mut climber, &reading(seconds, x, 0.0, 0.0));
        if let [Output::Warning(Warning::Relocated { .. }), _] = out.as_slice() {
            relocated.get_or_insert(i);
        }
    }
    let patience = i32::try_from(ClimberConfig::default().jump_patience).unwrap();
    assert!(relocated.is_some_and(|i| (100..=101 + patience).contains(&i)), "{relocated:?}");
}

#[test]
fn an_encoder_of_the_turn_may_wrap() {
    // At the upper end of its range (0 to 2π, and ±π), forwards and backwards.
    for end in [TAU, PI] {
        for rate in [1.0, -1.0] {
            let mut climber = climber();
            for k in -50..50 {
                let seconds = 0.02 * f64::from(k);
                let turn = end - TAU + (rate * seconds).rem_euclid(TAU);
                let out = process(&mut climber, &reading(seconds, 0.0, 0.0, turn));
                let [Output::Sample(sample)] = out.as_slice() else { panic!("{turn}: {out:?}") };
                let expected = wrap_angle(end + rate * seconds);
                let yaw = sample.world_from_climber.rotation.euler_angles().2;
                assert!(wrap_angle(yaw - expected).abs() < 1e-9, "{yaw} {expected}");
            }
        }
    }
    // A step across the end is reported by its size, and several turns are an outlier.
    let mut climber = climber();
    let _ = process(&mut climber, &reading(0.0, 0.0, 0.0, 3.0));
    let step = rejection(&mut climber, &reading(0.02, 0.0, 0.0, -0.5));
    assert!(step.to_string().contains("turn jumped by 2.7832 rad"), "{step}");
    let step = rejection(&mut climber, &reading(0.04, 0.0, 0.0, 3.0 + 5.0 * TAU));
    assert!(step.to_string().contains("turn jumped by 31.4159 rad"), "{step}");
    for k in 0.. {
        let out = process(&mut climber, &reading(0.06 + 0.02 * f64::from(k), 0.0, 0.0, -0.5));
        if let [Output::Warning(Warning::Relocated { change, .. }), _] = out.as_slice() {
            assert!((change[2] - (TAU - 3.5)).abs() < 1e-9, "{change:?}");
            break;
        }
        assert!(k < 100, "{out:?}");
    }
}

#[test]
fn readings_are_accepted_at_once_in_another_calibration() {
    let mut climber = climber();
    let _ = process(&mut climber, &reading(0.0, 0.5, 0.0, 0.0));
    let mut config = ClimberConfig::default();
    config.joints[0].zero = -2.0;
    config.joints[1].scale = -1.0;
    climber.set_config(config.clone()).unwrap();
    let out = process(&mut climber, &reading(0.02, 0.5, 0.0, 0.0));
    let [Output::Sample(sample)] = out.as_slice() else { panic!("{out:?}") };
    assert_eq!(sample.world_from_climber.translation.x, 2.5);
    // Any other parameter keeps the reference.
    climber.set_config(ClimberConfig { height: 3.0, ..config }).unwrap();
    assert_eq!(rejection(&mut climber, &reading(0.04, 1.5, 0.0, 0.0)).kind(), "jump");
}

#[test]
fn a_restarted_replay_resets_the_state() {
    let mut climber = climber();
    assert!(matches!(
        process(&mut climber, &reading(100.0, 0.0, 0.0, 0.0))[..],
        [Output::Sample(_)]
    ));
    let out = process(&mut climber, &reading(0.0, 1.0, 0.0, 0.0));
    assert!(
        matches!(out[..], [Output::Warning(Warning::TimeWentBack { .. }), Output::Sample(_)]),
        "{out:?}"
    );
}

#[test]
fn silence_counts_from_the_last_accepted_reading() {
    let mut climber = climber();
    assert_eq!(climber.silent_for(T0), Some(f64::INFINITY));
    let _ = process(&mut climber, &reading(0.0, 0.0, 0.0, 0.0));
    assert_eq!(climber.silent_for(T0.plus_seconds(0.3)), None);
    let _ = process(&mut climber, &reading(0.5, f64::NAN, 0.0, 0.0));
    assert!(climber.silent_for(T0.plus_seconds(0.6)).is_some_and(|s| s > 0.59));
}

proptest! {
    #[test]
    fn samples_are_finite_normalized_increasing_and_within_the_speed_limit(
        readings in prop::collection::vec(
            (-2.0..2.0f64, prop::array::uniform3(prop_oneof![
                8 => -0.05..0.05f64,
                1 => Just(f64::NAN),
                1 => prop::num::f64::ANY,
            ]), -1.0..1.0f64),
            1..200,
        )
    ) {
        let config = ClimberConfig { jump_patience: u32::MAX, ..ClimberConfig::default() };
        let mut climber = Climber::new(config).unwrap();
        let mut seconds = 0.0;
        let mut last: Option<ClimberSample> = None;
        for (step, [x, y, turn], late) in readings {
            seconds += step.max(-0.1) * 0.05;
            let r = reading(seconds, x, y, turn);
            climber.handle(&r, r.stamp.plus_seconds(late));
            while let Some(output) = climber.poll() {
                match output {
                    Output::Sample(s) => {
                        let position = s.world_from_climber.translation.vector;
                        prop_assert!(position.iter().all(|v| v.is_finite()));
                        prop_assert!((s.world_from_climber.rotation.norm() - 1.0).abs() < 1e-9);
                        if let Some(last) = &last {
                            prop_assert!(s.stamp > last.stamp);
                            let way = position.x - last.world_from_climber.translation.vector.x;
                            let seconds = s.stamp.seconds_since(last.stamp);
                            prop_assert!(way.abs() <= 2.0 * seconds + 0.005);
                        }
                        last = Some(s);
                    }
                    Output::Warning(Warning::TimeWentBack { .. }) => last = None,
                    Output::Warning(_) => {}
                }
            }
        }
    }
}
