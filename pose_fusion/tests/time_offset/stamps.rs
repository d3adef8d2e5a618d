//! Stamps that are not a constant apart: latencies that change, rolling shutters, jitter, stalls
//! and clocks that drift.

use crate::{
    common::{scoring, simulated},
    shared, shift,
};
use pose_fusion::{Fusion, FusionConfig, Input};
use rig_model::Stamp;
use rig_simulator::{inertial::SensorConfig, motion::MotionConfig, random::Random};

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
