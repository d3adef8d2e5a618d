//! `volant bringup` on a simulated rig with a scripted terminal: from an empty rig file and lengths
//! measured with a tape to a rig file that is as good as the true one.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, clippy::disallowed_methods)]

mod files;
#[path = "../place/mod.rs"]
mod place;
#[path = "../simulated/mod.rs"]
mod simulated;

use bag::{BagWriter, Qos, WriteOptions};
use nalgebra::Vector3;
use node_kit::convert;
use place::{Place, Ran, put};
use rig_model::{MarkerColor, Rig, Stamp};
use rig_simulator::RIG_YAML;
use ros_parameters::{ParameterFile, ParameterValue};
use simulated::{Simulated, resting};
use std::{fmt::Write as _, fs, io::Write as _, process::Stdio};
use test_support::process::in_domain;
use volant::{
    evaluate::{EvaluateOptions, evaluate},
    replay::TopicNames,
};
use volant_msgs::sensor_msgs::msg::CompressedImage;

/// Runs `volant bringup` with the answers of an operator; returns its status and what it prints.
fn bringup(place: &Place, arguments: &str, answers: &str) -> (Option<i32>, String) {
    let mut child = in_domain(92, env!("CARGO_BIN_EXE_volant"))
        .arg("bringup")
        .args(arguments.split_whitespace())
        .current_dir(place.folder())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(answers.as_bytes()).unwrap();
    let Ran { status, out, err } = child.wait_with_output().unwrap().into();
    (status, out + &err)
}

/// Position (mm) and rotation (deg) RMSE of a replay with a rig file.
fn rmse(place: &Place, rig: &str) -> [f64; 2] {
    place.done(&format!("replay work.mcap --rig {rig} --out {rig}.mcap"));
    let options = EvaluateOptions {
        estimates: place.path(&format!("{rig}.mcap")),
        truth: place.path("truth.mcap"),
        skip: 3.0,
        names: TopicNames::default(),
    };
    let evaluation = evaluate(&options).unwrap();
    let fused = evaluation.estimates.iter().find(|q| q.estimate.ends_with("odometry")).unwrap();
    [fused.position_mm.rmse, fused.rotation_deg.rmse]
}

/// A tape's reading: millimeters to a tenth.
fn tape(v: Vector3<f64>) -> String {
    format!("{:.1} {:.1} {:.1}", 1e3 * v.x, 1e3 * v.y, 1e3 * v.z)
}

#[test]
fn an_empty_rig_file_becomes_as_good_as_the_true_one() {
    let place = Place::new();
    let simulated = Simulated::new(1);
    simulated.write_rest(&place.path("rest.mcap"));
    simulated.write_jog(&place.path("jog.mcap"), true);
    simulated.write(&place.path("swing.mcap"), &simulated.motion(60.0, true), false);
    let other = Simulated::new(101);
    let motion = other.motion(20.0, false);
    other.write(&place.path("work.mcap"), &motion, false);
    other.write_truth(&place.path("truth.mcap"), &motion);

    // The operator: markers to 0.1 mm, camera and IMU to some millimeters and degrees.
    let rig = &simulated.rig;
    let mut answers = String::from("\n76\n");
    for color in MarkerColor::ALL {
        writeln!(answers, "{}", tape(rig.markers.centers[color].coords)).unwrap();
    }
    answers += "0.1\n";
    let camera = rig.climber_from_camera.translation.vector + Vector3::new(0.004, -0.003, 0.002);
    let imu = rig.imu.volant_from_imu.translation.vector + Vector3::new(0.003, -0.002, 0.003);
    writeln!(answers, "{}\n0.7071 0.7071 0 0\n{}\n0 0 0 1", tape(camera), tape(imu)).unwrap();
    // IMU; then a pause.
    answers += "\n\nrest.mcap\n";
    let (status, printed) = bringup(&place, "--rig rig.yaml", &answers);
    assert_eq!(status, Some(0), "a pause without a failed step: {printed}");
    assert!(printed.contains("3/8 camera") && printed.contains("paused"), "{printed}");
    assert!(!printed.contains("FAIL"), "{printed}");
    let sigma = |name: &str| {
        let parameters = ParameterFile::parse(&place.text("rig.yaml")).unwrap();
        parameters.for_node("/pose_fusion").get(name).and_then(ParameterValue::as_f64)
    };
    assert_eq!(sigma("calibration.marker_sigma"), Some(1e-4));
    let radii = rig.markers.centers.0.iter().map(|c| c.coords.xy().norm_squared());
    let expected = 1e-4 / radii.sum::<f64>().sqrt();
    let layout = sigma("calibration.layout_sigma").unwrap();
    assert!((layout / expected - 1.0).abs() < 0.1, "{layout} {expected}");

    assert_eq!(sigma("calibration.encoder_scale_sigma"), Some(layout));

    // It goes on with the camera. The lens is calibrated, to 2 px.
    let mut answers = String::from("\nswing.mcap\n\n\nswing.mcap\n100\n2\n");
    let t = resting().translation;
    writeln!(answers, "\n{} {} {}\njog.mcap", t.x, t.y, t.z).unwrap();
    // Mounting, offsets, acceptance.
    answers += "\nswing.mcap\n\n\nwork.mcap\n";
    let (status, printed) = bringup(&place, "--rig rig.yaml --report page.html", &answers);
    eprintln!("{printed}");
    assert_eq!(status, Some(0), "{printed}");
    assert!(!printed.contains("1/8 markers"), "resumed: {printed}");
    assert!(!printed.contains("TimeOffset") && !printed.contains("(1 times)"), "{printed}");
    for step in ["camera", "intrinsics", "encoders", "mounting", "offsets", "acceptance"] {
        assert!(printed.contains(&format!("{step:<12}PASS")), "{step}: {printed}");
    }
    // The recording knows the places better than the operator, and not the layout's size.
    let places = sigma("calibration.marker_sigma").unwrap();
    assert!((3e-5..8e-5).contains(&places), "{places}");
    assert_eq!(sigma("calibration.layout_sigma"), Some(layout));
    // The jog knows the scales against the layout's size.
    let scale = sigma("calibration.encoder_scale_sigma").unwrap();
    assert!((1.0..2.0).contains(&(scale / layout)), "{scale} {layout}");
    let lens = sigma("calibration.focal_length_sigma").unwrap();
    assert!((lens * simulated.camera.focal_lengths().x / 2.0 - 1.0).abs() < 1e-2, "{lens}");
    assert!(printed.contains("100 px is not possible"), "{printed}");
    let tilt = sigma("calibration.mounting_sigma").unwrap();
    assert!((1e-5..3e-3).contains(&tilt), "{tilt}");
    let found = Rig::from_yaml(&place.text("rig.yaml")).unwrap();
    let camera = found.climber_from_camera.rotation * rig.climber_from_camera.rotation.inverse();
    let off = camera.scaled_axis();
    assert!(off.xy().amax() < 3.5 * tilt, "{off:?} {tilt}");
    eprintln!("markers {places}, camera {tilt}, off by {off:?}");
    let html = place.text("page.html");
    assert!(html.contains("Bring-up: accepted") && html.contains("joint bridge"));
    assert!(place.read("rig.yaml.bringup/markers.pdf").starts_with(b"%PDF"));
    assert!(place.path("rig.yaml.bringup/allan.svg").is_file());

    // The true rig file, with the true encoders.
    let e = &simulated.encoders;
    let axes = ["rail_x", "rail_y", "turn"];
    let map = |values: [String; 3]| {
        let pairs: Vec<_> = axes.iter().zip(values).map(|(a, v)| format!("{a}: {v}")).collect();
        format!("{{{}}}", pairs.join(", "))
    };
    let truth = format!(
        "{RIG_YAML}/climber_driver:\n  ros__parameters:\n    joints: {}\n    scale: {}\n    \
         zero: {}\n    height: {}\n",
        map(e.names.map(str::to_owned)),
        map(e.scale.map(|s| s.to_string())),
        map(e.zero.map(|z| format!("{z:?}"))),
        simulated.height
    );
    place.write("true.yaml", truth);
    let [ours, best] = ["rig.yaml", "true.yaml"].map(|rig| rmse(&place, rig));
    eprintln!("position mm, rotation deg: {ours:?}; with the true rig file {best:?}");
    for (ours, best) in ours.into_iter().zip(best) {
        assert!(ours <= 1.3 * best, "{ours} {best}");
    }
    assert!((found.imu.gyroscope_noise_density / 0.000_872_66 - 1.0).abs() < 0.05);

    // A single step, which fails: the platform was not on the floor.
    let before = place.read("rig.yaml");
    let answers = "\n0 0 0.1\nswing.mcap\n\n";
    let (status, printed) = bringup(&place, "encoders --rig rig.yaml", answers);
    assert_eq!(status, Some(1), "{printed}");
    assert!(printed.contains("FAIL encoders") && printed.contains("onto the floor"), "{printed}");
    assert!(printed.contains("not accepted: encoders failed"), "{printed}");
    assert_eq!(place.read("rig.yaml"), before);
}

#[test]
fn only_offered_answers_count_and_a_pause_writes_the_report() {
    let place = Place::new();
    let arguments = "--rig rig.yaml --report page.html";
    // `abc` begins no step; `s` skips the markers, and the IMU has no recording.
    let (status, printed) = bringup(&place, arguments, "abc\ns\nx\nq\n");
    assert_eq!(status, Some(0), "nothing has failed: {printed}");
    assert!(printed.contains("`abc` is not one of the answers") && !printed.contains("side"));
    assert!(printed.contains("2/8 imu") && !printed.contains("Connect the IMU"), "{printed}");
    assert!(place.text("page.html").contains("1. markers: skipped"));

    // The skipped step is offered again, and the report of the pause is replaced.
    place.write("not_a_bag.mcap", "text");
    let answers = "s\n\nno\n\n60\nlive 2m\nnot_a_bag.mcap\nabc\nq\n";
    let (status, printed) = bringup(&place, arguments, answers);
    assert_eq!(status, Some(1), "a step has failed: {printed}");
    for needle in [
        "1/8 markers",
        "`no` is not one of the answers",
        "60: no such file; `live 60` records 60 s",
        "`2m` is no duration",
        "FAIL imu",
        "`abc` is not one of the answers",
        "paused",
        "not accepted: imu failed",
    ] {
        assert!(printed.contains(needle), "{needle} in\n{printed}");
    }
    for absent in ["allan.svg", "3/8 camera", "rest.mcap"] {
        assert!(!printed.contains(absent), "{absent} in\n{printed}");
    }
    assert!(place.text("page.html").contains("2. imu: FAIL"));

    // The page is no other file of the bring-up, not even one that does not exist yet.
    for page in ["new.yaml", "new.yaml.bringup.json"] {
        let arguments = format!("--rig new.yaml --report {page}");
        let (status, printed) = bringup(&place, &arguments, "q\n");
        assert_eq!(status, Some(1), "{printed}");
        assert!(printed.contains("two outputs have this name"), "{printed}");
        assert!(!place.path(page).exists());
    }
}

#[test]
fn a_topic_that_nobody_publishes_is_named_within_seconds_and_a_former_recording_stays() {
    let place = Place::new();
    let recording = place.path("rig.yaml.bringup/rest.mcap");
    let record = || {
        let begun = std::time::Instant::now();
        let (_, printed) = bringup(&place, "imu --rig rig.yaml", "\n\nlive 100s\n\n");
        assert!(begun.elapsed().as_secs() < 30, "{printed}");
        assert!(printed.contains("recording 100 s"), "{printed}");
        assert!(printed.contains("nobody publishes /volant/imu/data"), "{printed}");
        assert!(!printed.contains("wrote ") || !printed.contains("rest.mcap"), "{printed}");
    };
    record();
    assert!(!recording.exists());
    fs::write(&recording, "an hour at rest").unwrap();
    record();
    assert_eq!(fs::read_to_string(&recording).unwrap(), "an hour at rest");
    let files: Vec<_> = fs::read_dir(recording.parent().unwrap()).unwrap().collect();
    assert_eq!(files.len(), 1, "{files:?}");
}

/// A folder with a rig file and the state of a bring-up.
fn bring_up_of(rig: &str, state: &str) -> Place {
    let place = Place::with_rig(rig);
    place.write("rig.yaml.bringup.json", state);
    place
}

#[test]
fn a_changed_rig_file_puts_the_later_steps_out_of_date() {
    let done = r#"{"outcome": "done", "items": [], "wrote": []}"#;
    let steps = ["markers", "imu", "acceptance"].map(|step| format!("\"{step}\": {done}"));
    let state = format!(r#"{{"steps": {{{}}}, "recordings": {{}}}}"#, steps.join(", "));
    let place = bring_up_of(RIG_YAML, &state);
    let arguments = "markers --rig rig.yaml --report page.html";
    let accepted = || place.text("page.html").contains("Bring-up: accepted");
    // Nothing changes.
    let (status, printed) = bringup(&place, arguments, "s\n");
    assert!(status == Some(0) && printed.contains("acceptance  PASS"), "{printed}");
    assert!(accepted());
    // The side of the squares changes, and the step is paused after it.
    let (_, printed) = bringup(&place, arguments, "\n81\nq\n");
    assert!(printed.contains("paused") && !accepted(), "{printed}");
    // The skipped steps are offered again.
    let (_, printed) = bringup(&place, "--rig rig.yaml", "s\nq\n");
    assert!(printed.contains("1/8 markers") && printed.contains("2/8 imu"), "{printed}");
    let (_, printed) = bringup(&place, "offsets --rig rig.yaml", "s\n");
    assert!(printed.contains("acceptance  out of date"), "{printed}");
}

#[test]
fn the_climbers_offset_is_that_of_the_last_bring_up() {
    let state = |apart: f64| {
        format!(r#"{{"steps": {{}}, "recordings": {{}}, "clocks": [[0, 0.1], [{apart}, 0.1]]}}"#)
    };
    let offset = |place: &Place, node: &str| {
        let parameters = ParameterFile::parse(&place.text("rig.yaml")).unwrap();
        parameters.for_node(node).get("clock.climber_offset").and_then(ParameterValue::as_f64)
    };
    let former = "/pose_fusion: {ros__parameters: {clock: {climber_offset: 0.03}}}\n";
    let configured = format!("{RIG_YAML}{former}");
    for (text, apart, expected, nodes) in [
        (configured.as_str(), 0.5, Some(0.0), &["/pose_fusion"][..]),
        // In any namespace.
        (RIG_YAML, 0.5, None, &["/pose_fusion", "/rig1/pose_fusion"]),
        (RIG_YAML, 30.0, Some(0.03), &["/pose_fusion", "/rig1/pose_fusion"]),
    ] {
        let place = bring_up_of(text, &state(apart));
        let (_, printed) = bringup(&place, "offsets --rig rig.yaml", "\n");
        assert!(printed.contains("offsets     PASS"), "{printed}");
        for &node in nodes {
            assert_eq!(offset(&place, node), expected, "{printed}");
        }
    }
}

/// A recording of its own is made again, by whatever name the rig file is given.
#[test]
fn an_own_recording_is_no_default() {
    let place = Place::with_rig(RIG_YAML);
    let own = place.path("rig.yaml.bringup/rest.mcap");
    fs::create_dir_all(own.parent().unwrap()).unwrap();
    fs::create_dir(place.path("other")).unwrap();
    fs::write(&own, "").unwrap();
    let state = format!(r#"{{"steps": {{}}, "recordings": {{"rest": {own:?}}}}}"#);
    place.write("rig.yaml.bringup.json", state);
    let (_, printed) = bringup(&place, "imu --rig other/../rig.yaml", "\n\n");
    assert!(printed.contains("[live 60]"), "{printed}");
}

/// No topic of the bag has the rig's name, and `bringup` has no option that would name one. The
/// later steps use the answer.
#[test]
fn the_operator_chooses_the_rigs_camera_where_a_bag_has_two_others() {
    let place = Place::with_rig(RIG_YAML);
    let mut bag = BagWriter::create(&place.path("two.mcap"), WriteOptions::default()).unwrap();
    for name in ["/a_room/image/compressed", "/b_room/image/compressed"] {
        for stamp in (1..10).map(|i| Stamp::from_nanos(i * 50_000_000)) {
            let image = CompressedImage {
                header: convert::header("", stamp),
                ..CompressedImage::default()
            };
            let logged = u64::try_from(stamp.as_nanos()).unwrap();
            put(&mut bag, name, &Qos::SENSOR, logged, &image);
        }
    }
    bag.finish().unwrap();
    let answers = "\ntwo.mcap\n/c_room\n/b_room/image/compressed\n\n";
    let (_, printed) = bringup(&place, "camera --rig rig.yaml", answers);
    for needle in [
        "Images on /a_room/image/compressed, /b_room/image/compressed",
        "`/c_room` is not one of the answers",
        "rate: 20.0 images/s",
        "no usable image",
    ] {
        assert!(printed.contains(needle), "{needle} in\n{printed}");
    }
    assert!(!printed.contains("--namespace") && !printed.contains("--topic"), "{printed}");
    let (_, printed) = bringup(&place, "mounting --rig rig.yaml", "\ntwo.mcap\n\n");
    assert!(printed.contains("no usable camera_info in it"), "{printed}");
    assert!(!printed.contains("Images on") && !printed.contains("--namespace"), "{printed}");
}
