//! The best that any causal filter can do on a simulated run: the Riccati recursion of the error's
//! covariance, linearised at the truth, that uses at each instant what had arrived by then, each
//! datum at its own time.
//!
//! Independent of the filter's code, with dense matrices and numerical derivatives. The error
//! state: position, velocity, attitude (about world axes), biases of accelerometer and gyroscope
//! (constant), the climber's x, y, yaw with rates and accelerations (white jerk, with the filter's
//! settings), and the offset of the clock that camera and climber share.

use nalgebra::{
    Isometry3, Matrix3, SMatrix, SVector, Translation3, UnitQuaternion, Vector2, Vector3,
};
use pose_fusion::TightConfig;
use rig_model::{CameraModel, MarkerColor, MarkerState, Rig, Sample};
use rig_simulator::{
    inertial::{Samples, SensorConfig, Sensors},
    motion::Motion,
};

const N: usize = 25;
type Square = SMatrix<f64, N, N>;
const CLIMBER: usize = 15;
const CLOCK: usize = 24;

/// The bound at an IMU sample.
#[derive(Clone, Debug)]
pub struct Best {
    /// Since the epoch, s.
    pub time: f64,
    /// Covariance of the platform's position, m².
    pub position: Matrix3<f64>,
    /// Of its rotation, rad².
    pub rotation: Matrix3<f64>,
}

enum Datum {
    Nothing,
    Output,
    Rows(Vec<(SVector<f64, N>, f64)>),
}

struct Node {
    time: f64,
    arrival: f64,
    transition: Square,
    noise: Square,
    datum: Datum,
}

/// Pixel of a marker with the platform moved by `turn` and `shift`, the climber by `drive`.
fn pixel(
    scene: &Scene<'_>,
    t: f64,
    color: MarkerColor,
    shift: &Vector3<f64>,
    turn: &Vector3<f64>,
    drive: &Vector3<f64>,
) -> Vector2<f64> {
    let world_from_imu = scene.motion.world_from_volant(t) * scene.rig.imu.volant_from_imu;
    let moved = Isometry3::from_parts(
        Translation3::from(world_from_imu.translation.vector + shift),
        UnitQuaternion::from_scaled_axis(*turn) * world_from_imu.rotation,
    );
    let [x, y, angle] = scene.motion.climber(t);
    let climber = Isometry3::from_parts(
        Translation3::new(x + drive.x, y + drive.y, scene.motion.config().climber_height),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle + drive.z),
    );
    let camera = climber * scene.rig.climber_from_camera;
    let camera_from_volant = camera.inverse() * moved * scene.rig.imu.volant_from_imu.inverse();
    scene
        .rig
        .markers
        .projected_centroid(color, scene.camera, &camera_from_volant)
        .expect("in view")
        .pixel
}

/// What the run was made from.
pub struct Scene<'a> {
    pub motion: &'a Motion,
    pub rig: &'a Rig,
    pub camera: &'a CameraModel,
    pub sensors: &'a SensorConfig,
}

fn image_rows(scene: &Scene<'_>, t: f64, color: MarkerColor) -> Vec<(SVector<f64, N>, f64)> {
    let zero = Vector3::<f64>::zeros();
    let mut rows = [SVector::<f64, N>::zeros(); 2];
    let mut put = |index: usize, derivative: Vector2<f64>| {
        rows[0][index] = derivative.x;
        rows[1][index] = derivative.y;
    };
    let h = 1e-5;
    for (k, first) in [0, 6, CLIMBER].into_iter().enumerate() {
        for axis in 0..3 {
            let moved = |by: f64| {
                let mut moved = [zero; 3];
                moved[k][axis] = by;
                let [shift, turn, drive] = &moved;
                pixel(scene, t, color, shift, turn, drive)
            };
            put(first + axis, (moved(h) - moved(-h)) / (2.0 * h));
        }
    }
    let at = |t: f64| pixel(scene, t, color, &zero, &zero, &zero);
    put(CLOCK, (at(t + h) - at(t - h)) / (2.0 * h));
    let variance = scene.sensors.pixel_noise.powi(2);
    rows.into_iter().map(|row| (row, variance)).collect()
}

fn transition(
    scene: &Scene<'_>,
    sensors: &Sensors<'_>,
    settings: &TightConfig,
    from: f64,
    to: f64,
) -> (Square, Square) {
    let dt = to - from;
    let middle = (from + to) / 2.0;
    let (force, _) = sensors.ideal_imu(middle);
    let turn =
        scene.motion.world_from_volant(middle).rotation * scene.rig.imu.volant_from_imu.rotation;
    let r = turn.to_rotation_matrix();
    let mut a = Square::zeros();
    a.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
    a.fixed_view_mut::<3, 3>(3, 6).copy_from(&-(r * force).cross_matrix());
    a.fixed_view_mut::<3, 3>(3, 9).copy_from(&-r.matrix());
    a.fixed_view_mut::<3, 3>(6, 12).copy_from(&-r.matrix());
    a.fixed_view_mut::<3, 3>(CLIMBER, CLIMBER + 3).copy_from(&Matrix3::identity());
    a.fixed_view_mut::<3, 3>(CLIMBER + 3, CLIMBER + 6).copy_from(&Matrix3::identity());
    let f =
        Square::identity() + a * dt + a * a * (dt * dt / 2.0) + a * a * a * (dt * dt * dt / 6.0);
    let imu = &scene.rig.imu;
    let factor = scene.sensors.imu_noise_factor;
    let mut density = Square::zeros();
    for i in 0..3 {
        density[(3 + i, 3 + i)] = (imu.accelerometer_noise_density * factor).powi(2);
        density[(6 + i, 6 + i)] = (imu.gyroscope_noise_density * factor).powi(2);
        density[(CLIMBER + 6 + i, CLIMBER + 6 + i)] =
            if i == 2 { settings.climber.turn_jerk } else { settings.climber.jerk };
    }
    // ∫ Φ D Φᵀ by Simpson's rule.
    let half = Square::identity() + a * (dt / 2.0) + a * a * (dt * dt / 8.0);
    let q = (density + half * density * half.transpose() * 4.0 + f * density * f.transpose())
        * (dt / 6.0);
    (f, q)
}

/// The bound at every `every`-th IMU sample of a recording.
pub fn bound(
    scene: &Scene<'_>,
    recording: &Samples,
    settings: &TightConfig,
    every: usize,
) -> Vec<Best> {
    let sensors = Sensors::new(scene.motion, scene.rig, scene.camera, scene.sensors);
    let config = scene.sensors;
    let seconds = |stamp: rig_model::Stamp| stamp.seconds_since(config.epoch);
    let mut data: Vec<(f64, f64, Datum)> = Vec::new();
    let mut samples = 0;
    for (arrival, sample) in recording {
        let arrival = seconds(*arrival);
        match sample {
            Sample::Imu(s) => {
                samples += 1;
                let datum = if samples % every == 0 { Datum::Output } else { Datum::Nothing };
                data.push((seconds(s.stamp), arrival, datum));
            }
            Sample::Climber(s) => {
                let t = seconds(s.stamp) - config.climber_clock_ahead;
                let h = 1e-4;
                let (before, after) = (scene.motion.climber(t - h), scene.motion.climber(t + h));
                let rows = (0..3)
                    .map(|axis| {
                        let kind = usize::from(axis == 2);
                        let mut row = SVector::<f64, N>::zeros();
                        row[CLIMBER + axis] = 1.0;
                        row[CLOCK] = (after[axis] - before[axis]) / (2.0 * h);
                        let step = config.climber_quantum[kind];
                        (row, config.climber_noise[kind].powi(2) + step * step / 12.0)
                    })
                    .collect();
                data.push((t, arrival, Datum::Rows(rows)));
            }
            Sample::Markers(m) => {
                let t = seconds(m.stamp) - config.camera_clock_ahead;
                let seen = m.markers.iter().filter(|(_, o)| o.state == MarkerState::Detected);
                let rows = seen.flat_map(|(color, _)| image_rows(scene, t, color)).collect();
                data.push((t, arrival, Datum::Rows(rows)));
            }
            Sample::Camera(_) => {}
        }
    }
    data.sort_by(|a, b| a.0.total_cmp(&b.0));
    let start =
        data.iter().position(|d| matches!(&d.2, Datum::Rows(r) if r.len() == 8)).expect("an image");
    let mut last = data[start].0;
    let nodes: Vec<Node> = data
        .into_iter()
        .skip(start)
        .map(|(time, arrival, datum)| {
            let (transition, noise) = transition(scene, &sensors, settings, last, time);
            last = time;
            Node { time, arrival, transition, noise, datum }
        })
        .collect();
    let mut first = Square::zeros();
    let mut set = |index: usize, sigma: f64| {
        for i in 0..3 {
            first[(index + i, index + i)] = sigma * sigma;
        }
    };
    set(0, 2.0);
    set(3, 1.5);
    set(6, 1.0);
    set(9, settings.imu.accelerometer_bias);
    set(12, settings.imu.gyroscope_bias);
    set(CLIMBER, 1.0);
    set(CLIMBER + 3, 0.5);
    set(CLIMBER + 6, 0.5);
    first[(CLOCK, CLOCK)] = settings.clock.camera_sigma.powi(2);

    let step = |p: &mut Square, node: &Node, now: f64| {
        *p = node.transition * *p * node.transition.transpose() + node.noise;
        if let (Datum::Rows(rows), true) = (&node.datum, node.arrival <= now) {
            for (h, variance) in rows {
                let gain = *p * h;
                let innovation = h.dot(&gain) + variance;
                *p -= gain * gain.transpose() / innovation;
            }
        }
        *p = (*p + p.transpose()) * 0.5;
    };
    // Up to `base` everything has arrived: that part never changes any more.
    let (mut base, mut at_base) = (0, first);
    let mut best = Vec::new();
    for (i, node) in nodes.iter().enumerate() {
        if !matches!(node.datum, Datum::Output) {
            continue;
        }
        let now = node.arrival;
        while base < i && nodes[base].arrival <= now {
            step(&mut at_base, &nodes[base], f64::INFINITY);
            base += 1;
        }
        let mut p = at_base;
        for node in &nodes[base..=i] {
            step(&mut p, node, now);
        }
        let turn = scene.motion.world_from_volant(node.time).rotation;
        let lever = turn * scene.rig.imu.volant_from_imu.translation.vector;
        // The platform's origin: δp_v = δp + [R t]× δθ.
        let mut to_volant = SMatrix::<f64, 3, N>::zeros();
        to_volant.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
        to_volant.fixed_view_mut::<3, 3>(0, 6).copy_from(&lever.cross_matrix());
        best.push(Best {
            time: node.time,
            position: to_volant * p * to_volant.transpose(),
            rotation: p.fixed_view::<3, 3>(6, 6).into_owned(),
        });
    }
    best
}
