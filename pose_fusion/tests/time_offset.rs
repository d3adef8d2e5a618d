//! Camera and climber share a clock that is off against the IMU's: the offset is found and the
//! covariance knows.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
mod common;

use common::{
    bags,
    scoring::{self, Score},
    simulated,
};
use nalgebra::{Vector2, Vector3};
use pose_fusion::{Fusion, FusionConfig, Input, PoseStatus, Status, Warning};
use rig_model::Stamp;
use rig_simulator::{inertial::SensorConfig, motion::MotionConfig, random::Random};

/// The score of a run from a time on, and what the filter knows at the end.
fn follow(
    motion: MotionConfig,
    sensors: &SensorConfig,
    config: FusionConfig,
    from: f64,
) -> (Score, Status) {
    let run = simulated::run(motion, sensors);
    let (fusion, outputs) = scoring::follow(config, run.inputs());
    (scoring::score(&outputs.odometry, &run.truth, from), fusion.status())
}

fn shared(ahead: f64, seed: u64) -> SensorConfig {
    SensorConfig {
        camera_clock_ahead: ahead,
        climber_clock_ahead: ahead,
        ..SensorConfig::nominal(seed)
    }
}

#[test]
fn offsets_up_to_300_ms_are_estimated_to_a_millisecond() {
    for ahead in [-0.29, -0.15, -0.05, 0.02, 0.1, 0.29] {
        for seed in 1..=3 {
            let (score, status) =
                follow(MotionConfig::nominal(seed), &shared(ahead, seed), simulated::config(), 3.0);
            let (about, offset) = (format!("{ahead:+.2} s, seed {seed}"), status.time_offset);
            assert!((offset.offset + ahead).abs() < 1.5e-3, "{about}: {offset:?}");
            assert!(offset.sigma < 1e-3 && !offset.searching, "{about}: {offset:?}");
            assert_eq!(status.encoders.wrong_directions, None, "{about}");
            assert!(
                score.position_rmse() < 1.5 && score.nees().0 < 6.0 && score.nees().1 < 6.0,
                "{about}: {score}"
            );
        }
    }
}

/// One marker in a hundred is a few pixels off, and one in twenty five times noisier than it
/// claims: another offset fits those images that lack it. Before, offsets 40 to 290 ms off, and
/// valid poses up to 0.3 m off.
#[test]
fn a_few_false_markers_do_not_give_a_false_offset() {
    for (share, size) in [(0.0, 0.0), (0.01, 3.0), (0.05, 0.5)] {
        for seed in 1..=40 {
            let motion = MotionConfig { duration: 5.0, ..MotionConfig::nominal(seed) };
            let mut run = simulated::run(motion, &SensorConfig::nominal(seed));
            let mut random = Random::new(seed);
            for (_, input) in &mut run.inputs {
                let Input::Markers(image) = input else { continue };
                for marker in &mut image.markers.0 {
                    if random.unit() < share {
                        marker.centroid += size * Vector2::from_fn(|_, _| random.normal());
                    }
                }
            }
            let (_, outputs) = scoring::follow(FusionConfig::default(), run.inputs());
            let about = format!("{share} of the markers {size} px off, seed {seed}");
            let offsets = outputs.status.iter().map(|status| status.time_offset.abs());
            let largest = offsets.fold(0.0, f64::max);
            assert!(largest < 0.02, "{about}: {largest} s");
            let score = scoring::score(&outputs.odometry, &run.truth, 1.0);
            assert!(score.position_max() < 30.0, "{about}: {score}");
        }
    }
}

/// Stamps 150 and 200 ms off, four times the configured sigma: found roughly within two seconds.
#[test]
fn an_offset_far_beyond_its_sigma_is_found_soon() {
    for ahead in [-0.2, -0.15, 0.15, 0.2] {
        for seed in 1..=6 {
            let run = simulated::run(MotionConfig::nominal(seed), &shared(ahead, seed));
            let (_, outputs) = scoring::follow(FusionConfig::default(), run.inputs());
            let far = |s: &&PoseStatus| (s.time_offset + ahead).abs() > 0.05;
            let last = outputs.status.iter().rfind(far).unwrap().stamp;
            let lasts = last.seconds_since(run.start());
            assert!(lasts < 2.5, "{ahead:+.2} s, seed {seed}: far off for {lasts:.2} s");
        }
    }
}

/// Ten seconds after the start the offset is known to half a millisecond, at half a meter per
/// second a quarter of a millimeter.
#[test]
fn an_unknown_offset_costs_little() {
    let mut squares = [[0.0; 2]; 2];
    for seed in 1..=8 {
        let run = |sigma: f64| {
            let mut config = simulated::config();
            config.tight.clock.camera_sigma = sigma;
            follow(MotionConfig::nominal(seed), &SensorConfig::nominal(seed), config, 2.0).0
        };
        for (sum, sigma) in squares.iter_mut().zip([0.05, 1e-3]) {
            let score = run(sigma);
            assert!(score.nees().0 < 5.0 && score.nees().1 < 5.0, "known to {sigma} s: {score}");
            sum[0] += score.position_rmse().powi(2);
            sum[1] += score.rotation_rmse().powi(2);
        }
    }
    let ratio = [0, 1].map(|k| (squares[0][k] / squares[1][k]).sqrt());
    assert!(ratio[0] < 1.12 && ratio[1] < 1.04, "{ratio:?}");
}

#[test]
fn the_offset_is_unknown_without_motion() {
    let (score, status) = follow(MotionConfig::rest(1), &shared(0.04, 1), simulated::config(), 1.0);
    assert!(status.time_offset.searching && status.time_offset.sigma > 0.01, "{status:?}");
    assert!(score.position_rmse() < 1.0, "{score}");
}

/// A swing of 1.6 degrees below a climber at 6 cm/s: no window of 1.5 s shows the offset, but all
/// of them together do.
#[test]
fn the_offset_is_found_in_a_weak_motion_too() {
    for seed in 1..=3 {
        let nominal = MotionConfig::nominal(seed);
        let motion = MotionConfig {
            duration: 40.0,
            swing: 0.2 * nominal.swing,
            wobble: 0.2 * nominal.wobble,
            yaw: 0.2 * nominal.yaw,
            climber_speed: 0.2 * nominal.climber_speed,
            climber_turn_rate: 0.2 * nominal.climber_turn_rate,
            ..nominal
        };
        let (score, status) = follow(motion, &shared(0.08, seed), FusionConfig::default(), 1.0);
        let offset = status.time_offset;
        let error = (offset.offset + 0.08).abs();
        assert!(!offset.searching && error < 3.0 * offset.sigma, "seed {seed}: {offset:?}");
        assert!(offset.sigma < 0.003 && score.position_rmse() < 2.5, "seed {seed}: {score}");
    }
}

#[test]
fn a_constant_offset_of_the_climber_is_configured() {
    // The climber's stamps are 60 ms ahead: its readings are 60 ms older than their stamp.
    let sensors = SensorConfig { climber_clock_ahead: 0.06, ..SensorConfig::nominal(2) };
    let mut config = simulated::config();
    config.tight.clock.climber_offset = -0.06;
    let (configured, _) = follow(MotionConfig::nominal(2), &sensors, config.clone(), 0.3);
    let (ignored, _) = follow(MotionConfig::nominal(2), &sensors, simulated::config(), 3.0);
    assert!(configured.position_rmse() < 1.0 && configured.position_max() < 6.0, "{configured}");
    // Not applied, and bounded: the climber's speed (0.42 m/s at most) times the delay.
    assert!(ignored.position_max() < 1.3 * 420.0 * 0.06, "{ignored}");

    let run = simulated::run(MotionConfig::nominal(2), &sensors);
    let (_, outputs) = scoring::follow(config, run.inputs());
    let mut visual = Score::default();
    for p in &outputs.visual {
        visual.add(&p.pose, &p.covariance, &run.pose_at(p.stamp).unwrap());
    }
    assert!(visual.position_rmse() < 5.0, "{visual}");
}

#[test]
fn a_large_configured_offset_is_the_middle_of_what_is_searched() {
    for (ahead, configured) in [(-0.5, 0.5), (0.6, -0.6), (-0.7, 0.6)] {
        let mut config = simulated::config();
        config.tight.clock.camera_offset = configured;
        let (score, status) = follow(MotionConfig::nominal(3), &shared(ahead, 3), config, 3.0);
        assert!((status.time_offset.offset + ahead).abs() < 1.5e-3, "{ahead}: {status:?}");
        assert!(score.position_rmse() < 1.5 && score.nees().0 < 6.0, "{ahead}: {score}");
    }
}

/// With `clock.camera: 0` the offset is what the configuration says, also where images
/// contradict the prediction: here their stamps are 30 ms late from the middle on.
#[test]
fn a_known_offset_is_never_estimated() {
    let run = simulated::run(MotionConfig::nominal(3), &SensorConfig::nominal(3));
    let mut config = simulated::config();
    config.tight.clock.camera_sigma = 0.0;
    let inputs = run.changed(|at, input| match input {
        Input::Markers(m) if at > 6.0 => m.stamp = m.stamp.plus_seconds(0.03),
        _ => {}
    });
    let status = scoring::follow(config, inputs).0.status();
    assert!(status.counts.gated_markers > 0, "{status:?}");
    assert_eq!([status.time_offset.offset, status.time_offset.sigma], [0.0; 2], "{status:?}");
}

#[test]
fn the_offset_is_found_with_biases_that_are_known() {
    let mut config = simulated::config();
    (config.tight.imu.accelerometer_bias, config.tight.imu.gyroscope_bias) = (0.0, 0.0);
    let sensors = SensorConfig {
        accelerometer_bias: Vector3::zeros(),
        gyroscope_bias: Vector3::zeros(),
        ..shared(0.2, 2)
    };
    let (_, status) = follow(MotionConfig::nominal(2), &sensors, config, 3.0);
    assert!((status.time_offset.offset + 0.2).abs() < 1.5e-3, "{status:?}");
}

#[test]
fn what_is_smoothed_advances_over_a_restart_with_another_offset() {
    let run = simulated::run(MotionConfig::nominal(3), &shared(0.2, 3));
    let mut fusion = Fusion::new(simulated::rig(), simulated::config());
    fusion.keep_for_smoothing();
    let _ = scoring::run(&mut fusion, run.inputs());
    assert!(fusion.status().counts.resets.time_offsets > 0);
    let smoothed = fusion.smoothed(true);
    let back = smoothed.windows(2).filter(|w| w[1].stamp <= w[0].stamp).count();
    assert!(smoothed.len() > 500 && back == 0, "{back} of {} go back", smoothed.len());
}

/// Moves the stamp of an image or encoder reading by seconds that depend on it.
fn shift(input: &mut Input, by: impl Fn(Stamp) -> f64) {
    let is_imu = matches!(input, Input::Imu(_));
    if let Some(stamp) = simulated::stamp_of(input).filter(|_| !is_imu) {
        *stamp = stamp.plus_seconds(by(*stamp));
    }
}

/// When the camera's latency changes, s after the start: another computer or driver.
const CHANGE: f64 = 6.0;

/// A run whose images and encoder readings are stamped `by` seconds later from [`CHANGE`] on.
fn changing(seed: u64, by: f64) -> (simulated::Run, Vec<Input>) {
    changing_in(MotionConfig { duration: 16.0, ..MotionConfig::nominal(seed) }, seed, by)
}

fn changing_in(motion: MotionConfig, seed: u64, by: f64) -> (simulated::Run, Vec<Input>) {
    let run = simulated::run(motion, &SensorConfig::nominal(seed));
    let change = run.start().plus_seconds(CHANGE);
    let inputs = run.changed(|_, input| shift(input, |at| if at > change { by } else { 0.0 }));
    (run, inputs)
}

#[test]
fn an_offset_that_changes_is_found_again() {
    for (by, seed) in [(0.06, 1), (-0.06, 2), (0.15, 3), (-0.15, 4)] {
        let (run, inputs) = changing(seed, by);
        let (fusion, outputs) = scoring::follow(simulated::config(), inputs);
        let score = scoring::score(&outputs.odometry, &run.truth, CHANGE + 4.0);
        let status = fusion.status();
        let about = format!("{by:+.2} s: {score}, {:?}", outputs.warnings);
        assert!((status.time_offset.offset + by).abs() < 2e-3, "{about}, {status:?}");
        assert!(score.position_rmse() < 1.0 && score.nees().0 < 6.0, "{about}");
    }
}

/// Another exposure time moves the middle of the exposure by milliseconds: too little for an
/// alignment, and enough to contradict a fast motion.
#[test]
fn an_offset_that_changes_by_milliseconds_is_followed() {
    for (by, seed) in [(0.008, 1), (-0.008, 2), (0.015, 3), (-0.015, 4)] {
        let motion = MotionConfig { duration: 16.0, ..MotionConfig::fast_swing(seed) };
        let (run, inputs) = changing_in(motion, seed, by);
        let (_, outputs) = scoring::follow(simulated::config(), inputs);
        let score = scoring::score(&outputs.odometry, &run.truth, CHANGE + 1.0);
        assert!(score.position_rmse() < 2.0 && score.position_max() < 20.0, "{by}: {score}");
        let lost = outputs.status.iter().filter(|s| !s.valid).count();
        assert!(lost < 100, "{by}: {lost} poses not valid");
    }
}

/// Images that a frozen filter does not use cannot restart it either.
#[test]
fn a_frozen_filter_keeps_its_pose_when_the_offset_changes() {
    // Stamps that go back: a gap in them excuses the images, and nothing is searched.
    let (run, inputs) = changing(1, -0.06);
    let mut fusion = Fusion::new(simulated::rig(), simulated::config());
    let (mut frozen, mut lost) = (0, 0);
    for input in inputs {
        fusion.handle(input);
        while fusion.poll().is_some() {}
        let searches = fusion.status().time_offset.searching;
        let since = fusion.status().newest_imu.map(|at| at.seconds_since(run.start()));
        if since.is_some_and(|s| s > CHANGE) && searches && frozen == 0 {
            fusion.freeze(true).unwrap();
            frozen = 1;
        } else if (1..400).contains(&frozen) {
            frozen += 1;
            lost += usize::from(!fusion.status().initialized);
            if frozen == 400 {
                fusion.freeze(false).unwrap();
            }
        }
    }
    let status = fusion.status();
    assert!(frozen == 400 && lost == 0, "{frozen} {lost}");
    assert!((status.time_offset.offset - 0.06).abs() < 2e-3, "{status:?}");
}

/// A rolling shutter: each marker is seen at the time of its row.
#[test]
fn a_rolling_shutter_with_its_readout_time_costs_little() {
    for (seed, readout) in [(1, 0.02), (2, -0.02), (3, 0.03)] {
        let score = |readout: f64, configured: f64| {
            let sensors = SensorConfig { image_readout: readout, ..SensorConfig::nominal(seed) };
            let run = simulated::run(MotionConfig::fast_swing(seed), &sensors);
            let mut config = simulated::config();
            config.tight.clock.image_readout = configured;
            let (fusion, outputs) = scoring::follow(config, run.inputs());
            let score = scoring::score(&outputs.odometry, &run.truth, 2.0);
            (score, fusion.status())
        };
        let (known, ignored) = (score(readout, readout), score(readout, 0.0));
        assert!(!known.1.time_offset.searching, "{:?}", known.1);
        let (known, ignored) = (known.0, ignored.0);
        let global = score(0.0, 0.0).0;
        assert!(known.position_rmse() < 1.2 * global.position_rmse(), "{known}");
        assert!(known.rotation_rmse() < 1.2 * global.rotation_rmse(), "{known}");
        assert!(known.nees().0 < 5.0 && known.nees().1 < 5.0, "{known}");
        assert!(ignored.position_rmse() > 2.0 * known.position_rmse(), "{ignored}");
    }
}

/// Images stamped when they arrive: a USB camera's driver, by milliseconds.
#[test]
fn jitter_of_the_image_stamps_costs_little() {
    for (jitter, seed) in [(0.002, 1), (0.005, 2), (0.010, 3)] {
        let run = simulated::run(MotionConfig::nominal(seed), &SensorConfig::nominal(seed));
        let mut random = Random::fork(seed, "stamps");
        let inputs = run.changed(|_, input| {
            if let Input::Markers(m) = input {
                m.stamp = m.stamp.plus_seconds(random.within(-jitter, jitter));
            }
        });
        let [found, ignored] = [0.02, 0.0].map(|most| {
            let mut config = simulated::config();
            config.tight.clock.image_jitter = most;
            let (_, outputs) = scoring::follow(config, inputs.clone());
            scoring::score(&outputs.odometry, &run.truth, 4.0)
        });
        assert!(found.position_rmse() < 1.5 && found.position_max() < 6.0, "{found}");
        for score in [&found, &ignored] {
            assert!(score.nees().0 < 6.0 && score.nees().1 < 6.0, "{score}");
        }
        // The parameter switches it off: what the motion makes of it counts as shake of the camera.
        assert!(ignored.position_rmse() > 1.1 * found.position_rmse(), "{ignored}");
    }
}

/// A rig that rests for a while after the start and then swings; everything arrives 5 ms after its
/// instant, and where the computer is `held_up`, the IMU samples of 0.4 s arrive together, after
/// the images. Returns the share of the odometry beyond the covariance's 1 in 10 000, and the error
/// of the offset, s.
fn after_a_rest(seed: u64, ahead: f64, held_up: bool) -> (f64, f64) {
    const REST: f64 = 2.0;
    let motion =
        MotionConfig { still_until: REST, duration: REST + 4.0, ..MotionConfig::nominal(seed) };
    let sensors = SensorConfig { pixel_noise: 0.03, ..shared(ahead, seed) };
    let run = simulated::run(motion, &sensors);
    let instant = |input: &Input| match input {
        Input::Imu(s) => Some(s.stamp),
        Input::Climber(s) => Some(s.stamp.plus_seconds(-ahead)),
        Input::Markers(s) => Some(s.stamp.plus_seconds(-ahead)),
        Input::Camera(_) => None,
    };
    let mut inputs: Vec<(f64, Input)> = Vec::new();
    for (_, input) in &run.inputs {
        let mut arrival = instant(input).map_or(-1.0, |at| at.seconds_since(sensors.epoch) + 0.005);
        if held_up && matches!(input, Input::Imu(_)) && (0.6..REST + 0.6).contains(&arrival) {
            arrival = 0.6 + ((arrival - 0.6) / 0.4).ceil() * 0.4;
        }
        inputs.push((arrival, input.clone()));
    }
    inputs.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (fusion, outputs) =
        scoring::follow(simulated::config(), inputs.into_iter().map(|(_, input)| input));
    let beyond = scoring::errors(&outputs.odometry, &run.truth)
        .filter(|(_, _, nees)| nees[0].max(nees[1]) > 21.1);
    let share = beyond.count() as f64 / outputs.odometry.len() as f64;
    (share, fusion.status().time_offset.offset + ahead)
}

/// The clock of camera and climber runs 200 ppm fast against the IMU's.
#[test]
fn clocks_that_drift_apart_are_followed() {
    const DRIFT: f64 = 2e-4;
    for (seed, motion) in simulated::motions() {
        let sensors = SensorConfig::nominal(seed);
        let run = simulated::run(MotionConfig { duration: 60.0, ..motion }, &sensors);
        let drift = |at: Stamp| DRIFT * at.seconds_since(sensors.epoch);
        let inputs = run.changed(|_, input| shift(input, drift));
        let (fusion, outputs) = scoring::follow(FusionConfig::default(), inputs);
        let (score, status) = (scoring::score(&outputs.odometry, &run.truth, 3.0), fusion.status());
        // A random walk follows a drift with a lag.
        assert!((status.time_offset.offset + DRIFT * 60.0).abs() < 4e-3, "{status:?}");
        assert!(score.nees().0 < 7.0 && score.nees().1 < 7.0, "{score}");
    }
}

#[test]
fn rest_and_computer_stalls_do_not_bias_the_offset() {
    for held_up in [false, true] {
        for ahead in [-0.1, -0.06, 0.0, 0.06, 0.1] {
            let (mut shares, mut worst) = (0.0, 0.0_f64);
            for seed in 1..=4 {
                let (share, off) = after_a_rest(seed, ahead, held_up);
                shares += share / 4.0;
                worst = worst.max(off.abs());
            }
            assert!(shares < 0.02 && worst < 2e-3, "{ahead} {held_up}: {shares} {worst}");
        }
    }
}

#[test]
fn a_recording_with_shifted_camera_and_climber_is_tracked() {
    for name in ["nominal", "occlude_two", "clutter", "fast_swing"] {
        for ahead in [0.0, 0.04, -0.03, 0.2] {
            let Some(mut bag) = bags::read(name, 0.1, 1) else { return };
            bag.inputs.iter_mut().for_each(|(_, input)| shift(input, |_| ahead));
            let mut fusion = Fusion::new(bag.rig.clone(), FusionConfig::default());
            let outputs = scoring::run(&mut fusion, bag.inputs());
            let (score, status) =
                (scoring::score(&outputs.odometry, &bag.truth, 6.0), fusion.status());
            assert!(
                outputs.warnings.iter().any(|w| matches!(w, Warning::TimeOffset { .. })),
                "{name} {ahead}"
            );
            assert!((status.time_offset.offset + ahead).abs() < 1.5e-3, "{name}: {status:?}");
            assert!(score.nees().0 < 6.0 && score.nees().1 < 6.0, "{name} {ahead}: {score}");
        }
    }
}
