use super::*;
use nalgebra::Vector2;
use rig_model::{Distortion, ImuSample, Stamp};
use rig_simulator::{
    RIG_YAML,
    inertial::{Message, SensorConfig, Sensors},
    motion::{Motion, MotionConfig},
    random::Random,
};

/// A run of 20 s in which all axes of the climber move.
fn recorded() -> (Samples, Rig) {
    let motion = Motion::new(MotionConfig {
        duration: 20.0,
        swing: 0.2,
        climber_speed: 0.5,
        climber_turn_rate: 0.4,
        ..MotionConfig::nominal(1)
    });
    let rig = Rig::from_yaml(RIG_YAML).unwrap();
    let lens = Distortion::PlumbBob([-0.23, 0.082, 7e-4, -4e-4, -0.006]);
    let camera = CameraModel::new(640, 480, [591.3, 589.7, 319.3, 235.2], lens).unwrap();
    let messages = Sensors::new(&motion, &rig, &camera, &SensorConfig::nominal(1)).record();
    let mut samples = Samples { camera, markers: vec![], imu: vec![], climber: vec![] };
    for (_, message) in messages {
        match message {
            Message::Imu(s) => samples.imu.push(s),
            Message::Markers(s) => samples.markers.push(s),
            Message::Climber(s) => samples.climber.push(s),
        }
    }
    (samples, rig)
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
        let report = check(&samples, &rig, 0.0, None).unwrap();
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
    let report = check(&wrong, &rig, 0.0, None).unwrap();
    // Only the unset stamp is named.
    let keys: Vec<&str> = report.findings.iter().map(|f| f.key.as_str()).collect();
    assert_eq!(keys, ["volant/imu/data"]);
}

#[test]
fn a_step_of_the_clock_accuses_nothing_else() {
    for seconds in [-3.0, -0.3, 2.0] {
        let (mut samples, rig) = recorded();
        let half = samples.imu.len() / 2;
        for sample in &mut samples.imu[half..] {
            sample.stamp = sample.stamp.plus_seconds(seconds);
        }
        let report = check(&samples, &rig, 0.0, None).unwrap();
        let found: Vec<_> = report.findings.iter().map(|f| (f.key.as_str(), f.verdict)).collect();
        assert_eq!(found, [("volant/imu/data", Verdict::Wrong)], "{seconds}");
        assert!(examine_stamps(&samples)[0].blocks);
    }
}
