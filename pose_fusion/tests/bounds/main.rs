//! The filter against the best that any causal filter can do, and its covariance over many runs.
//!
//! The bound is a Riccati recursion of its own, linearised at the truth (`common/bound.rs`).
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::panic)]
#[path = "../common/mod.rs"]
mod common;
mod consistency;
mod rigs;

use common::{
    bound::{self, Scene},
    scoring, simulated,
};
use nalgebra::{Matrix3, Vector3};
use pose_fusion::{
    Fusion, FusionConfig, Input, Odometry,
    Warning::{EncoderStep, EncodersStuck, EncodersSuspended},
};
use rig_model::{
    CameraModel, Rig, Stamp,
    score::{Nees, PoseError},
};
use rig_simulator::{
    inertial::{SensorConfig, Sensors},
    motion::{Motion, MotionConfig},
    parallel,
    random::Random,
};

/// Squared errors of the filter and what the bound has for them, over a run.
#[derive(Clone, Copy, Debug, Default)]
struct Against {
    position: [f64; 2],
    rotation: [f64; 2],
    /// Sums of the NEES: position, rotation.
    nees: [f64; 2],
    /// Instants of the bound without an output.
    missing: usize,
    /// Warnings that the encoders are wrong.
    encoder_warnings: usize,
    /// How many squares were summed up.
    samples: f64,
    /// Largest time from an IMU sample's arrival to the newest odometry's stamp, in steps from
    /// the sample before: 1 is "as old as that sample".
    age: f64,
}

impl Against {
    fn add(&mut self, other: &Against) {
        for k in 0..2 {
            self.position[k] += other.position[k];
            self.rotation[k] += other.rotation[k];
        }
        self.samples += other.samples;
        self.age = self.age.max(other.age);
    }

    /// RMSE over the bound's: position, rotation.
    fn ratios(&self) -> (f64, f64) {
        let ratio = |x: [f64; 2]| (x[0] / x[1]).sqrt();
        (ratio(self.position), ratio(self.rotation))
    }
}

fn in_parallel<T: Send>(seeds: std::ops::Range<u64>, work: impl Fn(u64) -> T + Sync) -> Vec<T> {
    let seeds: Vec<u64> = seeds.collect();
    parallel::map(parallel::processors(), seeds.len(), || (), |(), i| work(seeds[i]))
}

/// One run against its bound, from `from` seconds on.
fn against(
    motion: MotionConfig,
    sensors: &SensorConfig,
    config: &FusionConfig,
    from: f64,
) -> Against {
    let (rig, camera) = (simulated::rig(), simulated::camera());
    let against = against_rig(&rig, &camera, motion, sensors, config, from);
    assert_eq!(against.missing, 0, "instants without an output");
    against
}

/// The same on another rig; instants without an output are counted.
fn against_rig(
    rig: &Rig,
    camera: &CameraModel,
    motion: MotionConfig,
    sensors: &SensorConfig,
    config: &FusionConfig,
    from: f64,
) -> Against {
    let motion = Motion::new(motion);
    let recording = Sensors::new(&motion, rig, camera, sensors).record();
    let mut fusion = Fusion::new(rig.clone(), config.clone());
    fusion.handle(Input::Camera(camera.clone()));
    let mut odometry: Vec<Odometry> = Vec::new();
    let mut against = Against::default();
    let mut sample_before = None;
    for (_, input) in &recording {
        let newest = odometry.last().map(|o| o.stamp);
        let outputs = scoring::run(&mut fusion, [input.clone()]);
        if let (Input::Imu(s), true) = (input, newest.is_some()) {
            let last = outputs.odometry.last().map_or(newest.unwrap(), |o| o.stamp);
            if let Some(before) = sample_before {
                against.age =
                    against.age.max(s.stamp.seconds_since(last) / s.stamp.seconds_since(before));
            }
        }
        if let Input::Imu(s) = input {
            sample_before = Some(s.stamp);
        }
        odometry.extend(outputs.odometry);
        against.encoder_warnings += outputs
            .warnings
            .iter()
            .filter(|w| {
                matches!(w, EncodersStuck { .. } | EncodersSuspended { .. } | EncoderStep { .. })
            })
            .count();
    }
    let scene = Scene { motion: &motion, rig, camera, sensors };
    for best in bound::bound(&scene, &recording, &config.tight, 10) {
        if best.time < from {
            continue;
        }
        let stamp = sensors.epoch.plus_seconds(best.time);
        let Some(o) = odometry.iter().find(|o| o.stamp.seconds_since(stamp).abs() < 1e-5) else {
            against.missing += 1;
            continue;
        };
        let truth = motion.world_from_volant(o.stamp.seconds_since(sensors.epoch));
        let error = PoseError::new(&o.world_from_volant, &truth);
        against.position[0] += error.position.norm_squared();
        against.position[1] += best.position.trace();
        against.rotation[0] += error.rotation.norm_squared();
        against.rotation[1] += best.rotation.trace();
        let nees = Nees::pair(&error, &o.pose_covariance);
        against.nees[0] += nees[0];
        against.nees[1] += nees[1];
        against.samples += 1.0;
    }
    against
}

fn row(
    name: &str,
    limit: f64,
    seeds: u64,
    motion: impl Fn(u64) -> MotionConfig + Sync,
    sensors: impl Fn(u64) -> SensorConfig + Sync,
) {
    let runs = in_parallel(0..seeds, |seed| {
        against(motion(seed), &sensors(seed), &FusionConfig::default(), 6.0)
    });
    let mut all = Against::default();
    let mut spread = (f64::INFINITY, 0.0f64);
    let mut worst = 0;
    for (seed, run) in runs.iter().enumerate() {
        all.add(run);
        let ratio = run.ratios().0;
        if ratio > spread.1 {
            worst = seed;
        }
        spread = (spread.0.min(ratio), spread.1.max(ratio));
    }
    let (position, rotation) = all.ratios();
    println!(
        "{name}: {seeds} runs, RMSE over the bound: position {position:.3} ({:.2} to {:.2} with \
         seed {worst}), rotation {rotation:.3}; position {:.2} mm, rotation {:.3} deg; output \
         older than the newest sample by {:.2} periods at most",
        spread.0,
        spread.1,
        (all.position[0] / all.samples).sqrt() * 1e3,
        (all.rotation[0] / all.samples).sqrt().to_degrees(),
        all.age
    );
    assert!(position <= limit && rotation <= limit, "{name}: {position:.3} {rotation:.3}");
    assert!(all.age <= 1.0, "{name}: {}", all.age);
}

fn runs() -> u64 {
    // More where there is time: VOLANT_RUNS=200.
    std::env::var("VOLANT_RUNS").ok().and_then(|n| n.parse().ok()).unwrap_or(24)
}

#[test]
fn a_tenth_of_a_pixel_reaches_the_bound() {
    let motion = |seed| MotionConfig { duration: 16.0, ..MotionConfig::nominal(seed) };
    row("0.1 px", 1.05, runs(), motion, SensorConfig::nominal);
}

#[test]
fn delays_jitter_and_reordering_reach_the_bound() {
    row(
        "images 0 to 300 ms late, out of order",
        1.05,
        runs(),
        |seed| MotionConfig { duration: 16.0, ..MotionConfig::nominal(seed) },
        |seed| SensorConfig {
            image_delay: [0.0, 0.3],
            climber_delay: [0.0, 0.06],
            ..SensorConfig::nominal(seed)
        },
    );
}

/// The runs of `volant hosts` over the clean link and over the late one: whatever is known, the
/// pose now is that of 60 ms ago and the IMU samples since, and the better the centroids, the
/// more that shows.
#[test]
fn a_late_link_between_two_hosts_and_its_bound() {
    let motion =
        |seed| MotionConfig { duration: 13.0, still_until: 0.0, ..MotionConfig::nominal(seed) };
    let ran = |pixel_noise: f64, link: [f64; 2]| {
        let mut all = Against::default();
        let runs = in_parallel(0..12, |seed| {
            let sensors = SensorConfig {
                pixel_noise,
                image_delay: link.map(|d| 0.006 + d),
                climber_delay: link.map(|d| 0.001 + d),
                ..SensorConfig::nominal(seed)
            };
            against(motion(seed), &sensors, &FusionConfig::default(), 1.0)
        });
        runs.iter().for_each(|run| all.add(run));
        all.position.map(|sum| (sum / all.samples).sqrt() * 1e3)
    };
    for pixel_noise in [0.05, 0.03] {
        let (clean, late) = (ran(pixel_noise, [0.0, 0.0]), ran(pixel_noise, [0.03, 0.07]));
        println!(
            "{pixel_noise} px: clean {:.3} mm (bound {:.3}), 30 to 70 ms late {:.3} mm (bound \
             {:.3}): {:.2} times, at best {:.2}",
            clean[0],
            clean[1],
            late[0],
            late[1],
            late[0] / clean[0],
            late[1] / clean[1]
        );
        for (name, [found, best]) in [("clean", clean), ("late", late)] {
            assert!(found < 1.05 * best, "{pixel_noise} px, {name}: {found} of {best} mm");
        }
        // The better the centroids, the more a late link costs, whatever the filter.
        assert!(late[1] > 1.25 * clean[1], "{pixel_noise} px: {late:?} {clean:?}");
    }
}

/// Of a climber's encoders: 2 mm, 0.2°.
const NOISY: [f64; 2] = [0.002, 0.2 * std::f64::consts::PI / 180.0];

#[test]
fn a_noisy_late_climber_reaches_the_bound() {
    row(
        "climber 0.5 m/s, 50 ms late, 2 mm and 0.2 deg noise",
        1.05,
        runs(),
        |seed| MotionConfig { climber_speed: 0.5, duration: 16.0, ..MotionConfig::nominal(seed) },
        |seed| SensorConfig {
            climber_noise: NOISY,
            climber_delay: [0.05, 0.055],
            ..SensorConfig::nominal(seed)
        },
    );
}

/// The encoders' noise is unknown at the start: readings must not be trusted too much.
#[test]
fn noisy_encoders_keep_the_first_seconds_consistent() {
    let far = in_parallel(0..runs().max(60), |seed| {
        let motion =
            MotionConfig { climber_speed: 0.5, duration: 3.0, ..MotionConfig::nominal(seed) };
        let sensors = SensorConfig { climber_noise: NOISY, ..SensorConfig::nominal(seed) };
        let run = simulated::run(motion, &sensors);
        let mut fusion = Fusion::new(simulated::rig(), FusionConfig::default());
        fusion.handle(Input::Camera(simulated::camera()));
        let outputs = scoring::run(&mut fusion, run.inputs());
        let errors: Vec<[f64; 3]> = outputs
            .odometry
            .iter()
            .map(|o| {
                let error = PoseError::new(
                    &o.world_from_volant,
                    &run.motion.world_from_volant(o.stamp.seconds_since(sensors.epoch)),
                );
                let [position, rotation] = Nees::pair(&error, &o.pose_covariance);
                [position, rotation, error.rotation.norm().to_degrees()]
            })
            .collect();
        (errors, fusion.status().counts.resets.recoveries)
    });
    let all: Vec<[f64; 3]> = far.iter().flat_map(|(errors, _)| errors).copied().collect();
    // Chi-square of 3 degrees of freedom: one of a thousand is beyond 16.3.
    let beyond = |of: usize| all.iter().filter(|e| e[of] > 16.3).count() as f64 / all.len() as f64;
    let tilt = all.iter().map(|e| e[2]).fold(0.0, f64::max);
    let recoveries: u64 = far.iter().map(|(_, recoveries)| recoveries).sum();
    println!(
        "{} runs of 3 s: beyond 16.3 {:.2} % of the positions, {:.2} % of the rotations; rotation \
         off by {tilt:.1} deg at most; {recoveries} recoveries",
        far.len(),
        beyond(0) * 1e2,
        beyond(1) * 1e2
    );
    assert!(beyond(0) < 0.02 && beyond(1) < 0.02, "{} {}", beyond(0), beyond(1));
    assert_eq!(recoveries, 0);
}

/// The same, found before the first image came: the smoother gets nothing that was never estimated.
#[test]
fn a_start_with_known_encoder_noise_smooths_correctly() {
    let sensors = SensorConfig { climber_noise: NOISY, ..SensorConfig::nominal(7) };
    let run = simulated::run(
        MotionConfig { climber_speed: 0.5, duration: 3.0, ..MotionConfig::nominal(7) },
        &sensors,
    );
    let mut fusion = Fusion::new(simulated::rig(), FusionConfig::default());
    fusion.keep_for_smoothing();
    fusion.handle(Input::Camera(simulated::camera()));
    let first_image = |stamp: Stamp| stamp.seconds_since(sensors.epoch) > 0.4;
    let inputs = run
        .inputs
        .iter()
        .filter(|(stamp, i)| !matches!(i, Input::Markers(_)) || first_image(*stamp));
    let outputs = scoring::run(&mut fusion, inputs.map(|(_, input)| input.clone()));
    let smoothed = fusion.smoothed(true);
    assert!(
        smoothed.len() + 2 > outputs.odometry.len(),
        "{} {}",
        smoothed.len(),
        outputs.odometry.len()
    );
    for o in &smoothed {
        let t = o.stamp.seconds_since(sensors.epoch);
        let p = PoseError::new(&o.world_from_volant, &run.motion.world_from_volant(t)).position;
        assert!(t > 0.35 && p.norm() < 0.02, "{t}: {p}");
    }
}
