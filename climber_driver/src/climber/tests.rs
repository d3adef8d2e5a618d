//! Each refusal, each way back, and that nothing implausible ever leaves.

use super::*;
use crate::config::JointCalibration;
use proptest::prelude::*;

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

/// Handles it 5 ms after its stamp; gives what comes out.
fn feed(climber: &mut Climber, reading: &JointReading) -> Vec<Output> {
    climber.handle(reading, reading.stamp.plus_seconds(0.005));
    std::iter::from_fn(|| climber.poll()).collect()
}

fn refusal(climber: &mut Climber, reading: &JointReading) -> Refusal {
    match feed(climber, reading).as_slice() {
        [Output::Warning(Warning::Refused(refusal))] => refusal.clone(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn joints_are_found_by_name_and_scaled() {
    let joint = |name: &str, scale, zero| JointCalibration {
        name: name.into(),
        scale,
        zero,
        uncertainty: 0.001,
        max_speed: 2.0,
    };
    let mut climber = Climber::new(ClimberConfig {
        joints: [joint("rail_x", 0.001, 500.0), joint("rail_y", -1.0, 0.0), joint("turn", 0.5, 0.0)],
        height: 2.8,
        ..ClimberConfig::default()
    })
    .unwrap();
    let out = feed(&mut climber, &reading(0.0, 1500.0, 0.25, 1.0));
    let [Output::Sample(sample)] = out.as_slice() else { panic!("{out:?}") };
    assert_eq!(sample.stamp, T0);
    assert_eq!(sample.world_from_climber.translation.vector, Vector3::new(1.0, -0.25, 2.8));
    let (roll, pitch, yaw) = sample.world_from_climber.rotation.euler_angles();
    assert!(roll.abs() + pitch.abs() < 1e-15 && (yaw - 0.5).abs() < 1e-15);
}

#[test]
fn each_refusal_is_named_and_the_next_good_reading_is_taken() {
    let good = |s| reading(s, 0.1, 0.2, 0.3);
    type Spoil = fn(&mut JointReading);
    let spoiled: [(&str, Spoil); 8] = [
        ("not finite", |r| r.positions[1] = f64::NAN),
        ("not finite", |r| r.positions[3] = f64::INFINITY),
        ("length mismatch", |r| {
            r.positions.truncate(2);
        }),
        ("missing joint", |r| r.names[3] = "rail_z".into()),
        ("duplicate joint", |r| r.names[0] = "rail_y".into()),
        ("jump", |r| r.positions[2] += 0.5),
        ("jump", |r| r.positions[1] += 3.2),
        ("not newer", |r| r.stamp = T0.plus_seconds(-0.1)),
    ];
    for (kind, spoil) in spoiled {
        let mut climber = climber();
        assert!(matches!(feed(&mut climber, &good(0.0))[..], [Output::Sample(_)]));
        let mut bad = good(0.02);
        spoil(&mut bad);
        let said = refusal(&mut climber, &bad);
        assert_eq!(said.kind(), kind, "{said}");
        assert_eq!(climber.counts().refused[kind], 1);
        assert!(matches!(feed(&mut climber, &good(0.04))[..], [Output::Sample(_)]), "after {kind}");
    }
}

#[test]
fn stale_readings_and_those_of_the_future_are_refused_by_the_time_of_receipt() {
    let mut climber = climber();
    let r = reading(0.0, 0.0, 0.0, 0.0);
    climber.handle(&r, T0.plus_seconds(0.6));
    assert!(matches!(climber.poll(), Some(Output::Warning(Warning::Refused(Refusal::Stale { .. })))));
    climber.handle(&r, T0.plus_seconds(-0.3));
    assert!(matches!(climber.poll(), Some(Output::Sample(_))));
    climber.handle(&reading(1.0, 0.0, 0.0, 0.0), T0.plus_seconds(0.4));
    assert!(matches!(climber.poll(), Some(Output::Warning(Warning::Refused(Refusal::FromTheFuture { .. })))));
    // The reading from the future did not set the clock ahead.
    climber.handle(&reading(0.41, 0.0, 0.0, 0.0), T0.plus_seconds(0.41));
    assert!(matches!(climber.poll(), Some(Output::Sample(_))));
}

#[test]
fn the_same_message_twice_counts_once() {
    let mut climber = climber();
    let r = reading(0.0, 0.1, 0.2, 0.3);
    assert!(matches!(feed(&mut climber, &r)[..], [Output::Sample(_)]));
    assert_eq!(refusal(&mut climber, &r).kind(), "not newer");
    assert_eq!(climber.counts().accepted, 1);
}

#[test]
fn another_publisher_s_joints_are_passed_over_in_silence() {
    let mut climber = climber();
    let arm = JointReading { stamp: T0, names: vec!["elbow".into()], positions: vec![f64::NAN] };
    assert!(feed(&mut climber, &arm).is_empty());
    assert_eq!(climber.counts().foreign, 1);
}

#[test]
fn a_spike_never_passes_but_a_lasting_step_does_after_the_patience() {
    let mut climber = climber();
    let patience = ClimberConfig::default().jump_patience;
    let _ = feed(&mut climber, &reading(0.0, 0.0, 0.0, 0.0));
    // Every second reading is a spike, and always another one: nothing builds up.
    for i in 1..200 {
        let spike = i % 2 == 0;
        let x = if spike { 1.0 + f64::from(i) } else { 0.0 };
        let out = feed(&mut climber, &reading(0.02 * f64::from(i), x, 0.0, 0.0));
        assert_eq!(matches!(out[..], [Output::Sample(_)]), !spike, "{i}");
    }
    let mut refused = 0;
    for i in 200.. {
        let out = feed(&mut climber, &reading(0.02 * f64::from(i), 5.0, 0.0, 0.0));
        match out.as_slice() {
            [Output::Warning(Warning::Refused(Refusal::Jump { .. }))] => refused += 1,
            [Output::Warning(Warning::Relocated { change, refused: n }), Output::Sample(s)] => {
                assert_eq!((*n, refused), (patience - 1, patience - 1));
                assert_eq!((change[0], s.world_from_climber.translation.x), (5.0, 5.0));
                break;
            }
            other => panic!("{other:?}"),
        }
        assert!(i < 300);
    }
}

#[test]
fn a_replay_that_starts_anew_is_followed() {
    let mut climber = climber();
    assert!(matches!(feed(&mut climber, &reading(100.0, 0.0, 0.0, 0.0))[..], [Output::Sample(_)]));
    let out = feed(&mut climber, &reading(0.0, 1.0, 0.0, 0.0));
    assert!(matches!(out[..], [Output::Warning(Warning::TimeWentBack { .. }), Output::Sample(_)]), "{out:?}");
}

#[test]
fn silence_is_told_by_the_last_accepted_reading_not_by_the_last_received() {
    let mut climber = climber();
    assert_eq!(climber.silent_for(T0), Some(f64::INFINITY));
    let _ = feed(&mut climber, &reading(0.0, 0.0, 0.0, 0.0));
    assert_eq!(climber.silent_for(T0.plus_seconds(0.3)), None);
    let _ = feed(&mut climber, &reading(0.5, f64::NAN, 0.0, 0.0));
    assert!(climber.silent_for(T0.plus_seconds(0.6)).is_some_and(|s| s > 0.59));
}

proptest! {
    #[test]
    fn whatever_comes_in_samples_are_finite_unit_newer_and_never_too_fast(
        readings in prop::collection::vec(
            (-2.0..2.0f64, prop::array::uniform3(prop_oneof![
                8 => -0.05..0.05f64,
                1 => Just(f64::NAN),
                1 => prop::num::f64::ANY,
            ]), -1.0..1.0f64),
            1..200,
        )
    ) {
        let mut climber = Climber::new(ClimberConfig { jump_patience: u32::MAX, ..ClimberConfig::default() }).unwrap();
        let mut seconds = 0.0;
        let mut last: Option<ClimberSample> = None;
        for (step, [x, y, turn], late) in readings {
            seconds += step.max(-0.1) * 0.05;
            let r = reading(seconds, x, y, turn);
            climber.handle(&r, r.stamp.plus_seconds(late));
            while let Some(output) = climber.poll() {
                match output {
                    Output::Sample(s) => {
                        prop_assert!(s.world_from_climber.translation.vector.iter().all(|v| v.is_finite()));
                        prop_assert!((s.world_from_climber.rotation.norm() - 1.0).abs() < 1e-9);
                        if let Some(last) = &last {
                            prop_assert!(s.stamp > last.stamp);
                            let way = s.world_from_climber.translation.vector.x - last.world_from_climber.translation.vector.x;
                            prop_assert!(way.abs() <= 2.0 * s.stamp.seconds_since(last.stamp) + 0.005);
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
