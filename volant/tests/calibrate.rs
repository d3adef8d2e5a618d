//! `volant calibrate`: each command updates its file in place, keeps every other key and comment,
//! and leaves the former file as `.bak`.
#![allow(clippy::unwrap_used, clippy::panic)]

mod place;
mod simulated;

use bag::{BagReader, BagWriter, Topic, WriteOptions};
use node_kit::convert;
use place::{Place, copy_bag};
use rig_model::{MarkerColor, Rig};
use rig_simulator::{
    RIG_YAML,
    motion::{Motion, MotionConfig},
};
use ros_parameters::{ParameterFile, ParameterMap};
use simulated::{Simulated, resting};
use std::{collections::HashMap, fs, path::Path};
use volant_msgs::{Message, cdr, sensor_msgs::msg::Imu};

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

fn parameters(text: &str, node: &str) -> ParameterMap {
    ParameterFile::parse(text).unwrap().for_node(node)
}

#[test]
fn rig_keeps_colors_comments_and_the_nodes_parameters() {
    // The IMU is turned by two degrees.
    let turned = "[0.0126, 0.0097, 0.0269, 0.9995]";
    let measured = "[-0.00480638, 0.00967114, 0.02698588, 0.99957748]";
    assert!(RIG_YAML.contains(measured));
    let before = dressed(&RIG_YAML.replace(measured, turned));
    let (place, simulated) = (Place::with_rig(&before), Simulated::new(5));
    simulated.write(&place.path("swing.mcap"), &simulated.motion(9.0, true), true);
    place.done("calibrate rig swing.mcap --rig rig.yaml");
    let after = place.text("rig.yaml");
    assert_ne!(before, after);
    let changing = ["position:", "orientation:", "red: [", "green:", "blue:", "yellow:"];
    assert_same_lines(&before, &after, &changing);
    assert_eq!(place.text("rig.yaml.bak"), before);
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
    let arguments = "calibrate rig swing.mcap --rig rig.yaml --out refined.yaml";
    place.done(arguments);
    assert_same_lines(&before, &place.text("refined.yaml"), &changing);
    assert_eq!(place.text("rig.yaml"), after);
    assert!(place.failed(arguments).contains("--overwrite"));
    // Another file's value would hide the new one, in any node that reads the rig.
    fs::write(place.path("rig.yaml"), &before).unwrap();
    for (node, options) in [("pose_fusion", ""), ("rig1/marker_tracker", "--namespace rig1")] {
        let own = format!("/{node}:\n  ros__parameters:\n    imu.orientation: {turned}\n");
        fs::write(place.path("own.yaml"), own).unwrap();
        let bag = if options.is_empty() { "swing.mcap" } else { "rig1.mcap" };
        if bag == "rig1.mcap" {
            copy_bag(&place.path("swing.mcap"), &place.path(bag), |topic, _| {
                topic.name = format!("/rig1{}", topic.name);
            });
        }
        let printed = place.failed(&format!(
            "calibrate rig {bag} --rig rig.yaml --params-file own.yaml {options}"
        ));
        let words = ["own.yaml: sets `imu.orientation`", "overrides rig.yaml"];
        assert!(words.iter().all(|word| printed.contains(word)), "{printed}");
        assert_eq!(place.text("rig.yaml"), before);
    }
}

#[test]
fn rig_rejects_a_recording_at_rest() {
    let place = Place::with_rig(RIG_YAML);
    let motion = Motion::new(MotionConfig::rest(5));
    Simulated::new(5).write(&place.path("rest.mcap"), &motion, true);
    let message = place.failed("calibrate rig rest.mcap --rig rig.yaml");
    assert!(message.contains("determines neither"), "{message}");
    assert_eq!(place.text("rig.yaml"), RIG_YAML);
}

/// Copies a bag and changes its IMU messages, given with the time of logging, ns.
fn change_imu(from: &Path, to: &Path, mut change: impl FnMut(u64, &mut Topic, &mut Imu)) {
    copy_bag(from, to, |topic, message| {
        if topic.type_name == Imu::TYPE_NAME {
            let mut imu: Imu = cdr::from_bytes(&message.data).unwrap();
            change(message.log_time, topic, &mut imu);
            message.data = cdr::to_bytes(&imu);
        }
    });
}

#[test]
fn rig_writes_nothing_where_a_clock_steps() {
    let (place, simulated) = (Place::with_rig(RIG_YAML), Simulated::new(5));
    let [bag, stepped] = ["swing.mcap", "stepped.mcap"].map(|name| place.path(name));
    simulated.write(&bag, &simulated.motion(9.0, true), true);
    for (seconds, word) in [(2.0, "step by"), (-0.3, "step by -0.")] {
        let _ = fs::remove_file(&stepped);
        change_imu(&bag, &stepped, |at, _, imu| {
            if at > 1_700_000_004_500_000_000 {
                let stamp = convert::stamp(&imu.header.stamp).plus_seconds(seconds);
                imu.header = convert::header(&imu.header.frame_id, stamp);
            }
        });
        let message = place.failed("calibrate rig stepped.mcap --rig rig.yaml");
        let diverged = message.contains("does not converge");
        assert!(message.contains(word) || diverged, "{seconds}: {message}");
        assert_eq!(place.text("rig.yaml"), RIG_YAML);
    }
}

#[test]
fn colors_are_those_of_the_markers_and_the_rest_of_the_rig_file_stays() {
    let Some(shared) = test_support::recordings() else { return };
    for name in ["nominal", "clutter"] {
        let recording = shared.join("bags").join(name).canonicalize().unwrap();
        let before = dressed(&fs::read_to_string(recording.join("rig.yaml")).unwrap());
        let place = Place::with_rig(&before);
        let colors = format!("calibrate colors {}/in.mcap", recording.display());
        place.done(&format!("{colors} --rig rig.yaml"));
        let after = place.text("rig.yaml");
        assert_same_lines(&before, &after, &["colors:"]);
        assert!(after.contains("} # by eye"), "{after}");
        assert_eq!(place.text("rig.yaml.bak"), before);
        let found = Rig::from_yaml(&after).unwrap().colors;
        for (color, strong, weak) in [
            (MarkerColor::Red, 0, 1),
            (MarkerColor::Green, 1, 0),
            (MarkerColor::Blue, 2, 0),
            (MarkerColor::Yellow, 0, 2),
        ] {
            let rgb = found[color].unwrap();
            assert!(rgb[strong] > 1.2 * rgb[weak], "{name} {color}: {rgb:?}");
        }
        // A file that exists is not replaced by the 190 bytes of the colors.
        place.failed(&format!("{colors} --out rig.yaml"));
        assert_eq!(place.text("rig.yaml"), after);
    }
}

#[test]
fn imu_writes_the_densities_and_a_figure_and_refuses_motion() {
    let before = dressed(RIG_YAML)
        .replace("accelerometer_noise_density: 0.002", "accelerometer_noise_density: 0.5 # guess")
        .replace("gyroscope_noise_density: 0.00087266", "gyroscope_noise_density: 0.5 # guess");
    let (place, simulated) = (Place::with_rig(&before), Simulated::new(3));
    simulated.write_rest(&place.path("rest.mcap"));
    let printed = place.done("calibrate imu rest.mcap --rig rig.yaml --plot allan.svg");
    assert!(printed.contains("60.0 s at 100.0") && printed.contains("record longer"), "{printed}");
    let after = place.text("rig.yaml");
    assert_same_lines(&before, &after, &["accelerometer_noise", "gyroscope_noise"]);
    assert_eq!(after.matches("# guess").count(), 2);
    assert_eq!(place.text("rig.yaml.bak"), before);
    let imu = Rig::from_yaml(&after).unwrap().imu;
    for (found, truth) in
        [(imu.accelerometer_noise_density, 0.002), (imu.gyroscope_noise_density, 0.00087266)]
    {
        assert!((found / truth - 1.0).abs() < 0.05, "{found} {truth}");
    }
    let svg = place.text("allan.svg");
    assert!(svg.contains("Allan deviation [rad/s]") && svg.contains("averaging time [s]"));
    simulated.write(&place.path("swing.mcap"), &simulated.motion(30.0, true), false);
    let message = place.failed("calibrate imu swing.mcap --rig rig.yaml");
    assert!(message.contains("not at rest") && message.contains("swing.mcap"), "{message}");
    assert_eq!(place.text("rig.yaml"), after);
}

/// A driver that was restarted with another QoS has two channels, and another IMU is no choice.
#[test]
fn imu_reads_all_channels_of_the_rigs_topic_and_reports_what_is_not_finite() {
    let place = Place::with_rig(RIG_YAML);
    Simulated::new(3).write_rest(&place.path("rest.mcap"));
    let mut count = 0;
    change_imu(&place.path("rest.mcap"), &place.path("changed.mcap"), |_, topic, imu| {
        count += 1;
        match count {
            100 => imu.linear_acceleration.x = f64::NAN,
            150 => topic.name = "/another/imu".to_owned(),
            300.. => topic.offered_qos_profiles.clear(),
            _ => {}
        }
    });
    let printed = place.done("calibrate imu changed.mcap --rig rig.yaml");
    assert!(printed.contains("1 of ") && printed.contains("not finite"), "{printed}");
    let seconds = printed.split(' ').next().unwrap();
    assert!(seconds.parse::<f64>().unwrap() > 58.0, "{printed}");
}

#[test]
fn imu_finds_no_noise_in_the_motion_of_real_recordings() {
    let Some(shared) = test_support::recordings() else { return };
    for name in ["real_slow", "real_tapping"] {
        let recording = shared.join("bags").join(name).canonicalize().unwrap();
        let rig = fs::read_to_string(recording.join("rig.yaml")).unwrap();
        let bag = recording.join("in.mcap");
        let imu = format!("calibrate imu {} --rig rig.yaml", bag.display());
        let message = Place::with_rig(&rig).failed(&imu);
        assert!(message.contains("not at rest"), "{name}: {message}");
    }
}

#[test]
fn climber_finds_names_signs_scales_zeros_and_height() {
    let before = dressed(RIG_YAML);
    let (place, simulated) = (Place::with_rig(&before), Simulated::new(4));
    simulated.write_jog(&place.path("jog.mcap"), true);
    let climber = "calibrate climber jog.mcap --rig rig.yaml";
    let printed = place.done(climber);
    assert!(printed.contains("zero.rail_x") && printed.contains("survey it"), "{printed}");
    let after = place.text("rig.yaml");
    assert!(after.starts_with(&before), "the keys are added below the height: {after}");
    let found = parameters(&after, "/climber_driver");
    assert_eq!(found["height"].as_f64(), Some(2.5), "surveyed");
    assert!(!found.contains_key("zero.rail_x"));

    let t = resting().translation;
    place.done(&format!("{climber} --platform {},{},{}", t.x, t.y, t.z));
    let after = place.text("rig.yaml");
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
    place.write("encoders.yaml", "# encoders\n");
    place.done(&format!("{climber} --params-file encoders.yaml --node /rig1/climber_driver"));
    let text = place.text("encoders.yaml");
    assert!(text.starts_with("# encoders\n/rig1/climber_driver:\n"), "{text}");
    assert_eq!(place.text("rig.yaml"), after);

    // The platform hangs: nothing is written.
    simulated.write(&place.path("swing.mcap"), &simulated.motion(15.0, true), false);
    let message = place.failed("calibrate climber swing.mcap --rig rig.yaml");
    assert!(message.contains("platform"), "{message}");
    assert_eq!(place.text("rig.yaml"), after);
}

/// The values of the other rig stay, and so does the rig file with `--out`.
#[test]
fn climber_changes_the_blocks_that_a_namespaces_nodes_read() {
    let block = |node: &str, values: &str| format!("{node}: {{ros__parameters: {{{values}}}}}\n");
    let blocks = ["/**/climber_driver", "/rig1/climber_driver"].map(|n| block(n, "height: 2.5"));
    let sigma = "calibration.encoder_scale_sigma: 0.05";
    let sigmas = ["/**/pose_fusion", "/rig1/pose_fusion"].map(|n| block(n, sigma));
    let before = [RIG_YAML, &blocks.concat(), &sigmas.concat()].concat();
    let (place, simulated) = (Place::with_rig(&before), Simulated::new(4));
    simulated.write_jog(&place.path("jog.mcap"), true);
    let t = resting().translation;
    let platform = format!("--platform {},{},{}", t.x, t.y, t.z);
    let topics = ["joint_states", "markers", "camera/camera_info"];
    let remap = topics.map(|name| format!(" --remap climber/{name}:=/climber/{name}")).concat();
    let rig1 = format!("--namespace rig1{remap}");
    let climber = format!("calibrate climber jog.mcap --rig rig.yaml {rig1} {platform}");
    place.write("encoders.yaml", "# encoders\n");
    let printed = place.done(&format!("{climber} --params-file encoders.yaml --out new.yaml"));
    assert!(
        printed.contains("rig.yaml: unchanged") && printed.contains("scale_sigma"),
        "{printed}"
    );
    assert_eq!(place.text("rig.yaml"), before);
    place.done(&climber);
    let after = place.text("rig.yaml");
    let value = |node: &str, name: &str| parameters(&after, node)[name].as_f64().unwrap();
    assert!((value("/rig1/climber_driver", "height") - simulated.height).abs() < 0.01);
    assert!(value("/rig1/pose_fusion", "calibration.encoder_scale_sigma") < 0.005);
    assert_eq!(value("/rig2/climber_driver", "height"), 2.5);
    assert_eq!(value("/rig2/pose_fusion", "calibration.encoder_scale_sigma"), 0.05);
}

#[test]
fn a_climber_without_a_turn_is_calibrated() {
    let rig = dressed(RIG_YAML).replace("height: 2.5 # m\n", "height: 2.5\n    joints.turn: ''\n");
    let (place, simulated) = (Place::with_rig(&rig), Simulated::new(4));
    simulated.write_jog(&place.path("jog.mcap"), false);
    let t = resting().translation;
    let command = "calibrate climber jog.mcap --rig rig.yaml --platform";
    let printed = place.done(&format!("{command} {},{},{}", t.x, t.y, t.z));
    assert!(printed.contains("the climber has no such axis"), "{printed}");
    let found = parameters(&place.text("rig.yaml"), "/climber_driver");
    for (i, axis) in ["rail_x", "rail_y"].into_iter().enumerate() {
        let scale = found[&format!("scale.{axis}")].as_f64().unwrap();
        assert!((scale / simulated.encoders.scale[i] - 1.0).abs() < 3e-3, "{axis} {scale}");
    }
    assert!((found["height"].as_f64().unwrap() - simulated.height).abs() < 0.01);
    assert_eq!(found["joints.turn"].to_string(), "\"\"");
}

/// A bag of two rigs: each is read by its namespace, and none is guessed.
#[test]
fn a_bag_of_two_rigs_is_checked_by_namespace_and_never_mixed() {
    let place = Place::with_rig(RIG_YAML);
    let mut bag = BagWriter::create(&place.path("both.mcap"), WriteOptions::default()).unwrap();
    for seed in [5, 6] {
        let simulated = Simulated::new(seed);
        let alone = place.path(&format!("{seed}.mcap"));
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
    for command in ["check", "calibrate rig", "calibrate climber"] {
        let said = place.failed(&format!("{command} both.mcap --rig rig.yaml"));
        assert!(said.contains("/rig5/climber") && said.contains("--namespace"), "{said}");
        assert!(said.contains("both.mcap"), "{said}");
    }
    let said = place.failed("check both.mcap --rig rig.yaml --namespace rig7");
    assert!(said.contains("/rig7/climber/camera/camera_info"), "{said}");
    let expected = place.volant("check 6.mcap --rig rig.yaml");
    let found = place.volant("check both.mcap --rig rig.yaml --namespace rig6");
    assert!(!expected.out.is_empty());
    assert_eq!((found.out, found.status), (expected.out, expected.status));
    let said = found.err;
    assert!(said.contains("/rig6/volant/imu/data: a message is ignored: "), "{said}");
}

/// Encoder stamps that are off by a constant are right where the file has it, and only there.
#[test]
fn check_judges_the_encoders_stamps_with_the_configured_offset() {
    for (ahead, offset, code, verdict) in
        [(-0.03, 0.0, 1, "wrong"), (-0.03, 0.03, 0, "ok"), (0.0, -0.03, 1, "wrong")]
    {
        let block = format!(
            "/pose_fusion:\n  ros__parameters: {{clock: {{climber_offset: {offset:?}}}}}\n"
        );
        let place = Place::with_rig(&format!("{RIG_YAML}{block}"));
        let simulated = Simulated { climber_clock_ahead: ahead, ..Simulated::new(5) };
        simulated.write(&place.path("swing.mcap"), &simulated.motion(20.0, true), true);
        let ran = place.volant("check swing.mcap --rig rig.yaml");
        assert_eq!(ran.status, Some(code), "{}", ran.out);
        let row = ran.out.lines().find(|line| line.starts_with("climber clock"));
        let words: Vec<&str> = row.unwrap().split_whitespace().skip(2).collect();
        assert_eq!(words.last(), Some(&verdict), "{words:?}");
        let [file, estimate] = [words[0], words[1]].map(|value| value.parse::<f64>().unwrap());
        assert_eq!(file, 1e3 * offset);
        assert!((estimate + 1e3 * ahead).abs() < 3.0, "{estimate}");
    }
}
