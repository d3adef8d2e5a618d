//! Starts with nothing known: motion, biases and time offset at random, a rest before some.

use super::common::{
    scoring::{self, Outputs, Score},
    simulated,
};
use nalgebra::{UnitQuaternion, Vector3};
use pose_fusion::{FusionConfig, Input, Warning};
use rig_model::MarkerObservation;
use rig_simulator::{inertial::SensorConfig, motion::MotionConfig, parallel, random::Random};
use std::fmt;

/// Length of a run, s, and of its beginning that does not count.
const LENGTH: f64 = 8.0;
const BEGINNING: f64 = 1.0;
/// A correction moves the published position by no more than this from one message to the next, m.
const STEP: f64 = 3e-3;
/// Twice the expected value of the mean NEES of three degrees of freedom.
const NEES: f64 = 6.0;
/// Largest position RMSE of a run, mm.
const RMSE: f64 = 10.0;

struct Start {
    seed: u64,
    about: String,
    score: Score,
    step: f64,
}

impl fmt::Display for Start {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { seed, about, score, step } = self;
        write!(f, "seed {seed}: step {:.1} mm, {score}; {about}", step * 1e3)
    }
}

impl Start {
    fn holds(&self) -> bool {
        let (position, rotation) = self.score.nees();
        let consistent = position < NEES && rotation < NEES;
        consistent && self.step <= STEP && self.score.position_rmse() < RMSE
    }
}

/// Everything of a start follows from its seed.
fn scene(seed: u64) -> (MotionConfig, SensorConfig) {
    let mut r = Random::fork(seed, "start");
    let rests = r.within(0.0, 1.0) < 0.4;
    let motion = MotionConfig {
        duration: LENGTH,
        still_until: if rests { r.within(0.3, 3.0) } else { -10.0 },
        ramp: r.within(0.4, 1.5),
        swing: r.within(0.0, 0.5),
        frequency: r.within(0.35, 0.9),
        wobble: r.within(0.0, 0.1),
        yaw: r.within(0.0, 0.5),
        climber_speed: r.within(0.0, 0.4),
        climber_turn_rate: r.within(0.0, 0.2),
        ..MotionConfig::nominal(seed)
    };
    let mut vector = |sigma: f64| Vector3::from_fn(|_, _| r.normal() * sigma);
    let (accelerometer_bias, gyroscope_bias) = (vector(0.08), vector(0.03));
    let ahead = r.within(-0.1, 0.1);
    let imu_rate = [100.0, 200.0, 286.0][(r.within(0.0, 3.0) as usize).min(2)];
    let sensors = SensorConfig {
        accelerometer_bias,
        gyroscope_bias,
        imu_rate,
        attitude_error: if r.within(0.0, 1.0) < 0.5 { 0.0 } else { 0.0096 },
        camera_clock_ahead: ahead,
        climber_clock_ahead: ahead,
        ..SensorConfig::nominal(seed)
    };
    (motion, sensors)
}

/// Largest change of the position error from one message to the next, m.
fn largest_step(outputs: &Outputs, run: &simulated::Run) -> f64 {
    let begin = run.start().plus_seconds(BEGINNING);
    let errors: Vec<Vector3<f64>> = outputs
        .odometry
        .iter()
        .filter(|o| o.stamp >= begin)
        .filter_map(|o| {
            let truth = run.pose_at(o.stamp)?;
            Some(o.world_from_volant.translation.vector - truth.translation.vector)
        })
        .collect();
    errors.windows(2).map(|pair| (pair[1] - pair[0]).norm()).fold(0.0, f64::max)
}

fn start(seed: u64) -> Start {
    let (motion, sensors) = scene(seed);
    let about = format!(
        "rest until {:.1} s, swing {:.2} rad at {:.2} Hz, climber {:.2} m/s, offset {:+.0} ms, IMU {} Hz{}",
        motion.still_until.max(0.0),
        motion.swing,
        motion.frequency,
        motion.climber_speed,
        sensors.camera_clock_ahead * 1e3,
        sensors.imu_rate,
        if sensors.attitude_error == 0.0 { " without attitude" } else { "" }
    );
    let run = simulated::run(motion, &sensors);
    let (_, outputs) = scoring::follow(FusionConfig::default(), run.inputs());
    let score = scoring::score(&outputs.odometry, &run.truth, BEGINNING);
    assert!(score.count() as f64 > 0.9 * (LENGTH - BEGINNING) * sensors.imu_rate, "seed {seed}");
    let step = largest_step(&outputs, &run);
    Start { seed, about, score, step }
}

/// Runs the starts of all seeds on all processors and returns those that do not hold.
fn failing(seeds: std::ops::Range<u64>) -> Vec<Start> {
    let seeds: Vec<u64> = seeds.collect();
    let all = parallel::map(parallel::processors(), seeds.len(), || (), |(), i| start(seeds[i]));
    all.into_iter().filter(|start| !start.holds()).collect()
}

fn lines(starts: &[Start]) -> String {
    starts.iter().map(|start| format!("\n{start}")).collect()
}

#[test]
fn starts_are_consistent_and_without_steps() {
    let failing = failing(1..31);
    let near = failing.iter().all(|start| start.score.position_rmse() < RMSE);
    assert!(failing.len() <= 1 && near, "{}", lines(&failing));
}

/// Without the IMU's attitude, in a swing of 20° and more: of the two poses that one image allows
/// the one is taken in which the specific force points along the rope.
#[test]
fn a_fast_swing_is_no_tilt_of_the_platform() {
    for seed in [3085, 4151] {
        let found = start(seed);
        assert!(found.holds(), "{found}");
    }
}

#[test]
#[ignore = "200 starts: a minute"]
fn two_hundred_starts_are_consistent_and_without_steps() {
    let failing = failing(1000..1200);
    // Before the time offset is known, little motion or much of it leaves errors of a second.
    assert!(failing.len() <= 2, "{}", lines(&failing));
}

/// Three markers allow up to four poses, and in a swing "up" hardly tells them apart: the gyroscope
/// does. Before, seed 27 began with a mirrored one: NEES 422.
#[test]
fn a_marker_that_is_hidden_while_the_platform_swings_starts_no_mirrored_pose() {
    let worst = |seed: u64| {
        let motion = MotionConfig {
            duration: 4.0,
            still_until: -10.0,
            swing: 0.3,
            wobble: 0.15,
            ..MotionConfig::nominal(seed)
        };
        let sensors = SensorConfig { attitude_error: 0.0, ..SensorConfig::nominal(seed) };
        let run = simulated::run(motion, &sensors);
        let hidden = (seed % 4) as usize;
        let inputs = run.changed(|at, input| {
            if let (Input::Markers(image), true) = (input, at < 1.4) {
                image.markers.0[hidden] = MarkerObservation::lost(MarkerObservation::NEVER);
            }
        });
        let (_, outputs) = scoring::follow(FusionConfig::default(), inputs);
        let first = outputs.odometry[0].stamp.seconds_since(run.start());
        assert!(first < 1.1, "seed {seed}: the first pose comes after {first:.2} s");
        let errors = scoring::errors(&outputs.odometry, &run.truth);
        let worst = errors.map(|(_, _, nees)| nees[0].max(nees[1])).fold(0.0, f64::max);
        (seed, worst)
    };
    let all = parallel::map(parallel::processors(), 40, || (), |(), i| worst(i as u64));
    let off: Vec<_> = all.into_iter().filter(|(_, nees)| *nees > 40.0).collect();
    assert!(off.is_empty(), "seed, NEES: {off:?}");
}

/// A pose is valid once images have agreed with it for 0.2 s, and no longer while they contradict
/// it. Before, one with the gyroscope's axes negated was valid 505 mm off.
#[test]
fn a_pose_that_images_have_not_confirmed_is_not_valid() {
    let worst = |seed: u64, sign: f64| {
        let motion = MotionConfig {
            duration: 6.0,
            still_until: -10.0,
            swing: 0.25,
            wobble: 0.15,
            ..MotionConfig::nominal(seed)
        };
        let sensors =
            SensorConfig { attitude_error: 0.0, image_rate: 10.0, ..SensorConfig::nominal(seed) };
        let run = simulated::run(motion, &sensors);
        let inputs = run.changed(|_, input| {
            if let Input::Imu(sample) = input {
                sample.angular_velocity *= sign;
            }
        });
        let (_, outputs) = scoring::follow(FusionConfig::default(), inputs);
        let valid = outputs.valid();
        let errors = scoring::errors(&valid, &run.truth);
        errors.map(|(_, error, _)| error.position.norm()).fold(0.0, f64::max)
    };
    for (sign, limit) in [(1.0, 0.12), (-1.0, 0.2)] {
        let all = parallel::map(parallel::processors(), 20, || (), |(), i| worst(i as u64, sign));
        let off: Vec<_> = all.iter().enumerate().filter(|(_, worst)| **worst > limit).collect();
        assert!(off.is_empty(), "gyroscope times {sign}: seed, m: {off:?}");
    }
}

/// With the first image the velocity is unknown: until the second, the position may become too
/// uncertain. One that never comes is reported.
#[test]
fn a_pose_is_not_reported_as_lost_while_its_second_image_is_due() {
    for image_rate in [5.0, 10.0, 25.0] {
        let sensors = SensorConfig { image_rate, ..SensorConfig::nominal(3) };
        let run =
            simulated::run(MotionConfig { duration: 10.0, ..MotionConfig::nominal(3) }, &sensors);
        // The first 60 ms give no pose; then one or two images do.
        for lost_from in [f64::INFINITY, 4.0, f64::max(1.5 / image_rate, 0.1)] {
            let inputs = run.inputs().filter(|input| {
                !matches!(input, Input::Markers(m)
                    if m.stamp.seconds_since(sensors.epoch) > lost_from)
            });
            let (_, outputs) = scoring::follow(FusionConfig::default(), inputs);
            let lost = |w: &&Warning| matches!(w, Warning::PoseLost { .. });
            let reported = outputs.warnings.iter().filter(lost).count();
            assert_eq!(reported, usize::from(lost_from < 5.0), "{image_rate} {lost_from}");
        }
    }
}

/// Two publishers 10 m apart, and positions in millimeters: readings that no climber reaches one
/// after another initialize nothing, and the status names them.
#[test]
fn encoder_readings_that_leap_initialize_no_pose_and_are_reported() {
    // Of a position, and the number of the reading.
    type Change = fn(&mut Vector3<f64>, usize);
    let changes: [(&str, Change); 2] = [
        ("two publishers", |position, k| position.x += if k % 2 == 0 { 10.0 } else { 0.0 }),
        ("millimeters", |position, _| position.x *= 1e3),
    ];
    for (name, change) in changes {
        let motion = MotionConfig {
            duration: 4.0,
            still_until: -10.0,
            climber_speed: 0.3,
            ..MotionConfig::nominal(1)
        };
        let run = simulated::run(motion, &SensorConfig::nominal(1));
        let mut count = 0;
        let inputs = run.changed(|_, input| {
            if let Input::Climber(sample) = input {
                change(&mut sample.world_from_climber.translation.vector, count);
                count += 1;
            }
        });
        let (_, outputs) = scoring::follow(FusionConfig::default(), inputs);
        let valid = outputs.status.iter().filter(|status| status.valid).count();
        let named = outputs.status.iter().filter(|s| s.reason.contains("second publisher")).count();
        assert_eq!(valid, 0, "{name}");
        assert!(named > 10, "{name}: {named}");
    }
}

/// The attitude that an IMU estimates is off by far more than it claims while the platform swings:
/// named, and not used. Before, from 5° on, the filter never started.
#[test]
fn an_attitude_that_the_imu_claims_wrongly_is_named_and_costs_nothing() {
    for seed in 0..6 {
        let (motion, sensors) = scene(seed);
        let sensors = SensorConfig { attitude_error: 0.0096, ..sensors };
        let run = simulated::run(motion, &sensors);
        let score = |degrees: f64| {
            let axis = Vector3::new((seed as f64).cos(), (seed as f64).sin(), 0.0);
            let error = UnitQuaternion::new(axis * degrees.to_radians());
            let inputs = run.changed(|_, input| {
                if let Input::Imu(sample) = input {
                    let orientation = sample.orientation.as_mut().unwrap();
                    orientation.enu_from_imu = error * orientation.enu_from_imu;
                }
            });
            let (_, outputs) = scoring::follow(FusionConfig::default(), inputs);
            let named = outputs.warnings.iter().any(|w| matches!(w, Warning::ImuAttitude { .. }));
            (scoring::score(&outputs.odometry, &run.truth, 4.0), named)
        };
        let (clean, false) = score(0.0) else { panic!("named without an error") };
        for degrees in [8.0, 15.0] {
            let (off, named) = score(degrees);
            let about = format!("seed {seed}, {degrees}°: {off} (clean {clean})");
            assert!(named, "{about}");
            assert!(off.position_rmse() < 1.3 * clean.position_rmse(), "{about}");
            assert!(off.rotation_rmse() < 1.3 * clean.rotation_rmse(), "{about}");
        }
    }
}
