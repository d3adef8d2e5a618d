//! `volant bringup` on a simulated rig with a scripted terminal: from an empty rig file and lengths
//! measured with a tape to a rig file that is as good as the true one.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, clippy::disallowed_methods)]

mod simulated;

use nalgebra::Vector3;
use rig_model::{MarkerColor, Rig};
use ros_parameters::{ParameterFile, ParameterValue};
use simulated::{Simulated, resting};
use std::{
    fmt::Write as _,
    fs,
    io::Write as _,
    path::Path,
    process::{Command, Output, Stdio},
};
use tempfile::TempDir;
use test_support::process::in_domain;
use volant::{
    evaluate::{EvaluateOptions, evaluate},
    replay::TopicNames,
};

/// Runs `volant bringup` with the answers of an operator.
fn bringup(arguments: &[&str], answers: &str) -> (Output, String) {
    let mut child = in_domain(92, env!("CARGO_BIN_EXE_volant"))
        .arg("bringup")
        .args(arguments)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(answers.as_bytes()).unwrap();
    let output = child.wait_with_output().unwrap();
    let printed = [&output.stdout, &output.stderr].map(|b| String::from_utf8_lossy(b).into_owned());
    (output, printed.concat())
}

/// Position (mm) and rotation (deg) RMSE of a replay with a rig file.
fn rmse(bag: &Path, rig: &Path, truth: &Path, out: &Path) -> [f64; 2] {
    let output = Command::new(env!("CARGO_BIN_EXE_volant"))
        .arg("replay")
        .arg(bag)
        .arg("--rig")
        .arg(rig)
        .arg("--out")
        .arg(out)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let options = EvaluateOptions {
        estimates: out.to_owned(),
        truth: truth.to_owned(),
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
    let folder = TempDir::new().unwrap();
    let file = |name: &str| folder.path().join(name);
    let shown = |name: &str| file(name).display().to_string();
    let simulated = Simulated::new(1);
    simulated.write_rest(&file("rest.mcap"));
    simulated.write_jog(&file("jog.mcap"));
    simulated.write(&file("swing.mcap"), &simulated.motion(60.0, true), false);
    let other = Simulated::new(101);
    let motion = other.motion(20.0, false);
    other.write(&file("work.mcap"), &motion, false);
    other.write_truth(&file("truth.mcap"), &motion);

    // The operator: markers to 0.1 mm, camera and IMU to some millimeters and degrees.
    let rig = &simulated.rig;
    let mut answers = String::from("\n76\n");
    for color in MarkerColor::ALL {
        writeln!(answers, "{}", tape(rig.markers.centers[color].coords)).unwrap();
    }
    let camera = rig.climber_from_camera.translation.vector + Vector3::new(0.004, -0.003, 0.002);
    let imu = rig.imu.volant_from_imu.translation.vector + Vector3::new(0.003, -0.002, 0.003);
    writeln!(answers, "{}\n0.7071 0.7071 0 0\n{}\n0 0 0 1", tape(camera), tape(imu)).unwrap();
    // IMU; then a pause.
    writeln!(answers, "\n\n{}", shown("rest.mcap")).unwrap();
    let rig_file = shown("rig.yaml");
    let (output, printed) = bringup(&["--rig", &rig_file], &answers);
    assert!(output.status.success(), "a pause without a failed step: {printed}");
    assert!(printed.contains("3/8 camera") && printed.contains("paused"), "{printed}");
    assert!(!printed.contains("FAIL"), "{printed}");

    // It goes on with the camera. The lens is calibrated.
    let mut answers = format!("\n{}\n\n\n{}\n", shown("swing.mcap"), shown("swing.mcap"));
    let t = resting().translation;
    writeln!(answers, "\n{} {} {}\n{}", t.x, t.y, t.z, shown("jog.mcap")).unwrap();
    // Mounting, offsets, acceptance.
    writeln!(answers, "\n{}\n\n\n{}", shown("swing.mcap"), shown("work.mcap")).unwrap();
    let page = shown("page.html");
    let (output, printed) = bringup(&["--rig", &rig_file, "--report", &page], &answers);
    eprintln!("{printed}");
    assert!(output.status.success(), "{printed}");
    assert!(!printed.contains("1/8 markers"), "resumed: {printed}");
    assert!(!printed.contains("TimeOffset") && !printed.contains("(1 times)"), "{printed}");
    for step in ["camera", "intrinsics", "encoders", "mounting", "offsets", "acceptance"] {
        assert!(printed.contains(&format!("{step:<12}PASS")), "{step}: {printed}");
    }
    let html = fs::read_to_string(&page).unwrap();
    assert!(html.contains("Bring-up: accepted") && html.contains("joint bridge"));
    assert!(fs::read(file("rig.yaml.bringup/markers.pdf")).unwrap().starts_with(b"%PDF"));
    assert!(file("rig.yaml.bringup/allan.svg").is_file());

    // The true rig file, with the true encoders.
    let e = &simulated.encoders;
    let axes = ["rail_x", "rail_y", "turn"];
    let map = |values: [String; 3]| {
        let pairs: Vec<_> = axes.iter().zip(values).map(|(a, v)| format!("{a}: {v}")).collect();
        format!("{{{}}}", pairs.join(", "))
    };
    let truth = format!(
        "{}/climber_driver:\n  ros__parameters:\n    joints: {}\n    scale: {}\n    zero: {}\n    \
         height: {}\n",
        rig_simulator::RIG_YAML,
        map(e.names.map(str::to_owned)),
        map(e.scale.map(|s| s.to_string())),
        map(e.zero.map(|z| format!("{z:?}"))),
        simulated.height
    );
    fs::write(file("true.yaml"), truth).unwrap();
    let [ours, best] = ["rig.yaml", "true.yaml"].map(|rig| {
        rmse(&file("work.mcap"), &file(rig), &file("truth.mcap"), &file(&format!("{rig}.mcap")))
    });
    eprintln!("position mm, rotation deg: {ours:?}; with the true rig file {best:?}");
    for (ours, best) in ours.into_iter().zip(best) {
        assert!(ours <= 1.3 * best, "{ours} {best}");
    }
    let found = Rig::from_yaml(&fs::read_to_string(file("rig.yaml")).unwrap()).unwrap();
    assert!((found.imu.gyroscope_noise_density / 0.000_872_66 - 1.0).abs() < 0.05);

    // A single step, which fails: the platform was not on the floor.
    let answers = format!("\n0 0 0.1\n{}\n\n", shown("swing.mcap"));
    let before = fs::read(&rig_file).unwrap();
    let (output, printed) = bringup(&["encoders", "--rig", &rig_file], &answers);
    assert_eq!(output.status.code(), Some(1), "{printed}");
    assert!(printed.contains("FAIL encoders") && printed.contains("onto the floor"), "{printed}");
    assert!(printed.contains("not accepted: encoders failed"), "{printed}");
    assert_eq!(fs::read(&rig_file).unwrap(), before);
}

#[test]
fn only_offered_answers_count_and_a_pause_writes_the_report() {
    let folder = TempDir::new().unwrap();
    let shown = |name: &str| folder.path().join(name).display().to_string();
    let (rig, page) = (shown("rig.yaml"), shown("page.html"));
    let arguments = ["--rig", &rig, "--report", &page];
    // `abc` begins no step; `s` skips the markers, and the IMU has no recording.
    let (output, printed) = bringup(&arguments, "abc\ns\nx\nq\n");
    assert!(output.status.success(), "nothing has failed: {printed}");
    assert!(printed.contains("`abc` is not one of the answers") && !printed.contains("side"));
    assert!(printed.contains("2/8 imu") && !printed.contains("Connect the IMU"), "{printed}");
    assert!(fs::read_to_string(&page).unwrap().contains("1. markers: skipped"));

    // The skipped step is offered again, and the report of the pause is replaced.
    fs::write(shown("not_a_bag.mcap"), "text").unwrap();
    let bag = shown("not_a_bag.mcap");
    let answers = format!("s\n\nno\n\n60\nlive 2m\n{bag}\nabc\nq\n");
    let (output, printed) = bringup(&arguments, &answers);
    assert_eq!(output.status.code(), Some(1), "a step has failed: {printed}");
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
    assert!(fs::read_to_string(&page).unwrap().contains("2. imu: FAIL"));

    // The page is no other file of the bring-up, not even one that does not exist yet.
    let new = shown("new.yaml");
    for page in [&new, &format!("{new}.bringup.json")] {
        let (output, printed) = bringup(&["--rig", &new, "--report", page], "q\n");
        assert_eq!(output.status.code(), Some(1), "{printed}");
        assert!(printed.contains("two outputs have this name"), "{printed}");
        assert!(!Path::new(page).exists());
    }
}

#[test]
fn a_topic_that_nobody_publishes_is_named_within_seconds_and_a_former_recording_stays() {
    let folder = TempDir::new().unwrap();
    let rig = folder.path().join("rig.yaml").display().to_string();
    let recording = folder.path().join("rig.yaml.bringup/rest.mcap");
    let record = || {
        let begun = std::time::Instant::now();
        let (_, printed) = bringup(&["imu", "--rig", &rig], "\n\nlive 100s\n\n");
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

#[test]
fn lengths_in_meters_are_rejected_at_the_prompts_for_millimeters() {
    let folder = TempDir::new().unwrap();
    let rig = folder.path().join("rig.yaml");
    let centers =
        "0.15 0.15 0.02\n15O 150 150 20\n150 150 20\n-150 150 20\n-150 -150 20\n150 -150 20\n";
    let mountings = "0 0 -100\n0 0 0 0\n0.7071 0.7071 0 0\n0 0 0\n0 0 0 1\n";
    let answers = format!("\n0.076\n76000\n80\n{centers}{mountings}");
    let (_, printed) = bringup(&["markers", "--rig", &rig.display().to_string()], &answers);
    for needle in [
        "the side is 0.076 mm: give it in millimeters",
        "the side is 76000 mm",
        "the position is 0.15 0.15 0.02 mm: give it in millimeters",
        "write 3 numbers",
        "its length is 0.000",
        "markers     PASS",
    ] {
        assert!(printed.contains(needle), "{needle} in\n{printed}");
    }
    let rig = Rig::from_yaml(&fs::read_to_string(&rig).unwrap()).unwrap();
    assert_eq!((rig.markers.side, rig.markers.centers[MarkerColor::Red].x), (0.08, 0.15));
}

#[test]
fn a_misspelled_key_is_named_and_nothing_is_written_before_an_answer() {
    let folder = TempDir::new().unwrap();
    let rig = folder.path().join("v.yaml");
    let shown = rig.display().to_string();
    let here = || fs::read_dir(folder.path()).unwrap().count();
    let text = rig_simulator::RIG_YAML.replacen("position:", "postion:", 1);
    fs::write(&rig, &text).unwrap();
    let (output, printed) = bringup(&["--rig", &shown], "q\n");
    assert_eq!(output.status.code(), Some(1), "{printed}");
    let named = "the parameter `camera.postion` is not known (did you mean `camera.position`?)";
    assert!(printed.contains("v.yaml: ") && printed.contains(named), "{printed}");
    assert_eq!((fs::read_to_string(&rig).unwrap(), here()), (text, 1));
    // A file without the key is completed at the first answer only.
    let text = "/**:\n  ros__parameters:\n    markers: {size: 0.08}\n";
    fs::write(&rig, text).unwrap();
    let (_, printed) = bringup(&["--rig", &shown], "q\n");
    assert_eq!((fs::read_to_string(&rig).unwrap().as_str(), here()), (text, 1), "{printed}");
    let (_, printed) = bringup(&["--rig", &shown], "\nq\n");
    assert!(printed.contains("side [80]"), "{printed}");
    let rig = Rig::from_yaml(&fs::read_to_string(&rig).unwrap()).unwrap();
    assert_eq!(rig.markers.side, 0.08);
}

/// Writes a rig file and the state of a bring-up.
fn bring_up_of(folder: &TempDir, rig: &str, state: &str) -> String {
    let path = folder.path().join("rig.yaml").display().to_string();
    fs::write(&path, rig).unwrap();
    fs::write(format!("{path}.bringup.json"), state).unwrap();
    path
}

#[test]
fn a_changed_rig_file_puts_the_later_steps_out_of_date() {
    let folder = TempDir::new().unwrap();
    let done = r#"{"outcome": "done", "items": [], "wrote": []}"#;
    let steps = ["markers", "imu", "acceptance"].map(|step| format!("\"{step}\": {done}"));
    let state = format!(r#"{{"steps": {{{}}}, "recordings": {{}}}}"#, steps.join(", "));
    let rig = bring_up_of(&folder, rig_simulator::RIG_YAML, &state);
    let page = folder.path().join("page.html").display().to_string();
    let arguments = ["markers", "--rig", &rig, "--report", &page];
    let accepted = || fs::read_to_string(&page).unwrap().contains("Bring-up: accepted");
    // Nothing changes.
    let (output, printed) = bringup(&arguments, "s\n");
    assert!(output.status.success() && printed.contains("acceptance  PASS"), "{printed}");
    assert!(accepted());
    // The side of the squares changes, and the step is paused after it.
    let (_, printed) = bringup(&arguments, "\n81\nq\n");
    assert!(printed.contains("paused") && !accepted(), "{printed}");
    // The skipped steps are offered again.
    let (_, printed) = bringup(&["--rig", &rig], "s\nq\n");
    assert!(printed.contains("1/8 markers") && printed.contains("2/8 imu"), "{printed}");
    let (_, printed) = bringup(&["offsets", "--rig", &rig], "s\n");
    assert!(printed.contains("acceptance  out of date"), "{printed}");
}

#[test]
fn the_climbers_offset_is_that_of_the_last_bring_up() {
    let folder = TempDir::new().unwrap();
    let state = |apart: f64| {
        format!(r#"{{"steps": {{}}, "recordings": {{}}, "clocks": [[0, 0.1], [{apart}, 0.1]]}}"#)
    };
    let offset = |path: &str, node: &str| {
        let parameters = ParameterFile::parse(&fs::read_to_string(path).unwrap()).unwrap();
        parameters.for_node(node).get("clock.climber_offset").and_then(ParameterValue::as_f64)
    };
    let former = "/pose_fusion: {ros__parameters: {clock: {climber_offset: 0.03}}}\n";
    let text = format!("{}{former}", rig_simulator::RIG_YAML);
    let rig = bring_up_of(&folder, &text, &state(0.5));
    let (_, printed) = bringup(&["offsets", "--rig", &rig], "\n");
    assert!(printed.contains("offsets     PASS"), "{printed}");
    assert_eq!(offset(&rig, "/pose_fusion"), Some(0.0), "{printed}");
    for (apart, expected) in [(0.5, None), (30.0, Some(0.03))] {
        let rig = bring_up_of(&folder, rig_simulator::RIG_YAML, &state(apart));
        let (_, printed) = bringup(&["offsets", "--rig", &rig], "\n");
        assert!(printed.contains("offsets     PASS"), "{printed}");
        // In any namespace.
        for node in ["/pose_fusion", "/rig1/pose_fusion"] {
            assert_eq!(offset(&rig, node), expected, "{printed}");
        }
    }
}

/// A recording of its own is made again, by whatever name the rig file is given.
#[test]
fn an_own_recording_is_no_default() {
    let folder = TempDir::new().unwrap();
    let own = folder.path().join("rig.yaml.bringup/rest.mcap");
    fs::create_dir_all(own.parent().unwrap()).unwrap();
    fs::create_dir(folder.path().join("other")).unwrap();
    fs::write(&own, "").unwrap();
    let state = format!(r#"{{"steps": {{}}, "recordings": {{"rest": {own:?}}}}}"#);
    bring_up_of(&folder, rig_simulator::RIG_YAML, &state);
    let rig = folder.path().join("other/../rig.yaml").display().to_string();
    let (_, printed) = bringup(&["imu", "--rig", &rig], "\n\n");
    assert!(printed.contains("[live 60]"), "{printed}");
}
