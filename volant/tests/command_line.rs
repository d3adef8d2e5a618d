//! Exit status of `volant`, and its errors: one line on standard error with given words.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr)]

mod place;

use bag::{BagReader, BagWriter, Compression, Qos, Topic, WriteOptions};
use place::{Place, Ran, copy_bag, put};
use rig_model::topics;
use std::{fs, path::Path, process::Command};
use volant_msgs::{
    Message, cdr,
    geometry_msgs::msg::TransformStamped,
    sensor_msgs::msg::{CameraInfo, CompressedImage, Imu, JointState},
    std_msgs::msg::String as Text,
};

const RIG: &str = include_str!("../../launch_config/config/rig.yaml");

/// What the commands replay, and where to.
const REPLAY: &str = "replay in.mcap --rig rig.yaml --out out.mcap";

/// A folder with a rig file, and a bag `in.mcap` with a message on each topic.
fn with_bag() -> Place {
    let place = Place::with_rig(RIG);
    bag(&place.path("in.mcap"), "");
    place
}

fn replay_fails(place: &Place, bag: &str, words: &[&str]) {
    place.fails(&REPLAY.replace("in.mcap", bag), words);
}

/// Writes a bag with a message on each topic whose name does not end with `without`.
fn bag(path: &Path, without: &str) {
    let options = WriteOptions { compression: Compression::None, ..WriteOptions::default() };
    let mut bag = BagWriter::create(path, options).unwrap();
    let image = CompressedImage {
        format: "jpeg".into(),
        data: vec![1, 2, 3],
        ..CompressedImage::default()
    };
    add(&mut bag, topics::absolute::COMPRESSED_IMAGE, without, &image);
    add(&mut bag, topics::absolute::CAMERA_INFO, without, &CameraInfo::default());
    add(&mut bag, topics::absolute::IMU, without, &Imu::default());
    add(&mut bag, topics::absolute::CLIMBER_TRANSFORM, without, &TransformStamped::default());
    bag.finish().unwrap();
}

fn add<M: Message>(bag: &mut BagWriter, topic: &str, without: &str, message: &M) {
    if !topic.ends_with(without) || without.is_empty() {
        put(bag, topic, &Qos::RELIABLE, 1_000_000_000, message);
    }
}

#[test]
fn a_wrong_command_line_is_2() {
    let place = Place::with_rig(RIG);
    for arguments in [
        "",
        "replay",
        "replay in.mcap --rig r.yaml",
        "fly",
        "evaluate x --bad",
        "evaluate x --skip nan",
        "replay x --rig r.yaml --out y --remap climber/transform",
        "replay x --rig r.yaml --out y --remap climber/transfrom:=/crane",
        "replay x --rig r.yaml --out y --threads 0",
        "replay x --rig r.yaml --out y --smooth --model paper",
        "foxglove nonsense",
        "play x --remap a=b",
        "play x --delay -1",
        "markers --rig r.yaml --out markers.png",
        "record --out run.mcap --split-duration 10",
        "record --out run --split-size 0",
        "record --out run --keep 3",
        "record --out run topic!",
        "replay x --rig r.yaml --out y --namespace a+b",
        "monitor --namespace a//b",
        "calibrate climber x --rig r --platform 0,O,0,0.12",
        "calibrate climber x --rig r --params-file p --camera --out o",
    ] {
        let ran = place.volant(arguments);
        assert_eq!(ran.status, Some(2), "{arguments}");
        assert!(!ran.err.is_empty());
    }
    place.done("--help");
}

#[test]
fn up_takes_a_file_after_a_space_or_an_equals_sign() {
    let place = Place::new();
    for option in ["--rig", "--params-file"] {
        let [apart, joined] =
            [" ", "="].map(|by| place.volant(&format!("up {option}{by}gone.yaml")));
        assert!(
            joined.err.contains("gone.yaml") && !joined.err.contains("no node"),
            "{}",
            joined.err
        );
        assert_eq!((apart.err, apart.status), (joined.err, joined.status));
    }
}

#[test]
fn no_letter_stands_for_two_options() {
    for command in ["replay", "evaluate", "record", "play"] {
        let help = Place::with_rig(RIG).done(&format!("{command} --help"));
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
    let place = Place::with_rig(RIG);
    place.write("empty.mcap", b"");
    place.write("foreign.mcap", [7; 4096]);
    fs::create_dir(place.path("folder")).unwrap();
    replay_fails(&place, "gone.mcap", &["gone.mcap", "no such file", "give an .mcap"]);
    replay_fails(&place, "empty.mcap", &["empty.mcap", "empty"]);
    replay_fails(&place, "foreign.mcap", &["foreign.mcap", "not an MCAP file"]);
    replay_fails(
        &place,
        "folder",
        &["folder: ", "holds metadata.yaml and the .mcap files", "neither"],
    );
    place.write("folder/run_0.mcap", b"");
    replay_fails(&place, "folder", &["holds metadata.yaml", "only the latter", "bag recover"]);
    for (topic, name) in [
        ("compressed", "/climber/camera/image_raw/compressed (sensor_msgs/msg/CompressedImage)"),
        ("camera_info", "/climber/camera/camera_info (sensor_msgs/msg/CameraInfo)"),
        ("data", "/volant/imu/data (sensor_msgs/msg/Imu)"),
        ("transform", "/climber/transform (geometry_msgs/msg/TransformStamped)"),
    ] {
        let without = format!("without_{topic}.mcap");
        bag(&place.path(&without), topic);
        replay_fails(&place, &without, &["no message on", name, "; record "]);
    }
    // All topics, with unusable messages.
    bag(&place.path("useless.mcap"), "");
    replay_fails(
        &place,
        "useless.mcap",
        &[
            "the filter never started: camera_info: ",
            "calibrate the camera or set its camera_info_url",
        ],
    );
    // A topic of another type.
    let mut writer = BagWriter::create(&place.path("other.mcap"), WriteOptions::default()).unwrap();
    put(&mut writer, topics::absolute::IMU, &Qos::RELIABLE, 1, &Text::default());
    let image = CompressedImage::default();
    put(&mut writer, topics::absolute::COMPRESSED_IMAGE, &Qos::SENSOR, 1, &image);
    writer.finish().unwrap();
    replay_fails(
        &place,
        "other.mcap",
        &["/volant/imu/data is std_msgs/msg/String", "expected sensor_msgs/msg/Imu"],
    );
    // `check` names the reasons too, and does not end at the first message.
    let words = ["climber transforms are rejected", "camera_info: ", "an image is ignored: "];
    place.fails("check useless.mcap --rig rig.yaml", &words);
}

#[test]
fn a_rig_file_that_is_wrong_is_named_with_its_key() {
    let place = with_bag();
    assert!(RIG.contains("size:"));
    // One line names the missing key and its misspelling.
    place.write("rig.yaml", RIG.replace("size:", "sise:"));
    place.fails(REPLAY, &["`markers.size` is missing", "`markers.sise`", "did you mean"]);
    place.write("rig.yaml", format!("{RIG}\n/pose_fusoin: {{ros__parameters: {{x: 1}}}}\n"));
    for command in [
        REPLAY,
        "markers --rig rig.yaml --out markers.pdf",
        "calibrate colors in.mcap --rig rig.yaml",
        "calibrate imu in.mcap --rig rig.yaml",
        "calibrate climber in.mcap --rig rig.yaml",
    ] {
        place.fails(command, &["rig.yaml", "`/pose_fusoin` matches no node (did you mean"]);
    }
    for (text, words) in [
        (RIG.replace("size:", "size: [1, 2] #"), ["markers.size", "rig.yaml"]),
        ("{".to_owned(), ["rig.yaml", "not a usable rig file"]),
        (String::new(), ["rig.yaml", "not a usable rig file"]),
    ] {
        place.write("rig.yaml", text);
        place.fails(REPLAY, &words);
    }
    fs::remove_file(place.path("rig.yaml")).unwrap();
    let missing = ["rig.yaml", "there is no such file", "correct the path"];
    for command in [REPLAY, "markers --rig rig.yaml --out markers.pdf"] {
        place.fails(command, &missing);
    }
}

/// A replay has no `-p`.
#[test]
fn the_remedy_for_a_missing_height_is_one_that_a_replay_has() {
    let (rig, _) = RIG.split_once("/**/climber_driver:").unwrap();
    let place = Place::with_rig(rig);
    bag(&place.path("with_transform.mcap"), "");
    copy_bag(&place.path("with_transform.mcap"), &place.path("in.mcap"), |topic, message| {
        if topic.name == topics::absolute::CLIMBER_TRANSFORM {
            *topic = Topic::of::<JointState>(topics::absolute::JOINT_STATES, &Qos::RELIABLE);
            message.data = cdr::to_bytes(&JointState::default());
        }
    });
    place.fails(REPLAY, &["converted by climber_driver", "`height` must be given", "in rig.yaml"]);
    assert!(!place.failed(REPLAY).contains("-p height"));
}

#[test]
fn a_parameter_file_that_is_wrong_is_named_with_its_parameter() {
    let place = with_bag();
    let replay = format!("{REPLAY} --params-file params.yaml");
    place.fails(&replay, &["params.yaml", "there is no such file", "correct the path"]);
    for (node, line, words) in [
        ("pose_fusion", "markers: {gait: 9.0}", ["markers.gait", "markers.gate"]),
        ("pose_fusion", "history: 60.0", ["history", "0.4"]),
        ("pose_fusion", "prediction_horizon: 0.8", ["`prediction_horizon`", "`history`"]),
        (
            "pose_fusion",
            "pendulum: {climber_attachment: [0.0, 1.0]}",
            ["pendulum.climber_attachment", "three"],
        ),
        ("marker_tracker", "max_predicted: six", ["max_predicted", "six"]),
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
        place.write("params.yaml", text);
        place.fails(&replay, &[&words[..], &["params"]].concat());
    }
    // Of another node that shares the file, as for the live nodes; the bag is not usable.
    place.write("params.yaml", "/**: {ros__parameters: {no_node_has_this: 1}}\n");
    let printed = place.failed(&replay);
    let lines: Vec<_> = printed.lines().filter(|line| line.contains("no_node_has_this")).collect();
    assert!(lines.len() == 1 && lines[0].contains("params.yaml"), "{printed}");
}

#[test]
fn an_output_in_a_missing_folder() {
    with_bag().fails(&REPLAY.replace("out.mcap", "no/such/folder/out.mcap"), &["out.mcap"]);
}

#[test]
fn evaluations_without_truth_or_estimates() {
    let place = with_bag();
    place.fails("evaluate in.mcap --truth in.mcap", &[topics::GROUND_TRUTH, "--truth"]);
    place.fails("evaluate in.mcap --truth gone.mcap", &["gone.mcap", "no such file"]);
}

#[test]
fn a_damaged_bag_is_recovered() {
    let place = with_bag();
    let bytes = place.read("in.mcap");
    // Without its closing records: all messages are there, but rosbag2 would not open it.
    place.write("cut.mcap", &bytes[..bytes.len() - 100]);
    assert!(place.done("bag info cut.mcap").contains("volant bag recover"));
    place.done("bag recover cut.mcap --out recovered.mcap");
    let [before, after] =
        ["in.mcap", "recovered.mcap"].map(|name| BagReader::summary(&place.path(name)).unwrap());
    assert_eq!(before.topics, after.topics);
    assert!(after.complete);
    // Cut within the messages: the loss is printed.
    place.write("cut.mcap", &bytes[..bytes.len() * 3 / 10]);
    let printed = place.done("bag recover cut.mcap --out part.mcap");
    assert!(printed.contains("cut.mcap: the file is cut off"), "{printed}");
    // Cut before the first message.
    place.write("cut.mcap", &bytes[..40]);
    let printed = place.failed("bag recover cut.mcap --out nothing.mcap");
    assert!(printed.contains("no readable message"), "{printed}");
    replay_fails(
        &place,
        "cut.mcap",
        &["no readable message, because it is cut off", "record it again"],
    );
    for command in [
        "evaluate cut.mcap --truth in.mcap",
        "evaluate in.mcap --truth cut.mcap",
        "check cut.mcap --rig rig.yaml",
        "play cut.mcap",
        "calibrate colors cut.mcap",
        "calibrate climber cut.mcap --rig rig.yaml",
        "calibrate imu cut.mcap --rig rig.yaml",
        "calibrate rig cut.mcap --rig rig.yaml",
    ] {
        place.fails(command, &["cut.mcap: ", "because it is cut off", "record it again"]);
    }
    assert!(place.done("bag info cut.mcap").contains("record it again"));
    // What is missing may have been behind the cut.
    place.write("cut.mcap", &bytes[..bytes.len() * 3 / 10]);
    for command in ["imu", "climber"] {
        let words = ["no ", "; cut.mcap: the file is cut off"];
        place.fails(&format!("calibrate {command} cut.mcap --rig rig.yaml"), &words);
    }
    // Nothing is written where an input is missing.
    place.fails("bag recover gone.mcap in.mcap --out nothing.mcap", &["gone.mcap: no such file"]);
    assert!(!place.path("nothing.mcap").exists());
    let printed = place.done("bag info recovered.mcap");
    assert!(
        printed.contains(topics::absolute::IMU) && printed.contains("messages  4"),
        "{printed}"
    );
    // Of a folder every readable file is used, whatever its metadata says; the others are named.
    fs::create_dir(place.path("folder")).unwrap();
    fs::copy(place.path("in.mcap"), place.path("folder/run_0.mcap")).unwrap();
    place.write("folder/run_1.mcap", b"");
    let metadata = "rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: \
                    [run_1.mcap, gone.mcap]}";
    for (out, metadata) in [("a.mcap", "{"), ("b.mcap", metadata)] {
        place.write("folder/metadata.yaml", metadata);
        let printed = place.done(&format!("bag recover folder --out {out}"));
        assert!(printed.contains("run_1.mcap: the file is empty"), "{printed}");
        assert_eq!(printed.contains("gone.mcap: no such file"), out == "b.mcap", "{printed}");
        assert_eq!(BagReader::summary(&place.path(out)).unwrap().messages(), 4);
    }
}

#[test]
fn an_input_is_no_output_and_two_outputs_have_two_names() {
    let place = with_bag();
    place.write("params.yaml", b"pose_fusion: {ros__parameters: {history: 0.5}}\n");
    place.write("camera.svg", b"image_width: 640\n");
    let inputs =
        || ["in.mcap", "rig.yaml", "params.yaml", "camera.svg"].map(|name| place.read(name));
    let before = inputs();
    for arguments in [
        "calibrate imu in.mcap --rig rig.yaml --plot rig.yaml",
        "calibrate climber in.mcap --rig rig.yaml --out in.mcap",
        "check in.mcap --rig rig.yaml --params-file params.yaml --json params.yaml",
        "markers --rig rig.yaml --camera camera.svg --out camera.svg",
    ] {
        place.fails(&format!("{arguments} --overwrite"), &["the output is the input"]);
        assert!(inputs() == before);
    }
    for arguments in [
        "calibrate imu in.mcap --rig rig.yaml --plot new.svg --out new.svg",
        "evaluate in.mcap --truth in.mcap --csv new.svg --json new.svg",
    ] {
        place.fails(arguments, &["two outputs have this name"]);
    }
    place.fails("check in.mcap --rig rig.yaml --json none/x.json", &["x.json", "folder"]);
    assert!(!place.path("new.svg").exists());
}

#[test]
fn the_name_of_a_bag_says_whether_it_is_a_file() {
    let place = with_bag();
    place.write("notes.txt", b"mine");
    for command in [&REPLAY.replace("out.mcap", "notes.txt"), "bag recover in.mcap --out notes.txt"]
    {
        place.fails(command, &["notes.txt: ", "does not end with .mcap", "give another name"]);
        assert!(!place.failed(command).contains("--overwrite"));
    }
    place.done("bag recover in.mcap --out OUT.MCAP");
    assert!(place.path("OUT.MCAP").is_file());
    let again = "bag recover in.mcap --out OUT.MCAP";
    place.fails(again, &["OUT.MCAP: exists already", "--overwrite"]);
    place.write("CUT.MCAP", &place.read("in.mcap")[..1000]);
    assert!(place.done("bag info CUT.MCAP").contains("cut off"));
}

#[test]
fn a_limit_of_file_sizes_is_a_write_error() {
    let place = Place::with_rig(RIG);
    let script = "ulimit -f 1; exec \"$0\" markers --rig rig.yaml --out markers.pdf";
    let mut command = Command::new("sh");
    command.args(["-c", script, env!("CARGO_BIN_EXE_volant")]).current_dir(place.folder());
    let Ran { status, err, .. } = command.output().unwrap().into();
    assert_eq!(status, Some(1), "{err}");
    assert!(err.contains("markers.pdf: cannot be written"), "{err}");
    assert!(!place.path("markers.pdf").exists());
}
