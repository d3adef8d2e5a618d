//! `volant calibrate`: each command updates its file in place, keeps every other key and comment,
//! and leaves the former file as `.bak`.
#![allow(clippy::unwrap_used, clippy::panic)]

mod simulated;

use bag::{BagReader, BagWriter, Topic, WriteOptions};
use node_kit::convert;
use rig_model::{MarkerColor, Rig};
use rig_simulator::motion::{Motion, MotionConfig};
use ros_parameters::{ParameterFile, ParameterMap};
use simulated::{Simulated, resting};
use std::{
    collections::HashMap,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};
use tempfile::TempDir;
use volant_msgs::{Message, cdr, sensor_msgs::msg::Imu};

fn volant(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_volant")).args(arguments).output().unwrap()
}

/// Runs a command that succeeds; returns what it prints.
fn done(arguments: &[&str]) -> String {
    let output = volant(arguments);
    let printed = [output.stdout, output.stderr].map(|b| String::from_utf8_lossy(&b).into_owned());
    assert!(output.status.success(), "{arguments:?}: {}", printed.concat());
    printed.concat()
}

/// Runs a command that fails; returns its error.
fn failed(arguments: &[&str]) -> String {
    let output = volant(arguments);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {message}");
    message
}

/// A user's rig file: comments, colors, and nodes' parameters after the rig.
fn dressed(rig: &str) -> String {
    let colors = "markers: # glued on Monday\n      colors: {red: [180.0, 40.0, 40.0]} # by eye\n";
    let nodes = "/pose_fusion: # ours\n  ros__parameters: {prediction_horizon: 0.05}\n\
                 /climber_driver:\n  ros__parameters:\n    # with the tape\n    height: 2.5 # m\n";
    assert!(rig.contains("markers:\n"));
    format!("# the rig in hall 3\n{}{nodes}", rig.replacen("markers:\n", colors, 1))
}

/// Asserts that all but some lines are those of before, in order.
fn assert_same_lines(before: &str, after: &str, except: &[&str]) {
    let others = |text: &str| -> Vec<String> {
        let keep = |line: &&str| !except.iter().any(|e| line.trim_start().starts_with(e));
        text.lines().filter(keep).map(str::to_owned).collect()
    };
    assert_eq!(others(before), others(after));
}

fn backup(path: &Path) -> PathBuf {
    PathBuf::from(format!("{}.bak", path.display()))
}

fn parameters(text: &str, node: &str) -> ParameterMap {
    ParameterFile::parse(text).unwrap().for_node(node)
}

#[test]
fn rig_keeps_colors_comments_and_the_nodes_parameters() {
    let (folder, simulated) = (TempDir::new().unwrap(), Simulated::new(5));
    let [bag, path] = ["swing.mcap", "rig.yaml"].map(|n| folder.path().join(n));
    simulated.write(&bag, &simulated.motion(9.0, true), true);
    // The IMU is turned by two degrees.
    let turned = "[0.0126, 0.0097, 0.0269, 0.9995]";
    let measured = "[-0.00480638, 0.00967114, 0.02698588, 0.99957748]";
    assert!(rig_simulator::RIG_YAML.contains(measured));
    let before = dressed(&rig_simulator::RIG_YAML.replace(measured, turned));
    fs::write(&path, &before).unwrap();
    let [bag, rig] = [bag.to_str().unwrap(), path.to_str().unwrap()];
    done(&["calibrate", "rig", bag, "--rig", rig]);
    let after = fs::read_to_string(&path).unwrap();
    assert_ne!(before, after);
    let changing = ["position:", "orientation:", "red: [", "green:", "blue:", "yellow:"];
    assert_same_lines(&before, &after, &changing);
    assert_eq!(fs::read_to_string(backup(&path)).unwrap(), before);
    for node in ["/pose_fusion", "/climber_driver"] {
        let own = |text: &str| -> Vec<_> {
            let all = parameters(text, node);
            all.into_iter().filter(|(name, _)| !name.starts_with(['c', 'i', 'm'])).collect()
        };
        assert_eq!(own(&before), own(&after));
        assert!(!own(&after).is_empty());
    }
    assert_eq!(Rig::from_yaml(&after).unwrap().colors, Rig::from_yaml(&before).unwrap().colors);
    // A new file instead, and never over another one.
    let out = folder.path().join("refined.yaml");
    let arguments = ["calibrate", "rig", bag, "--rig", rig, "--out", out.to_str().unwrap()];
    done(&arguments);
    assert_same_lines(&before, &fs::read_to_string(&out).unwrap(), &changing);
    assert_eq!(fs::read_to_string(&path).unwrap(), after);
    assert!(failed(&arguments).contains("--overwrite"));
}

#[test]
fn rig_rejects_a_recording_at_rest() {
    let (folder, simulated) = (TempDir::new().unwrap(), Simulated::new(5));
    let [bag, rig] = ["rest.mcap", "rig.yaml"].map(|n| folder.path().join(n));
    simulated.write(&bag, &Motion::new(MotionConfig::rest(5)), true);
    fs::write(&rig, rig_simulator::RIG_YAML).unwrap();
    let message =
        failed(&["calibrate", "rig", bag.to_str().unwrap(), "--rig", rig.to_str().unwrap()]);
    assert!(message.contains("determines neither"), "{message}");
    assert_eq!(fs::read_to_string(&rig).unwrap(), rig_simulator::RIG_YAML);
}

/// Copies a bag and changes its IMU messages, given with the time of logging, ns.
fn change_imu(from: &Path, to: &Path, mut change: impl FnMut(u64, &mut Topic, &mut Imu)) {
    let mut reader = BagReader::open(from).unwrap();
    let mut bag = BagWriter::create(to, WriteOptions::default()).unwrap();
    while let Some(message) = reader.next_message().unwrap() {
        let (mut topic, mut data) = ((*message.topic).clone(), message.data);
        if topic.type_name == Imu::TYPE_NAME {
            let mut imu: Imu = cdr::from_bytes(&data).unwrap();
            change(message.log_time, &mut topic, &mut imu);
            data = cdr::to_bytes(&imu);
        }
        let id = bag.add_topic(topic);
        bag.write(id, message.log_time, message.log_time, &data).unwrap();
    }
    bag.finish().unwrap();
}

#[test]
fn rig_writes_nothing_where_a_clock_steps() {
    let (folder, simulated) = (TempDir::new().unwrap(), Simulated::new(5));
    let [bag, path] = ["swing.mcap", "rig.yaml"].map(|n| folder.path().join(n));
    simulated.write(&bag, &simulated.motion(9.0, true), true);
    fs::write(&path, rig_simulator::RIG_YAML).unwrap();
    for (seconds, word) in [(2.0, "step by"), (-0.3, "step by -0.")] {
        let stepped = folder.path().join(format!("{seconds}.mcap"));
        change_imu(&bag, &stepped, |at, _, imu| {
            if at > 1_700_000_004_500_000_000 {
                let stamp = convert::stamp(&imu.header.stamp).plus_seconds(seconds);
                imu.header = convert::header(&imu.header.frame_id, stamp);
            }
        });
        let [bag, rig] = [&stepped, &path].map(|p| p.to_str().unwrap());
        let message = failed(&["calibrate", "rig", bag, "--rig", rig]);
        let diverged = message.contains("does not converge");
        assert!(message.contains(word) || diverged, "{seconds}: {message}");
        assert_eq!(fs::read_to_string(&path).unwrap(), rig_simulator::RIG_YAML);
    }
}

#[test]
fn colors_are_those_of_the_markers_and_the_rest_of_the_rig_file_stays() {
    let Some(shared) = test_support::recordings() else { return };
    let folder = TempDir::new().unwrap();
    for name in ["nominal", "clutter"] {
        let recording = shared.join("bags").join(name);
        let bag = recording.join("in.mcap");
        let path = folder.path().join(name).with_extension("yaml");
        let before = dressed(&fs::read_to_string(recording.join("rig.yaml")).unwrap());
        fs::write(&path, &before).unwrap();
        let rig = path.to_str().unwrap();
        done(&["calibrate", "colors", bag.to_str().unwrap(), "--rig", rig]);
        let after = fs::read_to_string(&path).unwrap();
        assert_same_lines(&before, &after, &["colors:"]);
        assert!(after.contains("} # by eye"), "{after}");
        assert_eq!(fs::read_to_string(backup(&path)).unwrap(), before);
        let colors = Rig::from_yaml(&after).unwrap().colors;
        for (color, strong, weak) in [
            (MarkerColor::Red, 0, 1),
            (MarkerColor::Green, 1, 0),
            (MarkerColor::Blue, 2, 0),
            (MarkerColor::Yellow, 0, 2),
        ] {
            let rgb = colors[color].unwrap();
            assert!(rgb[strong] > 1.2 * rgb[weak], "{name} {color}: {rgb:?}");
        }
        // A file that exists is not replaced by the 190 bytes of the colors.
        failed(&["calibrate", "colors", bag.to_str().unwrap(), "--out", rig]);
        assert_eq!(fs::read_to_string(&path).unwrap(), after);
    }
}

#[test]
fn imu_writes_the_densities_and_a_figure_and_refuses_motion() {
    let (folder, simulated) = (TempDir::new().unwrap(), Simulated::new(3));
    let [bag, rig, plot] = ["rest.mcap", "rig.yaml", "allan.svg"].map(|n| folder.path().join(n));
    simulated.write_rest(&bag);
    let before = dressed(rig_simulator::RIG_YAML)
        .replace("accelerometer_noise_density: 0.002", "accelerometer_noise_density: 0.5 # guess")
        .replace("gyroscope_noise_density: 0.00087266", "gyroscope_noise_density: 0.5 # guess");
    fs::write(&rig, &before).unwrap();
    let [file, rig_file, svg] = [&bag, &rig, &plot].map(|p| p.to_str().unwrap());
    let printed = done(&["calibrate", "imu", file, "--rig", rig_file, "--plot", svg]);
    assert!(printed.contains("60.0 s at 100.0") && printed.contains("record longer"), "{printed}");
    let after = fs::read_to_string(&rig).unwrap();
    assert_same_lines(&before, &after, &["accelerometer_noise", "gyroscope_noise"]);
    assert_eq!(after.matches("# guess").count(), 2);
    assert_eq!(fs::read_to_string(backup(&rig)).unwrap(), before);
    let imu = Rig::from_yaml(&after).unwrap().imu;
    for (found, truth) in
        [(imu.accelerometer_noise_density, 0.002), (imu.gyroscope_noise_density, 0.00087266)]
    {
        assert!((found / truth - 1.0).abs() < 0.05, "{found} {truth}");
    }
    let svg = fs::read_to_string(&plot).unwrap();
    assert!(svg.contains("Allan deviation [rad/s]") && svg.contains("averaging time [s]"));
    let moving = folder.path().join("swing.mcap");
    simulated.write(&moving, &simulated.motion(30.0, true), false);
    let message = failed(&["calibrate", "imu", moving.to_str().unwrap(), "--rig", rig_file]);
    assert!(message.contains("not at rest") && message.contains("swing.mcap"), "{message}");
    assert_eq!(fs::read_to_string(&rig).unwrap(), after);
}

/// A driver that was restarted with another QoS has two channels, and another IMU is no choice.
#[test]
fn imu_reads_all_channels_of_the_rigs_topic_and_reports_what_is_not_finite() {
    let (folder, simulated) = (TempDir::new().unwrap(), Simulated::new(3));
    let [rest, bag, rig] = ["rest.mcap", "changed.mcap", "rig.yaml"].map(|n| folder.path().join(n));
    simulated.write_rest(&rest);
    fs::write(&rig, rig_simulator::RIG_YAML).unwrap();
    let mut count = 0;
    change_imu(&rest, &bag, |_, topic, imu| {
        count += 1;
        match count {
            100 => imu.linear_acceleration.x = f64::NAN,
            150 => topic.name = "/another/imu".to_owned(),
            300.. => topic.offered_qos_profiles.clear(),
            _ => {}
        }
    });
    let [bag, rig] = [&bag, &rig].map(|p| p.to_str().unwrap());
    let printed = done(&["calibrate", "imu", bag, "--rig", rig]);
    assert!(printed.contains("1 of ") && printed.contains("not finite"), "{printed}");
    let seconds = printed.split(' ').next().unwrap();
    assert!(seconds.parse::<f64>().unwrap() > 58.0, "{printed}");
}

#[test]
fn imu_finds_no_noise_in_the_motion_of_real_recordings() {
    let Some(shared) = test_support::recordings() else { return };
    let folder = TempDir::new().unwrap();
    for name in ["real_slow", "real_tapping"] {
        let recording = shared.join("bags").join(name);
        let rig = folder.path().join("rig.yaml");
        fs::write(&rig, fs::read(recording.join("rig.yaml")).unwrap()).unwrap();
        let bag = recording.join("in.mcap");
        let message =
            failed(&["calibrate", "imu", bag.to_str().unwrap(), "--rig", rig.to_str().unwrap()]);
        assert!(message.contains("not at rest"), "{name}: {message}");
    }
}

#[test]
fn climber_finds_names_signs_scales_zeros_and_height() {
    let (folder, simulated) = (TempDir::new().unwrap(), Simulated::new(4));
    let [bag, rig] = ["jog.mcap", "rig.yaml"].map(|n| folder.path().join(n));
    simulated.write_jog(&bag);
    let before = dressed(rig_simulator::RIG_YAML);
    fs::write(&rig, &before).unwrap();
    let (file, rig_file) = (bag.to_str().unwrap(), rig.to_str().unwrap());
    let printed = done(&["calibrate", "climber", file, "--rig", rig_file]);
    assert!(printed.contains("zero.rail_x") && printed.contains("survey it"), "{printed}");
    let after = fs::read_to_string(&rig).unwrap();
    assert!(after.starts_with(&before), "the keys are added below the height: {after}");
    let found = parameters(&after, "/climber_driver");
    assert_eq!(found["height"].as_f64(), Some(2.5), "surveyed");
    assert!(!found.contains_key("zero.rail_x"));

    let t = resting().translation;
    let platform = format!("{},{},{}", t.x, t.y, t.z);
    done(&["calibrate", "climber", file, "--rig", rig_file, "--platform", &platform]);
    let after = fs::read_to_string(&rig).unwrap();
    let found = parameters(&after, "/climber_driver");
    for (i, axis) in ["rail_x", "rail_y", "turn"].into_iter().enumerate() {
        let e = &simulated.encoders;
        assert_eq!(found[&format!("joints.{axis}")].to_string(), format!("{:?}", e.names[i]));
        let value = |name: &str| found[&format!("{name}.{axis}")].as_f64().unwrap();
        assert!((value("scale") / e.scale[i] - 1.0).abs() < 3e-3, "{axis} {}", value("scale"));
        let off = (value("zero") - e.zero[i]) * e.scale[i];
        assert!(off.abs() < 4e-3, "{axis} is off by {off}");
    }
    assert!((found["height"].as_f64().unwrap() - simulated.height).abs() < 0.01);
    assert_same_lines(&before, &after, &["height", "joints", "scale", "zero", "rail_", "turn"]);
    assert!(after.contains("# m\n"), "{after}");

    // A parameter file of its own; the rig file stays.
    let own = folder.path().join("encoders.yaml");
    fs::write(&own, "# encoders\n").unwrap();
    let arguments = ["--params-file", own.to_str().unwrap(), "--node", "/rig1/climber_driver"];
    done(&[&["calibrate", "climber", file, "--rig", rig_file], &arguments[..]].concat());
    let text = fs::read_to_string(&own).unwrap();
    assert!(text.starts_with("# encoders\n/rig1/climber_driver:\n"), "{text}");
    assert_eq!(fs::read_to_string(&rig).unwrap(), after);

    // The platform hangs: nothing is written.
    let swing = folder.path().join("swing.mcap");
    simulated.write(&swing, &simulated.motion(15.0, true), false);
    let message = failed(&["calibrate", "climber", swing.to_str().unwrap(), "--rig", rig_file]);
    assert!(message.contains("platform"), "{message}");
    assert_eq!(fs::read_to_string(&rig).unwrap(), after);
}

/// A bag of two rigs: each is read by its namespace, and none is guessed.
#[test]
fn a_bag_of_two_rigs_is_checked_by_namespace_and_never_mixed() {
    let folder = TempDir::new().unwrap();
    let path = |name: &str| folder.path().join(name);
    let mut bag = BagWriter::create(&path("both.mcap"), WriteOptions::default()).unwrap();
    for seed in [5, 6] {
        let simulated = Simulated::new(seed);
        let alone = path(&format!("{seed}.mcap"));
        simulated.write(&alone, &simulated.motion(9.0, true), true);
        let mut reader = BagReader::open(&alone).unwrap();
        let mut topics = HashMap::new();
        while let Some(message) = reader.next_message().unwrap() {
            let mut topic = (*message.topic).clone();
            topic.name = format!("/rig{seed}{}", topic.name);
            let id = *topics.entry(topic.name.clone()).or_insert_with(|| bag.add_topic(topic));
            bag.write(id, message.log_time, message.log_time, &message.data).unwrap();
        }
        // One damaged message does not end the check.
        let imu = topics[&format!("/rig{seed}/volant/imu/data")];
        bag.write(imu, 1, 1, b"no message").unwrap();
    }
    bag.finish().unwrap();
    fs::write(path("rig.yaml"), rig_simulator::RIG_YAML).unwrap();
    let [both, alone, rig] =
        ["both.mcap", "6.mcap", "rig.yaml"].map(|n| path(n).display().to_string());
    for command in [&["check"][..], &["calibrate", "rig"], &["calibrate", "climber"]] {
        let said = failed(&[command, &[&both, "--rig", &rig]].concat());
        assert!(said.contains("/rig5/climber") && said.contains("--namespace"), "{said}");
        assert!(said.contains("both.mcap"), "{said}");
    }
    let said = failed(&["check", &both, "--rig", &rig, "--namespace", "rig7"]);
    assert!(said.contains("/rig7/climber/camera/camera_info"), "{said}");
    let expected = volant(&["check", &alone, "--rig", &rig]);
    let found = volant(&["check", &both, "--rig", &rig, "--namespace", "rig6"]);
    assert!(!expected.stdout.is_empty());
    assert_eq!(String::from_utf8_lossy(&found.stdout), String::from_utf8_lossy(&expected.stdout));
    assert_eq!(found.status.code(), expected.status.code());
    let said = String::from_utf8_lossy(&found.stderr);
    assert!(said.contains("/rig6/volant/imu/data: a message is ignored: "), "{said}");
}

/// Encoder stamps that are off by a constant are right where the file has it, and only there.
#[test]
fn check_judges_the_encoders_stamps_with_the_configured_offset() {
    let folder = TempDir::new().unwrap();
    let [bag, rig] = ["swing.mcap", "rig.yaml"].map(|n| folder.path().join(n));
    let row = |ahead: f64, offset: &str| {
        let simulated = Simulated { climber_clock_ahead: ahead, ..Simulated::new(5) };
        let _ = fs::remove_file(&bag);
        simulated.write(&bag, &simulated.motion(20.0, true), true);
        let block = format!("/pose_fusion:\n  ros__parameters: {{clock: {{{offset}}}}}\n");
        fs::write(&rig, format!("{}{block}", rig_simulator::RIG_YAML)).unwrap();
        let output = volant(&["check", bag.to_str().unwrap(), "--rig", rig.to_str().unwrap()]);
        let printed = String::from_utf8_lossy(&output.stdout).into_owned();
        let row = printed.lines().find(|line| line.starts_with("climber clock"));
        let row = row.unwrap_or_else(|| panic!("{printed}"));
        let mut words = row.split_whitespace().skip(2);
        let mut next = || words.next().unwrap().to_owned();
        let [file, estimate] = [next(), next()].map(|value| value.parse::<f64>().unwrap());
        (output.status.code(), file, estimate, row.split_whitespace().last().unwrap().to_owned())
    };
    let (code, file, estimate, verdict) = row(-0.03, "climber_offset: 0.0");
    assert_eq!((code, file, verdict.as_str()), (Some(1), 0.0, "wrong"));
    assert!((estimate - 30.0).abs() < 3.0, "{estimate}");
    let (code, file, estimate, verdict) = row(-0.03, "climber_offset: 0.03");
    assert_eq!((code, file, verdict.as_str()), (Some(0), 30.0, "ok"));
    assert!((estimate - 30.0).abs() < 3.0, "{estimate}");
    let (code, file, estimate, verdict) = row(0.0, "climber_offset: -0.03");
    assert_eq!((code, file, verdict.as_str()), (Some(1), -30.0, "wrong"));
    assert!(estimate.abs() < 3.0, "{estimate}");
}
