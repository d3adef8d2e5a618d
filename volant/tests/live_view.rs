//! `volant monitor`, and Foxglove's protocol with an independent client.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, clippy::disallowed_methods)]

mod place;

use bag::{BagReader, BagWriter, Qos, WriteOptions};
use place::{Ran, live, put, start};
use rig_model::topics;
use std::{path::Path, process::Command, time::Duration};
use tempfile::TempDir;
use volant_msgs::{
    builtin_interfaces::msg::Time,
    cdr,
    geometry_msgs::msg::TransformStamped,
    msg::{MarkerObservation, MarkerObservations},
    nav_msgs::msg::Odometry,
    sensor_msgs::msg::{Image, JointState},
};

const START: u64 = 1_760_000_000_000_000_000;

fn stamp(nanos: u64) -> Time {
    Time { sec: (nanos / 1_000_000_000) as i32, nanosec: (nanos % 1_000_000_000) as u32 }
}

/// Writes three seconds of a rig: raw images, markers, encoders with `rail_x`, odometry at 100 Hz.
fn bag(path: &Path, rail_x: f64) {
    let mut bag = BagWriter::create(path, WriteOptions::default()).unwrap();
    for i in 0..300u64 {
        let time = START + i * 10_000_000;
        let mut pose = Odometry::default();
        pose.pose.pose.position.z = -1.25;
        pose.pose.pose.orientation.w = 1.0;
        pose.pose.covariance[14] = 1e-6;
        put(&mut bag, topics::absolute::ODOMETRY, &Qos::RELIABLE, time, &pose);
        let mut encoders = JointState {
            name: ["rail_x", "rail_y", "turn"].map(str::to_owned).to_vec(),
            position: vec![rail_x, 0.5, 0.1],
            ..JointState::default()
        };
        encoders.header.stamp = stamp(time);
        put(&mut bag, topics::absolute::JOINT_STATES, &Qos::RELIABLE, time, &encoders);
        if i % 10 == 0 {
            let frame = Image {
                width: 64,
                height: 48,
                step: 192,
                encoding: "rgb8".into(),
                data: vec![(i / 10) as u8; 64 * 48 * 3],
                ..Image::default()
            };
            put(&mut bag, topics::absolute::IMAGE, &Qos::SENSOR, time, &frame);
            let marker = |color, state| MarkerObservation {
                color,
                state,
                x: 100.0 + 50.0 * f64::from(color),
                y: 200.0,
                ..MarkerObservation::default()
            };
            let markers = (0..4).map(|c| marker(c, if c == 3 { 1 } else { 0 })).collect();
            let seen = MarkerObservations { markers, ..MarkerObservations::default() };
            put(&mut bag, topics::absolute::MARKERS, &Qos::RELIABLE, time, &seen);
        }
    }
    bag.finish().unwrap();
}

const RIG: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../launch_config/config/rig.yaml");

#[test]
fn the_monitor_shows_poses_markers_rates_losses_and_missing_nodes() {
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("run.mcap");
    bag(&path, 1.0);
    // A parameter of one node may be given to all.
    let nodes = format!("up pose_fusion climber_driver --rig {RIG} --ros-args -p model:=tight");
    let _nodes = start(81, &nodes);
    let _player = start(81, &format!("play --loop {}", path.display()));
    let run = |domain, arguments| Ran::from(live(domain, arguments).output().unwrap());
    let Ran { status, out: printed, err } = run(81, "monitor --once --interval 6");
    assert_eq!(status, Some(0), "{printed}{err}");
    for needle in [
        "rig /\n",
        "z  -1.2500 ±1.00 mm",
        "red     DETECTED  ( 100.00,  200.00) px",
        "yellow  PREDICTED ( 250.00,  200.00) px",
        "camera  nothing yet",
        "not subscribed",
        "WARN  /pose_fusion: inputs: no messages on ",
        "/pose_fusion ← /climber/markers",
        "status  INITIALIZING, NOT VALID  ",
    ] {
        assert!(printed.contains(needle), "{needle} in\n{printed}");
    }
    for service in ["/pose_fusion/reset", "rosbag2_player/", "← lifecycle", "← parameters"] {
        assert!(!printed.contains(service), "{service} in\n{printed}");
    }
    let latched = printed.lines().find(|l| l.trim_start().starts_with("/tf_static ")).unwrap();
    assert!(latched.contains(" latched ") && !latched.contains("Hz"), "{latched}");
    let odometry =
        printed.lines().find(|l| l.trim_start().starts_with(topics::absolute::ODOMETRY)).unwrap();
    let rate: f64 = odometry.split_whitespace().nth(1).unwrap().parse().unwrap();
    assert!((70.0..115.0).contains(&rate) && odometry.contains("0 lost"), "{odometry}");

    // Another namespace has no topics.
    let other = run(81, "monitor --once --interval 3 -n /other");
    assert_eq!((other.status, other.out.as_str()), (Some(1), ""), "{}", other.err);
    assert!(other.err.contains("in the namespace /other: check that"), "{}", other.err);
    // Another domain has no topics, which is an error.
    let Ran { status, err, .. } = run(82, "monitor --once --interval 1");
    assert_eq!(status, Some(1));
    let nothing = "nothing is published in DDS domain 82 on ";
    assert!(err.contains(nothing) && err.contains("ROS_DOMAIN_ID"), "{err}");
    // Without `--once` it waits, and says so.
    let waiting = start(82, "monitor --plain --interval 1");
    waiting.line_with(nothing, Duration::from_secs(10));
}

#[test]
fn a_foxglove_client_receives_topics_with_their_schemas() {
    let Some(python) = test_support::python("websockets") else { return };
    let dir = TempDir::new().unwrap();
    let path = dir.path().join("run.mcap");
    bag(&path, 1.0);
    let nodes = start(83, &format!("up climber_driver --rig {RIG} --foxglove=127.0.0.1:0"));
    let line = nodes.line_with("ws://", Duration::from_secs(20));
    let url = format!("ws://{}", line.split_once("ws://").unwrap().1);
    let _player = start(83, &format!("play --loop {}", path.display()));
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foxglove_client.py");
    let client = |protocol: &str, topics: &[&str]| {
        let output = Command::new(&python)
            .arg(&script)
            .args([&url, protocol, "7"])
            .args(topics)
            .output()
            .unwrap();
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{text}{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_str::<serde_json::Value>(&text).unwrap()
    };
    let all = [
        topics::absolute::IMAGE,
        topics::absolute::ODOMETRY,
        topics::absolute::TF_STATIC,
        topics::absolute::DIAGNOSTICS,
    ];
    let got = client("foxglove.websocket.v1", &all);
    assert_eq!(got["op"], "serverInfo");
    assert_eq!(got["protocol"], "foxglove.websocket.v1");
    assert!(got["warnings"][0].as_str().unwrap().contains("not understood"), "{got}");
    for (topic, schema) in [
        (topics::absolute::ODOMETRY, "nav_msgs/msg/Odometry"),
        (topics::absolute::MARKERS, "volant_msgs/msg/MarkerObservations"),
        (topics::absolute::IMAGE, "sensor_msgs/msg/Image"),
        (topics::absolute::TF_STATIC, "tf2_msgs/msg/TFMessage"),
    ] {
        assert_eq!(got["advertised"][topic], schema, "{got}");
    }
    let count = |topic: &str| got["counts"][topic].as_u64().unwrap_or(0);
    assert!(
        count(topics::absolute::ODOMETRY) > 200 && count(topics::absolute::IMAGE) > 20,
        "{got}"
    );
    assert_eq!(got["image"][0], 64);
    assert_eq!(got["image"][2], "rgb8");
    assert_eq!(got["image"][3], 64 * 48 * 3);
    assert_eq!(got["z"], -1.25);
    assert_eq!(got["tf_static"][0][0], "climber");
    // The player is a node, too.
    let node = got["diagnostics"].as_str().unwrap();
    assert!(
        ["climber_driver", "rosbag2_player"].iter().any(|name| node.starts_with(name)),
        "{node}"
    );
    assert!(got["counts"].get(topics::absolute::MARKERS).is_none(), "not subscribed: {got}");
    // A late client gets latched messages, too.
    let late = client("foxglove.sdk.v1", &[topics::absolute::TF_STATIC]);
    assert_eq!(
        (&late["protocol"], &late["counts"][topics::absolute::TF_STATIC]),
        (&"foxglove.sdk.v1".into(), &1.into())
    );
    // A client without a supported protocol is rejected with a message.
    let output =
        Command::new(&python).arg(&script).args([&url, "something.else", "1"]).output().unwrap();
    assert!(!output.status.success());
}

#[test]
fn two_rigs_in_one_domain_are_separate() {
    let dir = TempDir::new().unwrap();
    let mut running = vec![];
    for (rig, rail_x) in [("rig1", 1.0), ("rig2", 2.0)] {
        let path = dir.path().join(format!("{rig}.mcap"));
        bag(&path, rail_x);
        // The bag's stamps are in the past: each rig has its own clock.
        let nodes = format!(
            "up climber_driver --rig {RIG} --ros-args -r __ns:=/{rig} -r /tf:=tf \
             -r /tf_static:=tf_static -r /clock:=clock -p use_sim_time:=true"
        );
        running.push(start(84, &nodes));
        let player = format!(
            "play --delay 3 --clock 100 {} --topics {} --remap \
             climber/joint_states:=/{rig}/climber/joint_states --remap /clock:=/{rig}/clock",
            path.display(),
            topics::absolute::JOINT_STATES,
        );
        running.push(start(84, &player));
    }
    let copy = dir.path().join("copy.mcap");
    let record = format!("record --duration 7 -o {}", copy.display());
    let output = live(84, &record).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let mut bag = BagReader::open(&copy).unwrap();
    let mut counts = [0; 2];
    let mut frames = [0; 2];
    while let Some(message) = bag.next_message().unwrap() {
        let name = &*message.topic.name;
        assert!(
            name != topics::absolute::TF
                && name != topics::absolute::TF_STATIC
                && name != topics::absolute::CLIMBER_TRANSFORM,
            "{name}"
        );
        for (i, x) in [1.0, 2.0].into_iter().enumerate() {
            if name == format!("/rig{}/climber/transform", i + 1) {
                let transform: TransformStamped = cdr::from_bytes(&message.data).unwrap();
                assert_eq!(transform.transform.translation.x, x, "{name}");
                counts[i] += 1;
            }
            frames[i] += u32::from(name == format!("/rig{}/tf", i + 1));
        }
    }
    assert!(
        counts.iter().all(|n| *n > 100) && frames.iter().all(|n| *n > 100),
        "{counts:?} {frames:?}"
    );
}
