//! Replay of encoder readings through the climber driver, with the parameters of the nodes' files.
#![allow(missing_docs, clippy::unwrap_used)]

use bag::recording::map_messages;
use climber_driver::{Climber, ClimberConfig, Output};
use node_kit::convert;
use rig_model::{ClimberSample, topics};
use rig_simulator::{RIG_YAML, motion::MotionConfig};
use test_support::{
    place::{Place, Ran},
    process::in_domain,
};
use volant_msgs::{geometry_msgs::msg::TransformStamped, sensor_msgs::msg::JointState};
use volant_test::live::{Scenario, bag::from_sensors, processes::executables};

const REPLAY: &str = "replay joints.mcap --rig rig.yaml --out out.mcap";

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
fn recorded(seconds: f64) -> (Place, Scenario) {
    let (place, scenario) = (Place::with_rig(RIG_YAML), Scenario::swing(7, seconds).unwrap());
    let topic = topics::absolute::JOINT_STATES;
    from_sensors(&place.path("joints.mcap"), &scenario, topic, joints).unwrap();
    (place, scenario)
}

#[test]
fn encoder_readings_give_the_pose_of_the_drivers_transforms() {
    let (place, scenario) = recorded(5.0);
    // The driver's core over the same readings, received when they were logged.
    let mut driver = Climber::new(config()).unwrap();
    let mut transforms = 0;
    let topic = topics::absolute::CLIMBER_TRANSFORM;
    from_sensors(&place.path("transforms.mcap"), &scenario, topic, |sample| {
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
    place.write("climber.yaml", &parameters);
    place.write("both.yaml", format!("{RIG_YAML}\n{parameters}"));
    let replayed = |bag: &str, rig: &str, more: &str| {
        place.done(&format!("replay {bag} --rig {rig} --out out.mcap --overwrite {more}"));
        place.read("out.mcap")
    };
    let usual = replayed("transforms.mcap", "rig.yaml", "");
    assert!(replayed("joints.mcap", "rig.yaml", "--params-file climber.yaml") == usual);
    assert!(replayed("joints.mcap", "both.yaml", "") == usual);
    let height_of = |_, m: TransformStamped| m.transform.translation.z;
    let heights = map_messages(&place.path("out.mcap"), topic, height_of).unwrap();
    assert_eq!(heights.len(), transforms);
    assert!(heights.iter().all(|z| (z - height).abs() < 1e-12));
    // In a namespace, with the block of that rig's driver and other topics.
    let there = parameters.replace("climber_driver:", "/rig2/climber_driver:");
    place.write("both.yaml", format!("{RIG_YAML}\n{there}"));
    let in_rig2 = "replay joints.mcap --rig both.yaml --out there.mcap --namespace rig2";
    // The topics are not in that namespace.
    place.failed(in_rig2);
    let remaps = [topics::MARKERS, topics::CAMERA_INFO, topics::IMU, topics::JOINT_STATES]
        .map(|topic| format!(" --remap {topic}:=/{topic}"));
    place.done(&format!("{in_rig2}{}", remaps.concat()));
}

/// `volant check` reads encoders through the driver, too, and names a wrong sign in its parameters.
#[test]
fn a_check_names_a_reversed_joint_of_the_parameter_file() {
    let (place, _) = recorded(14.0);
    let right = PARAMETERS.replace("HEIGHT", &format!("{:?}", config().height));
    let measured = "/pose_fusion: {ros__parameters: {calibration.marker_sigma: 0.0005}}\n";
    for (text, status, said) in [
        (right.clone(), 0, "assumes markers within 0.04 mm of their places"),
        (format!("{right}{measured}"), 0, "nothing is wrong"),
        (right.replace("rail_y: -0.5", "rail_y: 0.5"), 1, "`rail_y` is reversed"),
    ] {
        place.write("climber.yaml", &text);
        let ran = place.volant("check joints.mcap --rig rig.yaml --params-file climber.yaml");
        let printed = ran.out;
        assert_eq!(ran.status, Some(status), "{printed}{}", ran.err);
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
    let (place, scenario) = recorded(6.0);
    type Change = fn(&mut TransformStamped);
    let wrong: [(Change, &str); 3] = [
        (|m| m.header.frame_id = "map".into(), "the frames are `map` and `climber`"),
        (|m| m.child_frame_id = "base_link".into(), "the frames are `world` and `base"),
        (|m| scale(m, 0.0), "a quaternion of length 0 is no"),
    ];
    for (change, said) in wrong {
        let topic = topics::absolute::CLIMBER_TRANSFORM;
        from_sensors(&place.path("wrong.mcap"), &scenario, topic, |sample| {
            let mut message = convert::climber_message(sample, &scenario.rig.frames);
            change(&mut message);
            message
        })
        .unwrap();
        for command in
            ["replay wrong.mcap --rig rig.yaml --out out.mcap", "check wrong.mcap --rig rig.yaml"]
        {
            let printed = place.failed(command);
            assert!(printed.contains(said), "{printed}");
            assert!(!printed.contains("no message on"), "{printed}");
        }
    }
}

/// `volant replay` names why no encoder reading was accepted.
#[test]
fn encoder_readings_of_other_joints_are_named_by_replay() {
    let (place, _) = recorded(3.0);
    // The joints are not named in the parameters.
    let block = "climber_driver: {ros__parameters: {height: 3.0}}";
    place.write("rig.yaml", format!("{RIG_YAML}\n{block}\n"));
    let printed = place.failed(REPLAY);
    assert!(printed.contains("the joints `long`, `cross`, `yaw`"), "{printed}");
    assert!(printed.contains("joints.rail_x"), "{printed}");
}

/// What a live node with the same files rejects, a replay rejects in the same words.
#[test]
fn a_replay_rejects_what_a_live_node_rejects() {
    let (place, _) = recorded(3.0);
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
        place.write("rig.yaml", text);
        let printed = place.failed(REPLAY);
        let mut node_alone = in_domain(77, executables().join(node));
        node_alone.args(["--ros-args", "--params-file", "rig.yaml"]).current_dir(place.folder());
        let live = Ran::from(node_alone.output().unwrap()).err;
        let reason = live.lines().last().unwrap().strip_prefix(&format!("{node}: ")).unwrap();
        let reason = reason.split(" (`").next().unwrap();
        assert!(printed.contains(reason), "{block}: live: {reason}; replay: {printed}");
        assert!(!place.path("out.mcap").exists());
    }
}
