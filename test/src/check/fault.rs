//! Faults: one thing wrong with a rig's files or its messages, by name, and how a check must name
//! it.

use crate::robustness::perturbation::{self, Perturbation as P, each_camera, each_imu};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use pose_fusion::Input;
use rig_calibration::Samples;
use rig_model::{CameraModel, ClimberSample, Distortion, Rig};
use rig_simulator::recording::Recording;

#[derive(Clone, Copy)]
pub struct Fault {
    pub name: &'static str,
    pub apply: fn(&mut Recording),
    /// Beginnings of the keys of findings that name it.
    pub keys: &'static [&'static str],
    /// Beginnings of the rows of which one may be `unobservable` instead.
    pub rows: &'static [&'static str],
    /// Row whose estimate must change by this (in its unit), within the tolerance.
    pub offset: Option<(&'static str, f64, f64)>,
    /// Whether the tracker's result depends on it.
    pub retrack: bool,
}

const fn fault(
    name: &'static str,
    apply: fn(&mut Recording),
    keys: &'static [&'static str],
) -> Fault {
    Fault { name, apply, keys, rows: &[], offset: None, retrack: false }
}

/// A fault on which the tracker's result depends.
const fn seen(
    name: &'static str,
    apply: fn(&mut Recording),
    keys: &'static [&'static str],
) -> Fault {
    Fault { retrack: true, ..fault(name, apply, keys) }
}

/// The fault, with rows of which one may be `unobservable` instead.
const fn or(fault: Fault, rows: &'static [&'static str]) -> Fault {
    Fault { rows, ..fault }
}

const fn late(name: &'static str, apply: fn(&mut Recording), row: &'static str, ms: f64) -> Fault {
    let keys: &'static [&'static str] = &["imu clock", "climber clock"];
    Fault { offset: Some((row, ms, 2.0)), ..fault(name, apply, keys) }
}

pub const FAULTS: &[Fault] = &[
    or(
        fault(
            "camera 10 cm off",
            |r| r.rig.climber_from_camera.translation.vector.x += 0.1,
            &["camera.position"],
        ),
        &["camera.position x"],
    ),
    fault("camera tilt 2°", |r| turn_camera(r, [2.0, 0.0, 0.0]), CAMERA),
    or(fault("camera yaw 90°", |r| turn_camera(r, [0.0, 0.0, 90.0]), CAMERA), CAMERA_YAW),
    or(fault("camera yaw 180°", |r| turn_camera(r, [0.0, 0.0, 180.0]), CAMERA), CAMERA_YAW),
    or(seen("focal length +1 %", |r| P::FocalLength(0.01).apply(r), FOCAL), &["camera_info: fx"]),
    seen("focal length +5 %", |r| P::FocalLength(0.05).apply(r), FOCAL),
    seen("focal length +20 %", |r| P::FocalLength(0.2).apply(r), FOCAL),
    seen("focal length halved", |r| P::FocalLength(-0.5).apply(r), FOCAL),
    seen("distortion zeroed", |r| lens(r, |_| [0.0; 5]), LENS),
    seen(
        "distortion order swapped",
        |r| lens(r, |[k1, k2, p1, p2, k3]| [k1, k2, k3, p1, p2]),
        LENS,
    ),
    or(seen("layout × 1.01", |r| P::Layout(0.01).apply(r), SCALE), SCALE),
    seen("layout × 1.1", |r| P::Layout(0.1).apply(r), SCALE),
    seen("layout in cm", |r| each_center(&mut r.rig, |c| *c *= 100.0), &["markers.red"]),
    seen("red marker 20 cm off", |r| r.rig.markers.centers.0[0].x += 0.2, &["markers.red"]),
    seen("yellow marker 1 mm off", |r| r.rig.markers.centers.0[3].x += 1e-3, &["markers"]),
    seen("red and green swapped", |r| r.rig.markers.centers.0.swap(0, 1), &["markers.red"]),
    seen(
        "layout mirrored",
        |r| each_center(&mut r.rig, |c| c.y = -c.y),
        &["markers.mirrored", "markers.exchanged"],
    ),
    seen(
        "colors rotated one place",
        |r| r.rig.markers.centers.0.rotate_left(1),
        &["markers.colors", "imu.orientation"],
    ),
    fault("IMU yaw 5°", |r| turn_imu(r, [0.0, 0.0, 5.0]), IMU),
    fault("IMU tilt 5°", |r| turn_imu(r, [5.0, 0.0, 0.0]), IMU),
    fault("IMU upside down", |r| turn_imu(r, [180.0, 0.0, 0.0]), IMU),
    fault("IMU quaternion as w, x, y, z", wxyz, IMU),
    fault(
        "IMU lever arm in mm",
        |r| r.rig.imu.volant_from_imu.translation.vector *= 1e3,
        &["imu.position"],
    ),
    fault(
        "IMU noise × 0.001",
        |r| {
            r.rig.imu.accelerometer_noise_density *= 1e-3;
            r.rig.imu.gyroscope_noise_density *= 1e-3;
        },
        &["imu.accelerometer_noise", "imu.gyroscope_noise"],
    ),
    fault(
        "accelerometer in g",
        |r| each_imu(r, |s| s.specific_force /= 9.806_65),
        &["imu.accelerometer.unit"],
    ),
    fault(
        "accelerometer negated",
        |r| each_imu(r, |s| s.specific_force = -s.specific_force),
        &["imu.accelerometer.sign"],
    ),
    fault(
        "gyroscope in deg/s",
        |r| each_imu(r, |s| s.angular_velocity *= 57.295_78),
        &["imu.gyroscope.unit"],
    ),
    fault("gyroscope scale +2 %", |r| P::GyroScale(0.02).apply(r), &["gyroscope scale"]),
    or(fault("encoder x reversed", |r| each_climber(r, |p, _| p.x = -p.x), RAIL_X), RAIL_X),
    or(
        fault(
            "encoders x and y exchanged",
            |r| each_climber(r, |p, _| *p = Vector3::new(p.y, p.x, p.z)),
            RAIL,
        ),
        RAIL_X,
    ),
    or(fault("encoder scale 1.01", |r| P::EncoderScale(0.01).apply(r), RAIL), RAIL_X),
    or(
        fault(
            "encoder x frozen",
            |r| {
                let mut first = None;
                each_climber(r, |p, _| p.x = *first.get_or_insert(p.x));
            },
            RAIL_X,
        ),
        RAIL_X,
    ),
    fault(
        "encoders frozen",
        |r| {
            let mut first = None;
            each_climber(r, |p, t| (*p, *t) = *first.get_or_insert((*p, *t)));
        },
        &["climber"],
    ),
    or(fault("height + 0.5 m", |r| each_climber(r, |p, _| p.z += 0.5), HEIGHT), HEIGHT),
    or(fault("height 0", |r| each_climber(r, |p, _| p.z = 0.0), HEIGHT), HEIGHT),
    fault(
        "rails in mm",
        |r| each_climber(r, |p, _| *p = Vector3::new(1e3 * p.x, 1e3 * p.y, p.z)),
        &["climber.rail.unit"],
    ),
    or(fault("turn in degrees", |r| each_climber(r, |_, t| *t = t.to_degrees()), TURN), TURN),
    or(fault("turn reversed", |r| each_climber(r, |_, t| *t = -*t), TURN), TURN),
    or(
        fault("turn + 10°", |r| each_climber(r, |_, t| *t += 10f64.to_radians()), CAMERA),
        CAMERA_YAW,
    ),
    or(fault("turn × 1.05", |r| each_climber(r, |_, t| *t *= 1.05), TURN), TURN),
    late("IMU stamps + 0.2 s", |r| imu_late(r, 0.2), "imu", 200.0),
    late("IMU stamps - 0.2 s", |r| imu_late(r, -0.2), "imu", -200.0),
    late("IMU stamps + 1 s", |r| imu_late(r, 1.0), "imu", 1000.0),
    late("IMU stamps - 1 s", |r| imu_late(r, -1.0), "imu", -1000.0),
    late("encoder stamps + 0.2 s", |r| P::EncoderDelay(0.2).apply(r), "climber clock", -200.0),
    late("encoder stamps - 0.2 s", |r| P::EncoderDelay(-0.2).apply(r), "climber clock", 200.0),
    Fault {
        offset: Some(("clock.image_readout", 20.0, 2.0)),
        ..fault("rolling shutter of 20 ms", rolling_shutter, &["clock.image_readout"])
    },
    fault("every IMU sample twice", |r| P::ImuTwice.apply(r), &["volant/imu"]),
    fault("two climbers on one topic", two_climbers, &["climber/transform"]),
];

const CAMERA: &[&str] = &["camera.orientation"];
const CAMERA_YAW: &[&str] = &["camera.orientation about z"];
const FOCAL: &[&str] = &["camera_info: focal"];
const LENS: &[&str] = &["camera_info"];
const SCALE: &[&str] = &["markers: scale"];
const IMU: &[&str] = &["imu.orientation"];
const RAIL: &[&str] = &["climber.rail"];
const RAIL_X: &[&str] = &["climber.rail_x"];
const TURN: &[&str] = &["climber.turn"];
const HEIGHT: &[&str] = &["climber.height"];

fn degrees(axis: [f64; 3]) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(Vector3::from(axis.map(f64::to_radians)))
}

fn turn_camera(r: &mut Recording, axis: [f64; 3]) {
    let camera = &mut r.rig.climber_from_camera;
    camera.rotation = degrees(axis) * camera.rotation;
}

fn turn_imu(r: &mut Recording, axis: [f64; 3]) {
    let imu = &mut r.rig.imu.volant_from_imu;
    imu.rotation = degrees(axis) * imu.rotation;
}

/// The quaternion as it is read where it was written with w first.
fn wxyz(r: &mut Recording) {
    let imu = &mut r.rig.imu.volant_from_imu;
    let q = imu.rotation.coords;
    imu.rotation = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q.z, q.w, q.x, q.y));
}

fn each_center(rig: &mut Rig, f: impl FnMut(&mut nalgebra::Point3<f64>)) {
    rig.markers.centers.0.iter_mut().for_each(f);
}

fn lens(r: &mut Recording, change: impl Fn([f64; 5]) -> [f64; 5]) {
    each_camera(r, |camera| {
        let (f, c, (w, h)) = (camera.focal_lengths(), camera.principal_point(), camera.size());
        let Distortion::PlumbBob(d) = camera.distortion() else { return };
        let changed = Distortion::PlumbBob(change(*d));
        if let Ok(changed) = CameraModel::new(w, h, [f.x, f.y, c.x, c.y], changed) {
            *camera = changed;
        }
    });
}

fn imu_late(r: &mut Recording, seconds: f64) {
    each_imu(r, |s| s.stamp = s.stamp.plus_seconds(seconds));
}

fn moved(sample: &mut ClimberSample, change: &mut impl FnMut(&mut Vector3<f64>, &mut f64)) {
    let pose = &sample.world_from_climber;
    let along = pose.rotation * Vector3::x();
    let (mut place, mut turn) = (pose.translation.vector, along.y.atan2(along.x));
    change(&mut place, &mut turn);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
    sample.world_from_climber = Isometry3::from_parts(Translation3::from(place), turn);
}

/// Changes position and turn of each climber pose.
fn each_climber(r: &mut Recording, mut change: impl FnMut(&mut Vector3<f64>, &mut f64)) {
    perturbation::each_climber(r, |sample| moved(sample, &mut change));
}

/// Each marker is seen 20 ms times its share of the image's height later.
fn rolling_shutter(r: &mut Recording) {
    let Some(camera) = r.camera().cloned() else { return };
    let markers = r.inputs.iter().filter_map(|(_, input)| match input {
        Input::Markers(m) => Some(m.clone()),
        _ => None,
    });
    let mut samples = Samples { camera, markers: markers.collect(), imu: vec![], climber: vec![] };
    samples.at_one_time(-0.02);
    let mut late = samples.markers.into_iter();
    for (_, input) in &mut r.inputs {
        if let Input::Markers(markers) = input {
            *markers = late.next().unwrap_or_else(|| markers.clone());
        }
    }
}

/// A second rig publishes on the same topic, elsewhere on the rails.
fn two_climbers(r: &mut Recording) {
    let doubled = r.inputs.drain(..).flat_map(|(at, input)| {
        let second = match &input {
            Input::Climber(sample) => {
                let mut other = sample.clone();
                other.stamp = other.stamp.plus_seconds(0.007);
                moved(&mut other, &mut |place, _| *place += Vector3::new(3.0, 0.5, 0.0));
                Some((at.plus_seconds(0.007), Input::Climber(other)))
            }
            _ => None,
        };
        std::iter::once((at, input)).chain(second)
    });
    r.inputs = doubled.collect();
    r.inputs.sort_by_key(|(at, _)| *at);
}
