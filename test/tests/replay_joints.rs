//! Replay of encoder readings through the climber driver, with the parameters of the nodes' files.
#![allow(missing_docs, clippy::unwrap_used)]

use bag::recording::map_messages;
use climber_driver::{Climber, ClimberConfig, Output};
use node_kit::convert;
use rig_model::{ClimberSample, topics};
use rig_simulator::{RIG_YAML, motion::MotionConfig};
use std::{
    fs,
    path::{Path, PathBuf},
    process::{self, Command},
};
use tempfile::TempDir;
use volant_msgs::{geometry_msgs::msg::TransformStamped, sensor_msgs::msg::JointState};
use volant_test::live::{Scenario, bag::from_sensors, processes::executables};

/// Encoders with names, scale, sign and zero of their own.
fn config() -> ClimberConfig {
    let mut config = ClimberConfig {
        height: MotionConfig::nominal(0).climber_height,
        ..ClimberConfig::default()
    };
    for (joint, (name, scale, zero)) in config.joints.iter_mut().zip([
        ("long", 0.001, 250.0),
        ("cross", -0.5, 0.1),
        ("yaw", 2.0, 0.0),
    ]) {
        (joint.name, joint.scale, joint.zero) = (name.to_owned(), scale, zero);
    }
    config
}

const PARAMETERS: &str = "\
climber_driver:
  ros__parameters:
    joints: {rail_x: long, rail_y: cross, turn: yaw}
    scale: {rail_x: 0.001, rail_y: -0.5, turn: 2.0}
    zero: {rail_x: 250.0, rail_y: 0.1, turn: 0.0}
    height: HEIGHT
";

/// What encoders read that yield `sample` with [`config`].
fn joints(sample: &ClimberSample) -> JointState {
    let pose = &sample.world_from_climber;
    let axes = [pose.translation.x, pose.translation.y, pose.rotation.euler_angles().2];
    let config = config();
    let readings = config.joints.iter().zip(axes).map(|(j, axis)| axis / j.scale + j.zero);
    JointState {
        header: convert::header("", sample.stamp),
        name: config.joints.iter().map(|j| j.name.clone()).collect(),
        position: readings.collect(),
        ..JointState::default()
    }
}

/// A folder with the encoder readings of a swing, `joints.mcap`, and its rig file, `rig.yaml`.
struct Place {
    folder: TempDir,
    scenario: Scenario,
}

impl Place {
    fn new(seconds: f64) -> Self {
        let scenario = Scenario::swing(7, seconds).unwrap();
        let place = Self { folder: TempDir::new().unwrap(), scenario };
        let topic = topics::absolute::JOINT_STATES;
        from_sensors(&place.path("joints.mcap"), &place.scenario, topic, joints).unwrap();
        fs::write(place.path("rig.yaml"), RIG_YAML).unwrap();
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}

fn replay(bag: &Path, out: &Path, rig: &Path, more: &[&str]) -> process::Output {
    let mut command = Command::new(executables().join("volant"));
    command.arg("replay").arg(bag).arg("--rig").arg(rig).arg("--out").arg(out);
    command.args(more).output().unwrap()
}

#[test]
fn encoder_readings_give_the_pose_of_the_drivers_transforms() {
    let place = Place::new(5.0);
    let (path, scenario) = (|name: &str| place.path(name), &place.scenario);
    // The driver's core over the same readings, received when they were logged.
    let mut driver = Climber::new(config()).unwrap();
    let mut transforms = 0;
    let topic = topics::absolute::CLIMBER_TRANSFORM;
    from_sensors(&path("transforms.mcap"), scenario, topic, |sample| {
        driver.handle(&convert::joint_reading(&joints(sample)), sample.stamp);
        transforms += 1;
        match driver.poll() {
            Some(Output::Sample(sample)) => convert::climber_message(&sample, &scenario.rig.frames),
            other => unreachable!("{other:?}"),
        }
    })
    .unwrap();
    let height = config().height;
    let parameters = PARAMETERS.replace("HEIGHT", &format!("{height:?}"));
    let (rig, params, both) = (path("rig.yaml"), path("climber.yaml"), path("both.yaml"));
    fs::write(&params, &parameters).unwrap();
    fs::write(&both, format!("{RIG_YAML}\n{parameters}")).unwrap();
    let done = |bag: &str, out: &str, rig: &Path, more: &[&str]| {
        let output = replay(&path(bag), &path(out), rig, more);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        fs::read(path(out)).unwrap()
    };
    let usual = done("transforms.mcap", "usual.mcap", &rig, &[]);
    let params = params.to_str().unwrap();
    assert!(done("joints.mcap", "file.mcap", &rig, &["--params-file", params]) == usual);
    assert!(done("joints.mcap", "block.mcap", &both, &[]) == usual);
    let height_of = |_, m: TransformStamped| m.transform.translation.z;
    let heights = map_messages(&path("block.mcap"), topic, height_of).unwrap();
    assert_eq!(heights.len(), transforms);
    assert!(heights.iter().all(|z| (z - height).abs() < 1e-12));
    // In a namespace, with the block of that rig's driver and another topic.
    let there = parameters.replace("climber_driver:", "/rig2/climber_driver:");
    fs::write(&both, format!("{RIG_YAML}\n{there}")).unwrap();
    let output = replay(&path("joints.mcap"), &path("there.mcap"), &both, &["--namespace", "rig2"]);
    assert!(!output.status.success(), "the topics are not in that namespace");
    let remaps: Vec<String> =
        [topics::MARKERS, topics::CAMERA_INFO, topics::IMU, topics::JOINT_STATES]
            .iter()
            .flat_map(|topic| ["--remap".to_owned(), format!("{topic}:=/{topic}")])
            .collect();
    let mut words = vec!["--namespace", "rig2"];
    words.extend(remaps.iter().map(String::as_str));
    done("joints.mcap", "there.mcap", &both, &words);
}

/// `volant check` reads encoders through the driver, too, and names a wrong sign in its parameters.
#[test]
fn a_check_names_a_reversed_joint_of_the_parameter_file() {
    let place = Place::new(14.0);
    let path = |name: &str| place.path(name);
    let right = PARAMETERS.replace("HEIGHT", &format!("{:?}", config().height));
    let measured = "/pose_fusion: {ros__parameters: {calibration.marker_sigma: 0.0005}}\n";
    for (text, status, said) in [
        (right.clone(), 0, "assumes markers within 0.04 mm of their places"),
        (format!("{right}{measured}"), 0, "nothing is wrong"),
        (right.replace("rail_y: -0.5", "rail_y: 0.5"), 1, "`rail_y` is reversed"),
    ] {
        fs::write(path("climber.yaml"), &text).unwrap();
        let output = Command::new(executables().join("volant"))
            .arg("check")
            .arg(path("joints.mcap"))
            .args(["--rig".as_ref(), path("rig.yaml").as_os_str()])
            .args(["--params-file".as_ref(), path("climber.yaml").as_os_str()])
            .output()
            .unwrap();
        let printed = String::from_utf8_lossy(&output.stdout);
        assert_eq!(output.status.code(), Some(status), "{printed}{output:?}");
        assert!(printed.contains(said), "{printed}");
        assert_ne!(text.contains("marker_sigma"), printed.contains("marker_sigma"), "{printed}");
    }
}

/// Scales the quaternion.
fn scale(message: &mut TransformStamped, factor: f64) {
    let q = &mut message.transform.rotation;
    for value in [&mut q.x, &mut q.y, &mut q.z, &mut q.w] {
        *value *= factor;
    }
}

/// `volant check` and `volant replay` name why a climber transform is rejected.
#[test]
fn rejected_transforms_are_named_by_check_and_replay() {
    let place = Place::new(6.0);
    let (scenario, rig) = (&place.scenario, place.path("rig.yaml"));
    type Change = fn(&mut TransformStamped);
    let wrong: [(&str, Change, &str); 3] = [
        ("parent", |m| m.header.frame_id = "map".into(), "the frames are `map` and `climber`"),
        ("child", |m| m.child_frame_id = "base_link".into(), "the frames are `world` and `base"),
        ("zero", |m| scale(m, 0.0), "a quaternion of length 0 is no"),
    ];
    for (name, change, said) in wrong {
        let bag = place.path(&format!("{name}.mcap"));
        from_sensors(&bag, scenario, topics::absolute::CLIMBER_TRANSFORM, |sample| {
            let mut message = convert::climber_message(sample, &scenario.rig.frames);
            change(&mut message);
            message
        })
        .unwrap();
        let mut check = Command::new(executables().join("volant"));
        check.arg("check").arg(&bag).arg("--rig").arg(&rig);
        let replayed = replay(&bag, &place.path("out.mcap"), &rig, &[]);
        for output in [replayed, check.output().unwrap()] {
            let printed = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(1), "{printed}");
            assert!(printed.contains(said), "{printed}");
            assert!(!printed.contains("no message on"), "{printed}");
        }
    }
}

/// `volant replay` names why no encoder reading was accepted.
#[test]
fn encoder_readings_of_other_joints_are_named_by_replay() {
    let place = Place::new(3.0);
    let path = |name: &str| place.path(name);
    // The joints are not named in the parameters.
    let block = "climber_driver: {ros__parameters: {height: 3.0}}";
    fs::write(path("rig.yaml"), format!("{RIG_YAML}\n{block}\n")).unwrap();
    let output = replay(&path("joints.mcap"), &path("out.mcap"), &path("rig.yaml"), &[]);
    let printed = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{printed}");
    assert!(printed.contains("the joints `long`, `cross`, `yaw`"), "{printed}");
    assert!(printed.contains("joints.rail_x"), "{printed}");
}

/// What a live node with the same files rejects, a replay rejects in the same words.
#[test]
fn a_replay_rejects_what_a_live_node_rejects() {
    let place = Place::new(3.0);
    let [bag, out, rig] = ["joints.mcap", "out.mcap", "rig.yaml"].map(|name| place.path(name));
    for (node, block) in [
        ("pose_fusion", "/pose_fusoin: {ros__parameters: {model: paper}}"),
        ("climber_driver", "/rig/climber_drvier: {ros__parameters: {height: 1.0}}"),
        ("pose_fusion", "pose_fusion: {ros__parameters: {modle: paper}}"),
        ("marker_tracker", "marker_tracker: {ros__parameters: {max_predicted: six}}"),
        (
            "climber_driver",
            "climber_driver: {ros__parameters: {height: 3}}\n/**/climber_driver: \
                            {ros__parameters: {joints: {rail_x: a, rail_y: a}}}",
        ),
        ("imu_driver", "imu_driver: {ros__parameters: {ports: x}}"),
        ("marker_tracker", "/**: {ros__parameters: {heigth: 3.0}}"),
    ] {
        // The first block of all nodes is the rig's.
        let text = match block.strip_prefix("/**: {ros__parameters: {") {
            Some(more) => {
                let line = format!("ros__parameters:\n    {}", more.trim_end_matches('}'));
                RIG_YAML.replacen("ros__parameters:", &line, 1)
            }
            None => format!("{RIG_YAML}\n{block}\n"),
        };
        fs::write(&rig, text).unwrap();
        let replayed = replay(&bag, &out, &rig, &[]);
        let live = Command::new(executables().join(node))
            .args(["--ros-args", "--params-file", rig.to_str().unwrap()])
            .env("ROS_DOMAIN_ID", "77")
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            .output()
            .unwrap();
        let live = String::from_utf8_lossy(&live.stderr).into_owned();
        let reason = live.lines().last().unwrap().strip_prefix(&format!("{node}: ")).unwrap();
        let reason = reason.split(" (`").next().unwrap();
        let printed = String::from_utf8_lossy(&replayed.stderr);
        assert_eq!(replayed.status.code(), Some(1), "{block}: {printed}");
        assert!(printed.contains(reason), "{block}: live: {reason}; replay: {printed}");
        assert!(!out.exists());
    }
}
