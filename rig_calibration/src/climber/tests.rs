use super::*;
use nalgebra::{Isometry3, Matrix2, Translation3, UnitQuaternion, Vector2};
use rig_model::{Distortion, MarkerColor, MarkerObservation};
use rig_simulator::random::Random;

/// Encoders of a simulated climber.
const NAMES: [&str; 3] = ["trolley", "bridge", "slewing"];
/// Counts of 50 µm, backwards; millimeters; degrees, backwards.
const SCALES: [f64; 3] = [-5e-5, 1e-3, -0.0174532925];
const ZEROS: [f64; 3] = [12_345.0, -250.0, 15.0];

/// World pose of the resting platform: a sloping floor.
fn platform() -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(0.2, -0.1, 0.12),
        UnitQuaternion::from_euler_angles(0.03, -0.02, 0.8),
    )
}

fn rig() -> Rig {
    Rig::from_yaml(rig_simulator::RIG_YAML).unwrap()
}

fn camera() -> CameraModel {
    let distortion = Distortion::PlumbBob([-0.2, 0.05, 0.0, 0.0, 0.0]);
    CameraModel::new(640, 480, [420.0, 421.0, 322.0, 238.0], distortion).unwrap()
}

/// x, y, turn after `t` seconds: one axis after the other.
fn axes(t: f64) -> [f64; 3] {
    let jog = |from: f64| {
        let s = ((t - from) / 8.0).clamp(0.0, 1.0);
        (std::f64::consts::TAU * s).sin()
    };
    [0.3 + 0.25 * jog(1.0), -0.2 + 0.2 * jog(10.0), 0.15 + 0.5 * jog(19.0)]
}

struct Recorded {
    markers: Vec<MarkerObservations>,
    joints: Vec<JointReading>,
}

/// Records a jog of the axes that move, with stamps of the readings that are `late` by some
/// seconds.
fn record(
    truth: &Rig,
    moving: [bool; 3],
    platform: impl Fn(f64) -> Isometry3<f64>,
    late: f64,
) -> Recorded {
    let (camera, mut random) = (camera(), Random::fork(5, "jog"));
    let at = |t: f64| {
        let (now, first) = (axes(t), axes(0.0));
        [0, 1, 2].map(|i| if moving[i] { now[i] } else { first[i] })
    };
    let mut recorded = Recorded { markers: vec![], joints: vec![] };
    for i in 0..28 * 30 {
        let t = f64::from(i) / 30.0;
        let [x, y, turn] = at(t);
        let climber = Isometry3::from_parts(
            Translation3::new(x, y, 2.4),
            UnitQuaternion::from_euler_angles(0.0, 0.0, turn),
        );
        let view = (climber * truth.climber_from_camera).inverse() * platform(t);
        let markers = PerColor::from_fn(|color: MarkerColor| {
            let centroid = truth.markers.projected_centroid(color, &camera, &view).unwrap().pixel
                + Vector2::from_fn(|_, _| 0.1 * random.normal());
            MarkerObservation::detected(centroid, Matrix2::identity() * 0.01, 500.0)
        });
        let stamp = Stamp::from_nanos(1_000_000_000_000).plus_seconds(t);
        recorded.markers.push(MarkerObservations { stamp, markers });
    }
    for i in 0..29 * 50 {
        let t = f64::from(i) / 50.0 - 0.5;
        let value = |i: usize| ZEROS[i] + at(t)[i] / SCALES[i] + 0.3 * random_step(i, t);
        recorded.joints.push(JointReading {
            stamp: Stamp::from_nanos(1_000_000_000_000).plus_seconds(t + late),
            names: ["gripper", NAMES[2], NAMES[0], "spare", NAMES[1]].map(Into::into).to_vec(),
            positions: vec![(7.0 * t).sin(), value(2), value(0).round(), 3.0, value(1)],
        });
    }
    recorded
}

/// A little noise of the encoders in mm and degrees.
fn random_step(axis: usize, t: f64) -> f64 {
    if axis == 0 { 0.0 } else { 0.1 * (1e4 * t).sin() }
}

fn calibrate(
    recorded: &Recorded,
    rig: &Rig,
    at: Option<Vector3<f64>>,
) -> Result<ClimberCalibration, ClimberError> {
    calibrate_in(recorded, rig, at, ROUNDS)
}

fn calibrate_in(
    recorded: &Recorded,
    rig: &Rig,
    at: Option<Vector3<f64>>,
    rounds: usize,
) -> Result<ClimberCalibration, ClimberError> {
    let (markers, joints) = (&recorded.markers, &recorded.joints);
    let camera = &camera();
    let jog = Jog { camera, rig, markers, joints, preferred: AXES, platform: at };
    calibrate_within(&jog, rounds)
}

fn assert_near(what: &str, (value, sigma): Value, truth: f64, largest: f64) {
    let off = value - truth;
    assert!(off.abs() < 5.0 * sigma && off.abs() < largest, "{what}: {value} ± {sigma}, {truth}");
}

#[test]
fn names_signs_scales_zeros_and_height_are_found() {
    let recorded = record(&rig(), [true; 3], |_| platform(), 0.02);
    let at = platform().translation.vector;
    let found = calibrate(&recorded, &rig(), Some(at)).unwrap();
    for (i, name) in AXES.into_iter().enumerate() {
        let axis = found.axes[i].as_ref().unwrap();
        assert_eq!(axis.joint, NAMES[i]);
        let scale = SCALES[i];
        assert_near(name, axis.scale, scale, 2e-3 * scale.abs());
        // 3 mm, 0.2 deg.
        assert_near(name, axis.zero.unwrap(), ZEROS[i], 3e-3 / scale.abs());
    }
    assert_near("height", found.height.unwrap(), 2.4, 5e-3);
    assert_near("time", found.time_offset, 0.02, 2e-3);
    assert!(found.pixel_rms < 0.12, "{}", found.pixel_rms);
    // Where the platform rests is a matter of a survey.
    let found = calibrate(&recorded, &rig(), None).unwrap();
    assert_eq!(found.height, None);
    let zeros = found.axes.map(|a| a.unwrap().zero.is_some());
    assert_eq!(zeros, [false, false, true]);
}

#[test]
fn a_wrong_camera_mounting_is_found_where_the_turn_shows_it() {
    let mut truth = rig();
    truth.climber_from_camera.translation.vector += Vector3::new(0.1, -0.04, 0.0);
    truth.climber_from_camera.rotation =
        UnitQuaternion::from_euler_angles(0.03, -0.02, 0.0) * truth.climber_from_camera.rotation;
    let recorded = record(&truth, [true; 3], |_| platform(), 0.0);
    let at = platform().translation.vector;
    let found = calibrate(&recorded, &rig(), Some(at)).unwrap();
    let [x, y] = found.camera_offset.unwrap();
    assert_near("x", x, 0.1, 5e-3);
    assert_near("y", y, -0.04, 5e-3);
    let [x, y] = found.camera_tilt.unwrap();
    assert_near("tilt x", x, 0.03, 2e-3);
    assert_near("tilt y", y, -0.02, 2e-3);
    assert_near("scale", found.axes[0].as_ref().unwrap().scale, SCALES[0], 2e-7);
    assert_near("height", found.height.unwrap(), 2.4, 5e-3);
    // A fit that has not converged is none.
    assert!(calibrate_in(&recorded, &rig(), Some(at), 1).is_err());
}

#[test]
fn an_axis_that_does_not_move_is_unobservable() {
    for still in 0..3 {
        let mut moving = [true; 3];
        moving[still] = false;
        let found = calibrate(&record(&rig(), moving, |_| platform(), 0.0), &rig(), None).unwrap();
        for (i, name) in AXES.into_iter().enumerate() {
            let axis = found.axes[i].as_ref();
            assert_eq!(axis.map(|a| a.joint.as_str()), moving[i].then_some(NAMES[i]));
            if let Some(axis) = axis {
                assert_near(name, axis.scale, SCALES[i], 4e-3 * SCALES[i].abs());
            }
        }
    }
    let found = calibrate(&record(&rig(), [false, false, true], |_| platform(), 0.0), &rig(), None);
    assert_eq!(found.unwrap().axes.map(|a| a.map(|a| a.zero)), [None, None, Some(None)]);
    let still = calibrate(&record(&rig(), [false; 3], |_| platform(), 0.0), &rig(), None);
    assert!(still.unwrap_err().to_string().starts_with("no axis moved"));
}

#[test]
fn a_joint_that_is_published_once_a_second_does_not_matter() {
    let mut recorded = record(&rig(), [true; 3], |_| platform(), 0.0);
    let slow: Vec<_> = (recorded.joints.iter().step_by(50))
        .map(|readings| JointReading {
            stamp: readings.stamp.plus_seconds(1e-3),
            names: vec!["wrist".into()],
            positions: vec![readings.positions[0]],
        })
        .collect();
    recorded.joints.extend(slow);
    let found = calibrate(&recorded, &rig(), None).unwrap();
    assert_eq!(found.axes.map(|a| a.unwrap().joint), NAMES.map(str::to_owned));
}

#[test]
fn a_moved_platform_and_a_missing_encoder_are_refused() {
    let pushed = |t: f64| Translation3::new(0.05 * (t / 3.0).sin(), 0.0, 0.0) * platform();
    let error = calibrate(&record(&rig(), [true; 3], pushed, 0.0), &rig(), None).unwrap_err();
    assert!(error.to_string().contains("platform"), "{error}");
    let mut recorded = record(&rig(), [true; 3], |_| platform(), 0.0);
    for readings in &mut recorded.joints {
        readings.names[1] = "gripper".into();
    }
    let error = calibrate(&recorded, &rig(), None).unwrap_err();
    assert!(error.to_string().contains("turns, but no joint"), "{error}");
    recorded.joints.truncate(60);
    let error = calibrate(&recorded, &rig(), None).unwrap_err();
    assert!(error.to_string().contains("images show all four markers"), "{error}");
}
