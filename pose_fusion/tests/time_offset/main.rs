//! Camera and climber share a clock that is off against the IMU's: the offset is found and the
//! covariance knows.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#[path = "../common/mod.rs"]
mod common;
mod stamps;

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

/// Tilts of single images from 4 m away are too uncertain to align. The filter determines its
/// offset by itself; before, the claimed sigma stayed at 20 to 60 mm.
#[test]
fn the_offset_is_known_on_a_long_rope_with_noisy_pixels() {
    for ahead in [0.0, 0.02, -0.05] {
        for seed in 1..=4 {
            let motion = MotionConfig {
                climber_height: 4.5,
                platform_height: 0.5,
                frequency: 0.26,
                swing: 0.07,
                wobble: 0.02,
                duration: 25.0,
                ..MotionConfig::nominal(seed)
            };
            let sensors = SensorConfig { pixel_noise: 0.25, ..shared(ahead, seed) };
            let (score, status) = follow(motion, &sensors, simulated::config(), 12.0);
            let (about, offset) = (format!("{ahead:+.2} s, seed {seed}"), status.time_offset);
            assert!(!offset.searching, "{about}: {offset:?}");
            assert!((offset.offset + ahead).abs() < 4.0 * offset.sigma, "{about}: {offset:?}");
            assert!(status.position_sigma < 6e-3, "{about}: {}", status.position_sigma);
            assert!(score.nees().0 < 6.0 && score.nees().1 < 6.0, "{about}: {score}");
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
