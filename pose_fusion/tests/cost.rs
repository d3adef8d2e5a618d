//! Allocations of the filter, and its time in multiples of a dense 15×15 product in the same run.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::panic)]
#![allow(clippy::disallowed_methods, reason = "measures time")]
mod common;

use common::simulated;
use nalgebra::SMatrix;
use pose_fusion::{
    FusionConfig, Input,
    ekf::{
        propagation::{ImuReading, ProcessNoise, propagate},
        state::State,
    },
    filter::Filter,
    measurements::{
        geometry::{ClimberHeightTilt, Geometry},
        markers::{self, Image, ImageInnovation},
    },
    timeline::history::Entry,
};
use rig_simulator::{inertial::SensorConfig, motion::MotionConfig};
use std::{hint::black_box, time::Instant};

fn allocations(work: impl FnOnce()) -> u64 {
    allocation_counter::measure(work).count_total
}

fn noise() -> ProcessNoise {
    ProcessNoise {
        force: 4e-6,
        rate: 7.6e-7,
        accelerometer_bias: 9e-8,
        gyroscope_bias: 2.5e-9,
        jerk: nalgebra::Vector3::new(0.05, 0.05, 0.01),
        time_offset: 1e-10,
        ..ProcessNoise::default()
    }
}

/// A state in the middle of a run, and an image two pixels off, so that it is iterated.
fn example() -> (State, Geometry, Image) {
    let mut state = State::zero();
    state.position = nalgebra::Vector3::new(0.1, 0.05, 1.4);
    state.velocity = nalgebra::Vector3::new(0.4, -0.3, 0.1);
    state.attitude = nalgebra::UnitQuaternion::from_euler_angles(0.2, -0.1, 0.5);
    for i in 0..pose_fusion::ekf::state::N {
        state.covariance[(i, i)] = 1e-6;
    }
    for _ in 0..50 {
        propagate(&mut state, &reading(0.0), &reading(0.1), 0.01, 9.81, &noise());
    }
    let geometry = Geometry::new(&simulated::rig(), simulated::camera());
    let rest = ClimberHeightTilt { height: 2.8, tilt: nalgebra::UnitQuaternion::identity() };
    let camera = rest.join(&state.climber) * geometry.climber_from_camera;
    let volant = nalgebra::Isometry3::from_parts(state.position.into(), state.attitude)
        * geometry.imu_from_volant;
    let pixels = rig_model::MarkerColor::ALL.map(|color| {
        let seen = geometry
            .markers
            .projected_centroid(color, &geometry.camera, &(camera.inverse() * volant))
            .unwrap();
        let off = nalgebra::Vector2::new(0.3, -0.2);
        Some((seen.pixel + off, nalgebra::Matrix2::identity() * 0.0109))
    });
    let mut image = Image::new(&pixels, 0.0, rest);
    image.stamp_sigma = 1e-3;
    (state, geometry, image)
}

fn reading(change: f64) -> ImuReading {
    ImuReading {
        specific_force: nalgebra::Vector3::new(0.5 + change, -1.0, 9.6),
        angular_velocity: nalgebra::Vector3::new(1.0, -2.0 + change, 0.5),
    }
}

/// Median time of `work` on a fresh copy of `on`, s; the copy is not counted.
fn median<T: Clone>(on: &T, mut work: impl FnMut(&mut T)) -> f64 {
    let rounds = 40;
    let mut times: Vec<f64> = (0..301)
        .map(|_| {
            let mut copies = vec![on.clone(); rounds];
            let start = Instant::now();
            copies.iter_mut().for_each(&mut work);
            let spent = start.elapsed().as_secs_f64() / rounds as f64;
            black_box(&copies);
            spent
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

const GATE: f64 = 16.0;

fn update(state: &mut State, geometry: &Geometry, image: &Image) -> ImageInnovation {
    markers::update(state, geometry, image, &reading(0.0), GATE, 9.81, true)
}

#[test]
fn a_step_and_an_update_allocate_nothing() {
    let (state, geometry, image) = example();
    let noise = noise();
    let (from, to) = (reading(0.0), reading(0.1));
    let mut step_state = state.clone();
    let step_allocations =
        allocations(|| propagate(black_box(&mut step_state), &from, &to, 0.01, 9.81, &noise));
    let mut update_state = state.clone();
    let mut used = 0;
    let update_allocations = allocations(|| {
        used = update(black_box(&mut update_state), &geometry, &image).used;
    });
    assert_eq!((used, step_allocations, update_allocations), (4, 0, 0));
}

#[test]
#[ignore = "measures wall time: make bench, make long"]
fn a_step_and_an_update_cost_a_few_dense_products() {
    let (state, geometry, image) = example();
    let noise = noise();
    let (from, to) = (reading(0.0), reading(0.1));
    let dense = SMatrix::<f64, 15, 15>::from_fn(|i, j| ((i * 7 + j * 13) % 11) as f64 / 11.0);
    // The best of five tries excludes the time that other processes take.
    let mut least = [f64::INFINITY; 3];
    for _ in 0..5 {
        let unit = median(&(dense, dense), |(a, b)| *a = black_box(&*a) * black_box(&*b));
        let step = median(&state, |s| propagate(black_box(s), &from, &to, 0.01, 9.81, &noise));
        let update = median(&state, |s| {
            black_box(update(black_box(s), &geometry, &image));
        });
        for (least, now) in least.iter_mut().zip([unit, step, update]) {
            *least = least.min(now);
        }
    }
    let [unit, step, update] = least;
    println!(
        "dense 15x15 product {:.2} us; inertial step {:.2} us = {:.2} products; \
         four-marker update {:.2} us = {:.2} products",
        unit * 1e6,
        step * 1e6,
        step / unit,
        update * 1e6,
        update / unit
    );
    assert!(step / unit <= 4.0, "inertial step: {:.2} products", step / unit);
    assert!(update / unit <= 20.0, "four-marker update: {:.2} products", update / unit);
}

#[test]
fn a_run_allocates_nothing_after_initialization() {
    let sensors = SensorConfig::nominal(1);
    let run = simulated::run(MotionConfig::nominal(1), &sensors);
    let config = FusionConfig::default();
    let mut filter = Filter::new(simulated::rig(), config.tight, config.status);
    let mut worst = [0; 3];
    for (at, input) in &run.inputs {
        let settled =
            at.seconds_since(sensors.epoch) > 9.0 && !filter.status().time_offset.searching;
        let count = allocations(|| filter.handle(input));
        filter.outputs().clear();
        let kind = match input {
            Input::Imu(_) => 0,
            Input::Markers(_) => 1,
            _ => 2,
        };
        if settled {
            worst[kind] = worst[kind].max(count);
        }
    }
    assert_eq!(worst, [0; 3], "of an IMU sample, an image, a reading");
}

/// Six tenths of a second at 100 + 50 + 30 Hz are 108 entries.
#[test]
fn the_history_needs_less_than_a_megabyte() {
    let entry = size_of::<Entry>();
    assert!((9_000..9_300).contains(&entry), "{entry}");
    assert!(entry * 108 < 1_000_000, "{entry}");
}
