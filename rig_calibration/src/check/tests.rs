use super::{
    groups::{Cause, GROUPS},
    *,
};
use nalgebra::{Vector2, Vector3};
use rig_model::{Distortion, ImuSample, Sample, Stamp};
use rig_simulator::{
    RIG_YAML,
    inertial::{SensorConfig, Sensors},
    motion::{Motion, MotionConfig},
    random::Random,
};

/// A run of 20 s in which all axes of the climber move.
fn recorded() -> (Samples, Rig) {
    recorded_with(SensorConfig::nominal(1))
}

fn recorded_with(sensors: SensorConfig) -> (Samples, Rig) {
    recorded_at(0.5, sensors)
}

/// The same at a speed of the climber, m/s.
fn recorded_at(climber_speed: f64, sensors: SensorConfig) -> (Samples, Rig) {
    let motion = Motion::new(MotionConfig {
        duration: 20.0,
        swing: 0.2,
        climber_speed,
        climber_turn_rate: 0.4,
        ..MotionConfig::nominal(1)
    });
    let rig = Rig::from_yaml(RIG_YAML).unwrap();
    let lens = Distortion::PlumbBob([-0.23, 0.082, 7e-4, -4e-4, -0.006]);
    let camera = CameraModel::new(640, 480, [591.3, 589.7, 319.3, 235.2], lens).unwrap();
    let recorded = Sensors::new(&motion, &rig, &camera, &sensors).record();
    let mut samples = Samples { camera, markers: vec![], imu: vec![], climber: vec![] };
    for (_, sample) in recorded {
        match sample {
            Sample::Imu(s) => samples.imu.push(s),
            Sample::Markers(s) => samples.markers.push(s),
            Sample::Climber(s) => samples.climber.push(s),
            Sample::Camera(_) => {}
        }
    }
    (samples, rig)
}

fn shift(stamp: &mut Stamp, seconds: f64) {
    *stamp = stamp.plus_seconds(seconds);
}

#[test]
fn clocks_that_are_seconds_or_an_hour_apart_accuse_nothing_else() {
    let (samples, rig) = recorded();
    for seconds in [3.0, 3600.0] {
        let mut late = samples.clone();
        late.climber.iter_mut().for_each(|s| shift(&mut s.stamp, seconds));
        let mut early = samples.clone();
        early.imu.iter_mut().for_each(|s| shift(&mut s.stamp, -seconds));
        for (samples, key) in [(late, "climber/transform"), (early, "clock.imu")] {
            let report = check(&samples, &rig, Configured::default(), None).unwrap();
            let keys: Vec<&str> = report.findings.iter().map(|f| f.key.as_str()).collect();
            assert_eq!(keys, [key], "{seconds}");
        }
    }
}

#[test]
fn an_imu_that_repeats_one_value_is_what_is_wrong() {
    let (samples, rig) = recorded();
    type Change = fn(&mut ImuSample, &ImuSample);
    let changes: [(Change, &[&str]); 4] = [
        (|s, first| *s = ImuSample { stamp: s.stamp, ..*first }, &["accelerometer", "gyroscope"]),
        (|s, _| s.angular_velocity = Vector3::zeros(), &["gyroscope"]),
        (|s, _| s.specific_force = Vector3::zeros(), &["accelerometer"]),
        (|s, first| s.angular_velocity = first.angular_velocity, &["gyroscope"]),
    ];
    for (change, sensors) in changes {
        let mut stuck = samples.clone();
        let first = stuck.imu[0];
        stuck.imu.iter_mut().for_each(|s| change(s, &first));
        let report = check(&stuck, &rig, Configured::default(), None).unwrap();
        let keys: Vec<String> = report.findings.iter().map(|f| f.key.clone()).collect();
        assert_eq!(keys, sensors.iter().map(|s| format!("imu.{s}")).collect::<Vec<_>>());
    }
}

#[test]
fn images_beyond_the_climbers_readings_are_not_used() {
    let (mut samples, _) = recorded();
    samples.climber.truncate(samples.climber.len() * 3 / 4);
    let recording = Recording::new(&samples).unwrap();
    let last = recording.shots[recording.shots.len() - 1].time;
    assert!((14.8..15.2).contains(&last), "{last}");
    let found = examine_stamps(&samples);
    assert!(found.len() == 1 && !found[0].blocks, "{found:?}");
    assert!(found[0].text.starts_with("climber/transform covers 1"), "{found:?}");
}

#[test]
fn factors_are_percentages_and_a_fisheye_lens_has_no_tangential_coefficients() {
    let (samples, rig) = recorded();
    let file = Parameters::new(&rig, &Recording::new(&samples).unwrap());
    let group = |cause: Cause| GROUPS.into_iter().find(|group| group.cause == cause).unwrap();
    let scale = group(Cause::LayoutScale);
    let row = findings::row(&scale, scale.first, &file, 2f64.ln(), 0.01, Verdict::Wrong);
    assert!((row.estimate - 200.0).abs() < 1e-9 && (row.deviation - 2.0).abs() < 1e-9, "{row:?}");
    let lens = group(Cause::Distortion);
    let third = |model: Distortion| lens.scale(lens.first + 2, &model);
    assert!(third(Distortion::PlumbBob([0.0; 5])) < 0.1);
    assert_eq!(third(Distortion::Equidistant([0.0; 4])), 1.0);
}

#[test]
fn images_decide_between_the_units_of_a_layout_with_small_markers() {
    let (samples, mut rig) = recorded();
    let right = rig.markers.centers;
    rig.markers.side = 0.025;
    rig.markers.centers.0.iter_mut().for_each(|c| c.coords *= 100.0);
    let found = check(&samples, &rig, Configured::default(), None).unwrap().findings;
    assert!(found.len() == 1 && found[0].blocks, "{found:?}");
    assert!(found[0].text.contains("in millimeters or centimeters instead"), "{found:?}");
    let is_right = |layout: &MarkerLayout| (layout.centers.0[0] - right.0[0]).norm() < 1e-6;
    let mut track = |layout: &MarkerLayout, _: &CameraModel, _: Option<usize>| {
        if is_right(layout) { samples.markers.clone() } else { vec![] }
    };
    let mut state = Corrected {
        samples: samples.clone(),
        rig,
        moved: None,
        other_mirror: None,
        imu_clock: 0.0,
        findings: vec![],
    };
    layout::examine(&mut state, Some(&mut track)).unwrap();
    let found = &state.findings;
    assert!(found.len() == 1 && !found[0].blocks && is_right(&state.rig.markers), "{found:?}");
    assert!(found[0].text.contains("in centimeters instead"), "{found:?}");
}

/// One marker is 15 to 60 px beside its place in 3 % of the images.
#[test]
fn some_wrong_images_accuse_nobody() {
    let (samples, rig) = recorded();
    for seed in 0..6 {
        let (mut samples, mut random) = (samples.clone(), Random::new(seed));
        for image in &mut samples.markers {
            if random.unit() < 0.03 {
                let marker = &mut image.markers.0[random.index(4)];
                let off = random.within(15.0, 60.0) * if random.unit() < 0.5 { -1.0 } else { 1.0 };
                marker.centroid += Vector2::new(off, 0.0);
            }
        }
        let report = check(&samples, &rig, Configured::default(), None).unwrap();
        assert!(report.findings.is_empty(), "{seed}: {:?}", report.findings);
    }
}

#[test]
fn repeated_and_invalid_messages_are_left_out() {
    let (samples, rig) = recorded();
    let right = Recording::new(&samples).unwrap();
    let mut wrong = samples.clone();
    wrong.imu.insert(500, wrong.imu[499]);
    wrong.imu.swap(600, 601);
    wrong.climber.insert(300, wrong.climber[299].clone());
    let mut imu = wrong.imu[700];
    imu.angular_velocity.x = f64::NAN;
    wrong.imu.insert(700, imu);
    wrong.imu.insert(0, ImuSample { stamp: Stamp::default(), ..imu });
    let mut climber = wrong.climber[400].clone();
    climber.world_from_climber.translation.x = f64::INFINITY;
    wrong.climber.insert(400, climber);
    let mut image = wrong.markers[200].clone();
    image.markers.0[1].centroid.x = f64::NAN;
    wrong.markers.insert(200, image);
    let repaired = Recording::new(&wrong).unwrap();
    assert_eq!((&repaired.imu, &repaired.climber), (&right.imu, &right.climber));
    assert_eq!(repaired.shots.len(), right.shots.len());
    let report = check(&wrong, &rig, Configured::default(), None).unwrap();
    // Only the unset stamp is named.
    let keys: Vec<&str> = report.findings.iter().map(|f| f.key.as_str()).collect();
    assert_eq!(keys, ["volant/imu/data"]);
}

#[test]
fn a_step_of_the_clock_accuses_nothing_else() {
    for seconds in [-3.0, -0.3, 2.0] {
        let (mut samples, rig) = recorded();
        let half = samples.imu.len() / 2;
        samples.imu[half..].iter_mut().for_each(|s| shift(&mut s.stamp, seconds));
        let report = check(&samples, &rig, Configured::default(), None).unwrap();
        let found: Vec<_> = report.findings.iter().map(|f| (f.key.as_str(), f.verdict)).collect();
        assert_eq!(found, [("volant/imu/data", Verdict::Wrong)], "{seconds}");
        assert!(examine_stamps(&samples)[0].blocks);
    }
}

#[test]
fn the_unit_of_a_mounting_is_one_that_makes_it_possible() {
    assert_eq!(layout::unit_of(5.0).0, "centimeters");
    // 1 cm or 10 cm.
    assert_eq!(layout::unit_of(10.0).0, "millimeters or centimeters");
    assert_eq!(layout::unit_of(400.0).0, "millimeters");
}

#[test]
fn a_rolling_shutter_is_named_with_its_readout_time() {
    for readout in [0.012, -0.02] {
        let (samples, rig) =
            recorded_with(SensorConfig { image_readout: readout, ..SensorConfig::nominal(1) });
        let report = |image_readout: f64| {
            let clocks = Configured { image_readout, ..Configured::default() };
            check(&samples, &rig, clocks, None).unwrap()
        };
        let found = report(0.0);
        let keys: Vec<&str> = found.findings.iter().map(|f| f.key.as_str()).collect();
        assert_eq!(keys, ["clock.image_readout"], "{:?}", found.findings);
        let row = found.rows.iter().find(|row| row.name == "clock.image_readout").unwrap();
        assert!((row.estimate - 1e3 * readout).abs() < 1.0, "{row:?}");
        let right = report(readout);
        assert!(right.findings.is_empty(), "{:?}", right.findings);
    }
    let (samples, rig) = recorded();
    let clocks = Configured { image_readout: 0.02, ..Configured::default() };
    let found = check(&samples, &rig, clocks, None).unwrap().findings;
    assert!(found.len() == 1 && found[0].text.contains("show no rolling shutter"), "{found:?}");
}

/// The samples with the camera turned by the climber's acceleration, rad/(m/s²).
fn rocking(mut samples: Samples, rig: &Rig, tilt_by_acceleration: f64) -> Samples {
    let recording = Recording::new(&samples).unwrap();
    let rocking = Parameters {
        carriage: Vector2::repeat(tilt_by_acceleration),
        ..Parameters::new(rig, &recording)
    };
    let steady = Parameters::new(rig, &recording);
    let start = samples.imu[0].stamp;
    for image in &mut samples.markers {
        let at = image.stamp.seconds_since(start);
        let camera = |p: &Parameters| {
            p.world_from_climber(&recording, at).rotation * rig.climber_from_camera.rotation
        };
        let turned = camera(&rocking).inverse() * camera(&steady);
        for marker in image.markers.0.iter_mut().filter(|m| m.centroid.x.is_finite()) {
            let ray = turned * samples.camera.ray(&marker.centroid).unwrap();
            marker.centroid = samples.camera.project(&ray.into()).unwrap();
        }
    }
    samples
}

#[test]
fn a_carriage_that_rocks_is_named_unless_its_tilt_is_declared() {
    let (samples, rig) = recorded_at(1.5, SensorConfig::nominal(1));
    let by_acceleration = 1f64.to_radians();
    let samples = rocking(samples, &rig, by_acceleration);
    let found = check(&samples, &rig, Configured::default(), None).unwrap();
    let keys: Vec<&str> = found.findings.iter().map(|f| f.key.as_str()).collect();
    assert_eq!(keys, ["carriage tilt by acceleration"], "{:?}", found.findings);
    for row in found.rows.iter().filter(|row| row.name.starts_with("carriage")) {
        let off = row.estimate - 1.0;
        assert!(off.abs() < 3.0 * row.deviation && row.deviation < 0.05, "{row:?}");
    }
    let declared = Configured { camera_tilt: 0.05, ..Configured::default() };
    let found = check(&samples, &rig, declared, None).unwrap();
    assert!(found.findings.is_empty(), "{:?}", found.findings);
}

#[test]
fn a_marker_that_is_a_millimeter_off_is_suspect_and_named() {
    let (samples, rig) = recorded();
    assert!(check(&samples, &rig, Configured::default(), None).unwrap().findings.is_empty());
    for (marker, axis, millimeters) in
        [(0, 0, -1.0), (1, 1, 1.0), (2, 0, 1.0), (3, 1, -1.0), (0, 1, 3.0), (2, 1, -4.0)]
    {
        let mut wrong = rig.clone();
        wrong.markers.centers.0[marker][axis] -= 1e-3 * millimeters;
        let found = check(&samples, &wrong, Configured::default(), None).unwrap().findings;
        let about = format!("{marker} {axis} {millimeters}: {found:?}");
        let [one] = &found[..] else { panic!("{about}") };
        assert_eq!((one.key.as_str(), one.verdict), ("markers", Verdict::Suspect), "{about}");
        let color = rig_model::MarkerColor::ALL[marker].name();
        assert!(one.text.contains(&format!("only {color} is")), "{about}");
        let size = one.text.split("by ").nth(1).unwrap().split(' ').next().unwrap();
        let size: f64 = size.parse().unwrap();
        assert!((size - millimeters).abs() < 0.4, "{about}");
    }
}
