//! Exit status of `volant`, and its errors: one line on standard error with given words.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

use bag::{BagReader, BagWriter, Compression, Qos, Topic, WriteOptions};
use rig_model::topics;
use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};
use tempfile::TempDir;
use volant_msgs::{
    cdr,
    geometry_msgs::msg::TransformStamped,
    sensor_msgs::msg::{CameraInfo, CompressedImage, Imu},
    std_msgs::msg::String as Text,
};

const RIG: &str = include_str!("../../launch_config/config/rig.yaml");

fn volant(arguments: &[&Path]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_volant")).args(arguments).output().unwrap()
}

/// Asserts exit status 1 and one line with these words.
fn fails(arguments: &[&Path], words: &[&str]) {
    let output = volant(arguments);
    let printed = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{arguments:?}: {printed}");
    assert_eq!(printed.trim_end().lines().count(), 1, "{printed}");
    for word in words {
        assert!(printed.contains(word), "`{word}` is not in: {printed}");
    }
    assert!(!printed.contains("panicked"), "{printed}");
}

struct Place(TempDir);

impl Place {
    fn new() -> Self {
        let place = Self(TempDir::new().unwrap());
        place.file("rig.yaml", RIG.as_bytes());
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn file(&self, name: &str, bytes: &[u8]) -> PathBuf {
        fs::write(self.path(name), bytes).unwrap();
        self.path(name)
    }

    fn replay_fails(&self, bag: &Path, words: &[&str]) {
        self.replay_with_fails(bag, &[], words);
    }

    /// The same with further arguments.
    fn replay_with_fails(&self, bag: &Path, more: &[&Path], words: &[&str]) {
        let (rig, out) = (self.path("rig.yaml"), self.path("out.mcap"));
        let usual: [&Path; 6] =
            ["replay".as_ref(), bag, "--rig".as_ref(), &rig, "--out".as_ref(), &out];
        fails(&[&usual[..], more].concat(), words);
    }
}

/// Writes a bag with a message on each topic whose name does not end with `without`.
fn bag(path: &Path, without: &str) {
    let options = WriteOptions { compression: Compression::None, ..WriteOptions::default() };
    let mut bag = BagWriter::create(path, options).unwrap();
    let qos = Qos::RELIABLE;
    let mut add = |topic: Topic, data: Vec<u8>| {
        if !topic.name.ends_with(without) || without.is_empty() {
            let id = bag.add_topic(topic);
            bag.write(id, 1_000_000_000, 1_000_000_000, &data).unwrap();
        }
    };
    add(
        Topic::of::<CompressedImage>(topics::absolute::COMPRESSED_IMAGE, &qos),
        cdr::to_bytes(&CompressedImage {
            format: "jpeg".into(),
            data: vec![1, 2, 3],
            ..Default::default()
        }),
    );
    add(
        Topic::of::<CameraInfo>(topics::absolute::CAMERA_INFO, &qos),
        cdr::to_bytes(&CameraInfo::default()),
    );
    add(Topic::of::<Imu>(topics::absolute::IMU, &qos), cdr::to_bytes(&Imu::default()));
    add(
        Topic::of::<TransformStamped>(topics::absolute::CLIMBER_TRANSFORM, &qos),
        cdr::to_bytes(&TransformStamped::default()),
    );
    bag.finish().unwrap();
}

#[test]
fn a_wrong_command_line_is_2() {
    let both = "calibrate climber x --rig r --params-file p --camera --out o";
    let both: Vec<&str> = both.split(' ').collect();
    for arguments in [
        &[][..],
        &["replay"],
        &["replay", "in.mcap", "--rig", "r.yaml"],
        &["fly"],
        &["evaluate", "x", "--bad"],
        &["evaluate", "x", "--skip", "nan"],
        &["replay", "x", "--rig", "r.yaml", "--out", "y", "--remap", "climber/transform"],
        &["replay", "x", "--rig", "r.yaml", "--out", "y", "--remap", "climber/transfrom:=/crane"],
        &["replay", "x", "--rig", "r.yaml", "--out", "y", "--threads", "0"],
        &["replay", "x", "--rig", "r.yaml", "--out", "y", "--smooth", "--model", "paper"],
        &["foxglove", "nonsense"],
        &["play", "x", "--remap", "a=b"],
        &["play", "x", "--delay", "-1"],
        &["markers", "--rig", "r.yaml", "--out", "markers.png"],
        &["record", "--out", "run.mcap", "--split-duration", "10"],
        &["record", "--out", "run", "--split-size", "0"],
        &["record", "--out", "run", "--keep", "3"],
        &["calibrate", "climber", "x", "--rig", "r", "--platform", "0,O,0,0.12"],
        both.as_slice(),
    ] {
        let output = Command::new(env!("CARGO_BIN_EXE_volant")).args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(!output.stderr.is_empty());
    }
    let help = Command::new(env!("CARGO_BIN_EXE_volant")).arg("--help").output().unwrap();
    assert_eq!(help.status.code(), Some(0));
}

#[test]
fn no_letter_stands_for_two_options() {
    for command in ["replay", "evaluate", "record", "play"] {
        let output = volant(&[Path::new(command), Path::new("--help")]);
        let help = String::from_utf8_lossy(&output.stdout).into_owned();
        let mut letters: Vec<char> = help
            .lines()
            .filter_map(|line| line.trim_start().strip_prefix('-')?.chars().next())
            .filter(char::is_ascii_alphabetic)
            .collect();
        assert!(letters.contains(&'h'), "{command}: {help}");
        letters.sort_unstable();
        let all = letters.len();
        letters.dedup();
        assert_eq!(letters.len(), all, "{command}: {help}");
    }
}

#[test]
fn bags_that_cannot_be_replayed() {
    let place = Place::new();
    place.replay_fails(&place.path("gone.mcap"), &["gone.mcap", "no such file", "give an .mcap"]);
    place.replay_fails(&place.file("empty.mcap", b""), &["empty.mcap", "empty"]);
    place.replay_fails(
        &place.file("foreign.mcap", &[7; 4096]),
        &["foreign.mcap", "not an MCAP file"],
    );
    fs::create_dir(place.path("folder")).unwrap();
    place.replay_fails(&place.path("folder"), &["metadata.yaml", "missing"]);
    for (topic, name) in [
        ("compressed", "/climber/camera/image_raw/compressed (sensor_msgs/msg/CompressedImage)"),
        ("camera_info", "/climber/camera/camera_info (sensor_msgs/msg/CameraInfo)"),
        ("data", "/volant/imu/data (sensor_msgs/msg/Imu)"),
        ("transform", "/climber/transform (geometry_msgs/msg/TransformStamped)"),
    ] {
        let path = place.path(&format!("without_{topic}.mcap"));
        bag(&path, topic);
        place.replay_fails(&path, &["no message on", name, "; record "]);
    }
    // All topics, with unusable messages.
    let path = place.path("useless.mcap");
    bag(&path, "");
    place.replay_fails(
        &path,
        &[
            "the filter never started: camera_info: ",
            "calibrate the camera or set its camera_info_url",
        ],
    );
    // A topic of another type.
    let path = place.path("other.mcap");
    let mut writer = BagWriter::create(&path, WriteOptions::default()).unwrap();
    let topic = writer.add_topic(Topic::of::<Text>(topics::absolute::IMU, &Qos::RELIABLE));
    writer.write_message(topic, 1, &Text::default()).unwrap();
    let topic = writer
        .add_topic(Topic::of::<CompressedImage>(topics::absolute::COMPRESSED_IMAGE, &Qos::SENSOR));
    writer.write_message(topic, 1, &CompressedImage::default()).unwrap();
    writer.finish().unwrap();
    place.replay_fails(
        &path,
        &["/volant/imu/data is std_msgs/msg/String", "expected sensor_msgs/msg/Imu"],
    );
}

#[test]
fn a_rig_file_that_is_wrong_is_named_with_its_key() {
    let place = Place::new();
    let input = place.path("in.mcap");
    bag(&input, "");
    assert!(RIG.contains("size:"));
    for (text, words) in [
        (RIG.replace("size:", "sise:"), ["markers.sise", "markers.size"]),
        (RIG.replace("size:", "size: [1, 2] #"), ["markers.size", "rig.yaml"]),
        ("{".to_owned(), ["rig.yaml", "not a usable rig file"]),
        (String::new(), ["rig.yaml", "not a usable rig file"]),
    ] {
        place.file("rig.yaml", text.as_bytes());
        place.replay_fails(&input, &words);
    }
    fs::remove_file(place.path("rig.yaml")).unwrap();
    place.replay_fails(&input, &["rig.yaml"]);
}

#[test]
fn a_parameter_file_that_is_wrong_is_named_with_its_parameter() {
    let place = Place::new();
    let input = place.path("in.mcap");
    bag(&input, "");
    let fails_with = |file: &Path, words: &[&str]| {
        place.replay_with_fails(&input, &["--params-file".as_ref(), file], words);
    };
    for (node, line, words) in [
        ("pose_fusion", "markers: {gait: 9.0}", ["markers.gait", "markers.gate"]),
        ("pose_fusion", "history: 60.0", ["history", "0.1"]),
        ("pose_fusion", "prediction_horizon: 0.8", ["`prediction_horizon`", "`history`"]),
        (
            "pose_fusion",
            "pendulum: {climber_attachment: [0.0, 1.0]}",
            ["pendulum.climber_attachment", "three"],
        ),
        ("marker_tracker", "max_predicted: six", ["max_predicted", "six"]),
        ("/**", "no_node_has_this: 1", ["no_node_has_this", "params.yaml"]),
        ("pose_fusion", "model: published", ["`model` is \"published\"", "one of tight, paper"]),
        ("pose_fusion", "paper: {ratio: -10.0}", ["`paper.ratio` is -10", "between 0.000001"]),
        ("pose_fusion", "paper: {ratio: .nan}", ["`paper.ratio`", "must be a number"]),
        ("pose_fusion", "paper: {position_sigma: 0.0}", ["`paper.position_sigma`", "between"]),
        ("pose_fusion", "paper: {measurement: marker}", ["`paper.measurement`", "pose, markers"]),
        ("pose_fusion", "paper: {measurment: pose}", ["paper.measurment", "paper.measurement"]),
        ("marker_tracker", "method: published", ["`method`", "one of outline, paper"]),
        ("marker_tracker", "paper: {threshold: 75}", ["`paper.threshold` is 75", "0.05 and 0.99"]),
    ] {
        let text = format!("{node}:\n  ros__parameters:\n    {line}\n");
        let file = place.file("params.yaml", text.as_bytes());
        fails_with(&file, &[words[0], words[1], "params"]);
    }
    fails_with(&place.path("gone.yaml"), &["gone.yaml"]);
}

#[test]
fn an_output_in_a_missing_folder() {
    let place = Place::new();
    let (input, rig) = (place.path("in.mcap"), place.path("rig.yaml"));
    bag(&input, "");
    let out = place.path("no/such/folder/out.mcap");
    let words: [&Path; 6] =
        ["replay".as_ref(), &input, "--rig".as_ref(), &rig, "--out".as_ref(), &out];
    fails(&words, &["out.mcap"]);
}

#[test]
fn evaluations_without_truth_or_estimates() {
    let place = Place::new();
    let input = place.path("in.mcap");
    bag(&input, "");
    fails(
        &["evaluate".as_ref(), &input, "--truth".as_ref(), &input],
        &[topics::GROUND_TRUTH, "--truth"],
    );
    let gone = place.path("gone.mcap");
    fails(
        &["evaluate".as_ref(), &input, "--truth".as_ref(), &gone],
        &["gone.mcap", "no such file"],
    );
}

#[test]
fn a_damaged_bag_is_recovered() {
    let place = Place::new();
    let (whole, cut, recovered) =
        (place.path("in.mcap"), place.path("cut.mcap"), place.path("recovered.mcap"));
    bag(&whole, "");
    let bytes = fs::read(&whole).unwrap();
    // Without its closing records: all messages are there, but rosbag2 would not open it.
    fs::write(&cut, &bytes[..bytes.len() - 100]).unwrap();
    let info = volant(&["bag".as_ref(), "info".as_ref(), &cut]);
    assert!(String::from_utf8_lossy(&info.stdout).contains("volant bag recover"));
    let recover =
        |to: &Path| volant(&["bag".as_ref(), "recover".as_ref(), &cut, "--out".as_ref(), to]);
    let output = recover(&recovered);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let (before, after) =
        (BagReader::summary(&whole).unwrap(), BagReader::summary(&recovered).unwrap());
    assert_eq!(before.topics, after.topics);
    assert!(after.complete);
    // Cut within the messages: the loss is printed.
    fs::write(&cut, &bytes[..bytes.len() * 3 / 10]).unwrap();
    let output = recover(&place.path("part.mcap"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stderr).contains("cut.mcap: the file is cut off"));
    // Cut before the first message.
    fs::write(&cut, &bytes[..40]).unwrap();
    let output = recover(&place.path("nothing.mcap"));
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("no readable message"));
    let output = volant(&["bag".as_ref(), "info".as_ref(), &recovered]);
    let printed = String::from_utf8_lossy(&output.stdout);
    assert!(
        output.status.success()
            && printed.contains(topics::absolute::IMU)
            && printed.contains("messages  4"),
        "{printed}"
    );
}

#[test]
fn an_input_is_no_output_and_two_outputs_have_two_names() {
    let place = Place::new();
    let (input, rig) = (place.path("in.mcap"), place.path("rig.yaml"));
    bag(&input, "");
    let params = place.file("params.yaml", b"pose_fusion: {ros__parameters: {history: 0.5}}\n");
    let camera = place.file("camera.svg", b"image_width: 640\n");
    let new = place.path("new.svg");
    let word = |text: &'static str| Path::new(text);
    let [rig_is, overwrite] = ["--rig", "--overwrite"].map(word);
    let is_input = ["the output is the input"];
    for arguments in [
        vec![word("calibrate"), word("imu"), &input, rig_is, &rig, word("--plot"), &rig],
        vec![word("calibrate"), word("climber"), &input, rig_is, &rig, word("--out"), &input],
        vec![
            word("check"),
            &input,
            rig_is,
            &rig,
            word("--params-file"),
            &params,
            word("--json"),
            &params,
        ],
        vec![word("markers"), rig_is, &rig, word("--camera"), &camera, word("--out"), &camera],
    ] {
        let before: Vec<_> = [&input, &rig, &params, &camera].map(|f| fs::read(f).unwrap()).into();
        fails(&[arguments, vec![overwrite]].concat(), &is_input);
        let after: Vec<_> = [&input, &rig, &params, &camera].map(|f| fs::read(f).unwrap()).into();
        assert!(before == after);
    }
    let two = ["two outputs have this name"];
    let (plot, out) = (word("--plot"), word("--out"));
    let imu = [word("calibrate"), word("imu"), &input, rig_is, &rig, plot, &new, out, &new];
    fails(&imu, &two);
    let (csv, json) = (word("--csv"), word("--json"));
    fails(&[word("evaluate"), &input, word("--truth"), &input, csv, &new, json, &new], &two);
    let nowhere = place.path("none/x.json");
    fails(&[word("check"), &input, rig_is, &rig, json, &nowhere], &["x.json", "folder"]);
    assert!(!new.exists());
}

#[test]
fn a_limit_of_file_sizes_is_a_write_error() {
    let place = Place::new();
    let (rig, out) = (place.path("rig.yaml"), place.path("markers.pdf"));
    let script = "ulimit -f 1; exec \"$0\" markers --rig \"$1\" --out \"$2\"";
    let mut command = Command::new("sh");
    command.args(["-c", script, env!("CARGO_BIN_EXE_volant")]).args([&rig, &out]);
    let output = command.output().unwrap();
    let printed = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{printed}");
    assert!(printed.contains("markers.pdf: cannot be written"), "{printed}");
    assert!(!out.exists());
}
