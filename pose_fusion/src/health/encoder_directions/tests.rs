//! Wrong directions are named, right ones are not.

use super::*;
use rig_simulator::random::Random;
use std::ops::Range;

/// True motion of a climber: x, y, m; turn, rad.
fn climber(t: f64) -> Vector3<f64> {
    let turn = wrap_angle(2.9 + 0.5 * (0.7 * t).sin());
    Vector3::new(0.3 * (1.3 * t).sin(), 0.2 * (2.1 * t + 1.0).sin(), turn)
}

/// Adds instants of `seconds` at 30 Hz, with a drift of the IMU and `read` by the encoders.
fn add(
    directions: &mut EncoderDirections,
    seconds: Range<f64>,
    read: impl Fn(f64) -> Vector3<f64>,
) {
    add_moving(directions, seconds, climber, read);
}

/// The same with another motion.
fn add_moving(
    directions: &mut EncoderDirections,
    seconds: Range<f64>,
    climber: impl Fn(f64) -> Vector3<f64>,
    mut read: impl FnMut(f64) -> Vector3<f64>,
) {
    let epoch = Stamp::from_nanos(1_760_001_000_000_000_000);
    let count = ((seconds.end - seconds.start) * 30.0) as i32;
    for t in (0..count).map(|i| seconds.start + f64::from(i) / 30.0) {
        let drift = Vector3::new(0.4 * t + 0.02 * t * t, -3.0, 0.5);
        let (stamp, at) = (epoch.plus_seconds(t), climber(t));
        let instant =
            ClimberInstant { stamp, shown: at + drift, calibrated: at + drift, read: read(t) };
        directions.compare(instant);
    }
}

#[test]
fn each_wrong_direction_is_named_and_right_ones_are_not() {
    let named = |read: &dyn Fn(Vector3<f64>) -> Vector3<f64>| {
        let mut directions = EncoderDirections::default();
        add(&mut directions, 0.0..10.0, |t| read(climber(t)));
        directions.wrong()
    };
    assert_eq!(named(&|at| at), None);
    assert_eq!(named(&|at| Vector3::new(0.0, 0.0, at.z)), None, "stuck rails");
    assert_eq!(named(&|at| Vector3::new(at.x, at.y, -at.z)), Some(TURN));
    let half = 0.5;
    for (encoders_from_climber, text) in [
        ([-1.0, 0.0, 0.0, 1.0], "`rail_x` is reversed"),
        ([1.0, 0.0, 0.0, -1.0], "`rail_y` is reversed"),
        ([half, 0.0, 0.0, 1.0], "`rail_x` is reversed or its scale"),
        ([1.0, 0.0, 0.0, 2.0], "`rail_y` is reversed or its scale"),
        ([-1.0, 0.0, 0.0, -1.0], "both rails are reversed"),
        ([half, 0.0, 0.0, half], "both rails are reversed or their scale"),
        ([0.0, 1.0, 1.0, 0.0], "`rail_x` and `rail_y` are exchanged"),
        ([0.0, -1.0, -1.0, 0.0], "`rail_x` and `rail_y` are exchanged and reversed"),
        ([0.0, 1.0, -1.0, 0.0], "turned by 90°"),
        ([0.0, -1.0, 1.0, 0.0], "turned by 90°"),
    ] {
        let rails = Matrix2::from_row_slice(&encoders_from_climber);
        let read = |at: Vector3<f64>| (rails * at.xy()).push(at.z);
        let wrong = named(&read).unwrap_or_default();
        assert!(wrong.contains(text), "{rails}: {wrong}");
    }
    // Rails that move alike may be exchanged or reversed.
    let along = |t: f64| climber(t).x * Vector3::new(1.0, 1.0, 0.0);
    let mut alike = EncoderDirections::default();
    add_moving(&mut alike, 0.0..10.0, along, |t| -along(t));
    assert_eq!(alike.wrong(), Some(UNCLEAR));
}

#[test]
fn a_slip_and_noisy_readings_are_no_wrong_directions() {
    let mut random = Random::new(3);
    let mut directions = EncoderDirections::default();
    let slip = |t: f64| if t > 5.0 { 0.1 } else { 0.0 };
    add(&mut directions, 0.0..10.0, |t| climber(t) + Vector3::new(slip(t), 0.0, 0.0));
    assert_eq!(directions.wrong(), None);
    // At rest, readings that the motion does not explain are noise.
    let mut directions = EncoderDirections::default();
    add_moving(
        &mut directions,
        0.0..20.0,
        |_| Vector3::zeros(),
        |_| 0.003 * Vector3::new(random.normal(), random.normal(), 0.0),
    );
    assert_eq!(directions.wrong(), None);
}

#[test]
fn motion_along_an_axis_that_repeats_its_reading_is_unreported_until_it_moves() {
    for axis in 0..3 {
        let mut directions = EncoderDirections::default();
        let stuck = |t: f64| {
            let mut read = climber(t);
            read[axis] = climber(6.0)[axis];
            read
        };
        add(&mut directions, 0.0..6.0, climber);
        assert_eq!(directions.unreported(), [false; 3]);
        add(&mut directions, 6.0..9.0, stuck);
        assert_eq!(directions.unreported(), std::array::from_fn(|i| i == axis), "{axis}");
        add(&mut directions, 9.0..10.0, climber);
        assert_eq!(directions.unreported(), [false; 3]);
    }
    // Encoders that stand, with drift and bias of the IMU, of which the estimate knows the second.
    for (bias, unreported) in [(0.05, false), (0.1, true)] {
        let mut directions = EncoderDirections::default();
        let epoch = Stamp::from_nanos(1_760_001_000_000_000_000);
        for t in (0..300).map(|i| f64::from(i) / 30.0) {
            let shown = Vector3::new(0.4 * t + 0.1 * t * t, -3.0, 0.5 + bias * t);
            let calibrated = Vector3::new(shown.x, shown.y, 0.5);
            let (stamp, read) = (epoch.plus_seconds(t), Vector3::new(0.2, 0.3, 0.1));
            directions.compare(ClimberInstant { stamp, shown, calibrated, read });
        }
        assert_eq!(directions.unreported(), [false, false, unreported], "{bias} rad/s");
    }
}

#[test]
fn directions_that_were_corrected_are_right_again() {
    let mut directions = EncoderDirections::default();
    let reversed = |t| climber(t).component_mul(&Vector3::new(-1.0, 1.0, 1.0));
    add(&mut directions, 0.0..10.0, reversed);
    assert!(directions.wrong().is_some());
    add(&mut directions, 10.0..70.0, climber);
    assert_eq!(directions.wrong(), None);
}
