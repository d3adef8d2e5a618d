//! The filter on the simulated rig with known truth: each test is a row of required figures.
#[path = "../common/mod.rs"]
mod common;
mod outliers;
mod prediction;
mod published;
mod swing;

use common::{
    scoring::{self, Outputs, Score},
    simulated,
};
use nalgebra::Vector3;
use pose_fusion::{Fusion, FusionConfig, Input, Status};
use rig_model::MarkerColor;
use rig_simulator::{inertial::SensorConfig, motion::MotionConfig};

struct Outcome {
    score: Score,
    outputs: Outputs,
    status: Status,
}

fn follow_from(
    motion: MotionConfig,
    sensors: &SensorConfig,
    config: FusionConfig,
    from: f64,
) -> Outcome {
    let run = simulated::run(motion, sensors);
    let (fusion, outputs) = scoring::follow(config, run.inputs());
    Outcome {
        score: scoring::score(&outputs.odometry, &run.truth, from),
        status: fusion.status(),
        outputs,
    }
}

fn follow(motion: MotionConfig, sensors: &SensorConfig) -> Outcome {
    follow_from(motion, sensors, simulated::config(), 1.0)
}

fn consistent(score: &Score, low: f64, high: f64) -> bool {
    let (p, r) = score.nees();
    (low..high).contains(&p) && (low..high).contains(&r)
}

#[test]
fn a_tenth_of_a_pixel_gives_a_millimeter_and_a_consistent_covariance() {
    for seed in 0..5 {
        for motion in [MotionConfig::nominal(seed), MotionConfig::fast_swing(seed)] {
            let o = follow(motion, &SensorConfig::nominal(seed));
            let near = o.score.position_rmse() < 1.0 && o.score.rotation_rmse() < 0.15;
            assert!(near && consistent(&o.score, 1.0, 6.0), "seed {seed}: {}", o.score);
            assert_eq!(o.status.counts.resets.recoveries, 0);
            // One odometry with every IMU sample once it runs, in order.
            assert!(o.outputs.odometry.windows(2).all(|w| {
                let gap = w[1].stamp.seconds_since(w[0].stamp);
                gap > 0.0 && gap < 0.03
            }));
        }
    }
}

/// White noise has the same density at every rate: bounds must be in time, not in samples.
#[test]
fn imu_rates_from_50_to_1000_hz_give_the_same_accuracy() {
    for rate in [50.0, 200.0, 400.0, 1000.0] {
        for seed in 0..2 {
            let sensors = SensorConfig { imu_rate: rate, ..SensorConfig::nominal(seed) };
            let o = follow(MotionConfig::nominal(seed), &sensors);
            assert!(
                o.score.position_rmse() < 0.9 && consistent(&o.score, 1.0, 5.0),
                "{rate} Hz, seed {seed}: {}",
                o.score
            );
            assert_eq!(o.status.counts.inputs.overflows, 0, "{rate} Hz, seed {seed}");
        }
    }
}

#[test]
fn images_ahead_of_the_imu_samples_cost_little() {
    for seed in [1, 2] {
        let all = follow(MotionConfig::nominal(seed), &SensorConfig::nominal(seed));
        let early = SensorConfig {
            image_delay: [0.003, 0.006],
            climber_delay: [0.001, 0.002],
            imu_delay: [0.006, 0.009],
            ..SensorConfig::nominal(seed)
        };
        let o = follow(MotionConfig::nominal(seed), &early);
        assert!(o.score.position_rmse() < 1.7 * all.score.position_rmse(), "{}", o.score);
        assert!(consistent(&o.score, 1.0, 6.0), "{}", o.score);
        assert_eq!(o.status.counts.rejected.images + o.status.counts.rejected.climber, 0);
    }
}

#[test]
fn hidden_markers_cost_little() {
    let n = || MotionConfig { duration: 20.0, ..MotionConfig::nominal(3) };
    let hide = |colors: &[MarkerColor], from: f64, to: f64| SensorConfig {
        hidden: colors.iter().map(|c| (*c, from, to)).collect(),
        ..SensorConfig::nominal(3)
    };
    use MarkerColor::{Blue, Red};
    let minute = || MotionConfig { duration: 65.0, ..MotionConfig::nominal(3) };
    let seen = follow(minute(), &SensorConfig::nominal(3)).score;
    let one = follow(minute(), &hide(&[Red], 4.0, 64.0)).score;
    assert!(
        one.position_rmse() < 1.5 * seen.position_rmse()
            && one.rotation_rmse() < 1.5 * seen.rotation_rmse(),
        "over a minute\nall  {seen}\none  {one}"
    );
    let all = follow(n(), &SensorConfig::nominal(3)).score;
    let two = follow(n(), &hide(&[Red, Blue], 5.0, 15.0)).score;
    assert!(
        two.position_rmse() < 2.0 * all.position_rmse()
            && two.rotation_rmse() < 2.0 * all.rotation_rmse(),
        "over twenty seconds\nall  {all}\ntwo  {two}"
    );
    for (gap, limit) in [(0.5, 15.0), (1.0, 50.0)] {
        let none = follow(n(), &hide(&MarkerColor::ALL, 8.0, 8.0 + gap));
        assert!(
            none.score.position_max() < limit && consistent(&none.score, 1.0, 6.0),
            "none for {gap} s  {}",
            none.score
        );
    }
}

#[test]
fn ten_times_the_noise_and_large_biases_are_estimated() {
    for seed in 0..10 {
        let sensors = SensorConfig {
            imu_noise_factor: 10.0,
            accelerometer_bias: Vector3::new(0.2, -0.2, 0.2),
            gyroscope_bias: Vector3::new(0.087, -0.087, 0.05),
            ..SensorConfig::nominal(seed)
        };
        let motion = || MotionConfig { duration: 30.0, ..MotionConfig::nominal(seed) };
        let o = follow_from(motion(), &sensors, simulated::config(), 10.0);
        // The same filter with the true densities and bias sizes in the rig file.
        let mut rig = simulated::rig();
        rig.imu.accelerometer_noise_density *= 10.0;
        rig.imu.gyroscope_noise_density *= 10.0;
        let mut config = simulated::config();
        config.tight.imu.accelerometer_bias = 0.2;
        config.tight.imu.gyroscope_bias = 0.08;
        let run = simulated::run(motion(), &sensors);
        let mut fusion = Fusion::new(rig, config);
        let outputs = scoring::run(&mut fusion, run.inputs());
        let best = scoring::score(&outputs.odometry, &run.truth, 10.0);
        let density = o.status.imu_noise.force.sqrt();
        assert!((density / 0.02 - 1.0).abs() < 0.25, "seed {seed}: {density}");
        let ratios = (
            o.score.position_rmse() / best.position_rmse(),
            o.score.rotation_rmse() / best.rotation_rmse(),
        );
        assert!(
            consistent(&o.score, 1.2, 5.0) && ratios.0 <= 1.3 && ratios.1 <= 1.3,
            "seed {seed}: {}\nwith known densities {best}",
            o.score
        );
    }
}

/// A drive that is switched on, or an end stop that is hit: up to 36 m/s² for a tenth of a second.
#[test]
fn a_jerk_of_the_climber_does_not_change_the_time_offset() {
    for ramp in [0.3, 1.0] {
        for seed in 0..6 {
            let motion = MotionConfig { still_until: 1.5, ramp, ..MotionConfig::nominal(seed) };
            let o = follow(motion, &SensorConfig::nominal(seed));
            let near = o.score.position_rmse() < 1.0 && o.score.position_max() < 6.0;
            let about = format!("ramp {ramp} s, seed {seed}: {}", o.score);
            assert!(near && consistent(&o.score, 0.5, 6.0), "{about}");
            assert!(
                o.status.counts.resets.recoveries == 0 && o.status.time_offset.offset.abs() < 2e-3,
                "{about}, {:?}",
                o.status
            );
        }
    }
}

/// Sensors that fill more than half of the history. Before, encoder readings that arrived before
/// the IMU sample of their time were dropped, and the climber stood still.
#[test]
fn every_reading_is_used_at_the_highest_rates() {
    let nominal = SensorConfig::nominal(1);
    let sensors = SensorConfig {
        imu_rate: 1000.0,
        imu_delay: [0.003, 0.0035],
        climber_rate: 200.0,
        climber_delay: [0.0004, 0.0006],
        ..nominal
    };
    let run = simulated::run(MotionConfig { duration: 6.0, ..MotionConfig::nominal(1) }, &sensors);
    let mut config = simulated::config();
    config.tight.history = 1.0;
    let (_, outputs) = scoring::follow(config, run.inputs());
    let score = scoring::score(&outputs.odometry, &run.truth, 2.0);
    let oldest = outputs.status.iter().skip(3000).map(|s| s.climber_age).fold(0.0, f64::max);
    assert!(score.position_rmse() < 1.0 && oldest < 0.05, "{score}, {oldest} s");
}

/// The IMU was switched on a moment before: biases and clocks are uncertain at the start.
#[test]
fn a_swing_after_a_short_rest_is_consistent() {
    let (mut all, mut beyond) = (0_u32, Vec::new());
    for seed in 0..40 {
        let rest = 0.4 + 0.065 * seed as f64;
        let motion = MotionConfig {
            still_until: rest,
            duration: rest + 2.0,
            ..MotionConfig::nominal(4 * (seed % 5))
        };
        let run = simulated::run(motion, &SensorConfig::nominal(seed));
        let (_, outputs) = scoring::follow(simulated::config(), run.inputs());
        for (t, _, nees) in scoring::errors(&outputs.odometry, &run.truth) {
            if t > rest {
                all += 1;
                let most = nees[0].max(nees[1]);
                beyond.extend((most > 21.1).then_some((seed, t - rest, most)));
            }
        }
    }
    let count = beyond.len();
    assert!(count as f64 <= 0.001 * f64::from(all), "{count} of {all}; seed, s, NEES: {beyond:?}");
}

/// Meters on the platform for each pixel, in the middle of the simulated rig's height.
const PER_PIXEL: f64 = 1.4 / 590.0;

#[test]
fn a_marker_off_its_place_is_found_and_the_pose_goes_on() {
    for (seed, off) in [(0, 0.002), (1, 0.005), (2, -0.005), (3, 0.01), (4, -0.005), (5, 0.005)] {
        let run = simulated::run(MotionConfig::nominal(seed), &SensorConfig::nominal(seed));
        let mut rig = simulated::rig();
        rig.markers.centers.0[seed as usize % 4].y += off;
        let mut fusion = Fusion::new(rig, FusionConfig::default());
        let outputs = scoring::run(&mut fusion, run.inputs());
        let score = scoring::score(&outputs.odometry, &run.truth, 2.0);
        let (position, rotation) = score.nees();
        // What four markers cannot tell is left: a scale error of an eighth of the offset's share.
        assert!(score.position_rmse() < 3.0 * 1e3 * off.abs(), "{off} m: {score}");
        assert!(position < 30.0 && rotation < 30.0, "{off} m: {score}");
        let status = fusion.status();
        let offsets = status.constants.fixed_rows::<8>(12).into_owned();
        assert!(offsets.amax() > 0.1 * off.abs(), "{offsets}");
        // Poses of images that the layout tilts must not be aligned with the IMU.
        assert!(status.time_offset.offset.abs() < 4e-3, "{status:?}");
    }
}

#[test]
fn constant_centroid_offsets_are_in_the_covariance() {
    let bias = 0.03;
    let mut nees = [[0.0; 2]; 2];
    let runs = 8;
    for seed in 0..runs {
        let run = simulated::run(MotionConfig::nominal(seed), &SensorConfig::nominal(seed));
        let mut random = rig_simulator::random::Random::fork(seed, "offsets");
        let offsets: [[f64; 2]; 4] =
            std::array::from_fn(|_| std::array::from_fn(|_| random.normal() * bias));
        for (settings, nees) in [0.0, bias].into_iter().zip(&mut nees) {
            let mut config = simulated::config();
            config.tight.markers.pixel_floor = 0.0;
            config.tight.calibration.marker = settings * PER_PIXEL;
            let inputs = run.changed(|_, input| {
                if let Input::Markers(image) = input {
                    for (color, offset) in MarkerColor::ALL.into_iter().zip(&offsets) {
                        let marker = &mut image.markers[color];
                        marker.centroid += nalgebra::Vector2::from(*offset);
                    }
                }
            });
            let (_, outputs) = scoring::follow(config, inputs);
            let score = scoring::score(&outputs.odometry, &run.truth, 5.0);
            nees[0] += score.nees().0 / runs as f64;
            nees[1] += score.nees().1 / runs as f64;
        }
    }
    assert!(nees[0][1] > 8.0, "an offset treated as noise makes it overconfident: {nees:?}");
    assert!(nees[1].iter().all(|n| (1.2..5.0).contains(n)), "{nees:?}");
}

/// So slow that the IMU's noise hides it.
#[test]
fn a_slow_start_is_no_zero_velocity() {
    for seed in 0..4 {
        let motion = MotionConfig {
            duration: 30.0,
            still_until: 4.0,
            swing: 0.004,
            frequency: 0.12,
            wobble: 0.001,
            yaw: 0.006,
            climber_speed: 0.002,
            climber_turn_rate: 0.001,
            ..MotionConfig::nominal(seed)
        };
        let o = follow_from(motion, &SensorConfig::nominal(seed), simulated::config(), 4.0);
        assert!(consistent(&o.score, 0.0, 6.0), "seed {seed}: {}", o.score);
    }
}
