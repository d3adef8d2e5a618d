//! The real node as a process of its own, fed over DDS and called by a Cyclone DDS client.

#![allow(clippy::disallowed_methods, reason = "a live test waits")]
use super::*;
use node_kit::{
    convert,
    environment::Network,
    node::{NodeContext, NodeError, Process, Publisher},
    qos::QosPreset,
};
use rig_model::Stamp;
use serde_json::Value;
use std::{
    ffi::OsStr,
    path::Path,
    process::{Command, Stdio},
    sync::{Arc, Mutex, mpsc::sync_channel},
    thread::sleep,
    time::{Duration, Instant},
};
use test_support::process::{Running, in_domain, wait_until};
use volant_msgs::{
    Message,
    geometry_msgs::msg::{PoseWithCovarianceStamped, TransformStamped},
    msg::{MarkerObservations, MarkerUpdate, MarkerUpdates, PoseStatus},
    nav_msgs::msg::Odometry,
    sensor_msgs::msg::{CameraInfo, Imu},
};

const RIG: &str = rig_simulator::RIG_YAML;

#[derive(Clone)]
struct RigPublishers {
    imu: Publisher<Imu>,
    climber: Publisher<TransformStamped>,
    markers: Publisher<MarkerObservations>,
    camera: Publisher<CameraInfo>,
    pose: Publisher<PoseWithCovarianceStamped>,
}

/// What the node has published.
#[derive(Default)]
struct Received {
    odometry: Mutex<Vec<Arc<Odometry>>>,
    status: Mutex<Vec<Arc<PoseStatus>>>,
    updates: Mutex<Vec<Arc<MarkerUpdates>>>,
}

/// Subscribes to a topic whose messages are kept.
fn keep<M: Message>(
    context: &mut NodeContext<()>,
    topic: &str,
    received: &Arc<Received>,
    list: fn(&Received) -> &Mutex<Vec<Arc<M>>>,
) -> Result<(), NodeError> {
    let received = Arc::clone(received);
    context.subscribe(topic, QosPreset::State, move |m: Arc<M>| -> Option<()> {
        list(&received).lock().unwrap().push(m);
        None
    })
}

/// The rest of the rig, in a DDS domain of its own.
struct Rig {
    publishers: RigPublishers,
    received: Arc<Received>,
    _process: Process,
}

impl Rig {
    fn start(domain_id: u16) -> Self {
        let received = Arc::<Received>::default();
        let (kept, (sender, publishers)) = (Arc::clone(&received), sync_channel(1));
        let mut process = Process::new(Network { domain_id, ..Network::default() }).unwrap();
        let started = process.start_closure("others", move |context: &mut NodeContext<()>| {
            keep(context, topics::ODOMETRY, &kept, |received| &received.odometry)?;
            keep(context, topics::MARKER_UPDATES, &kept, |received| &received.updates)?;
            keep(context, topics::STATUS, &kept, |received| &received.status)?;
            let publishers = RigPublishers {
                imu: context.advertise(topics::IMU, QosPreset::Sensor)?,
                climber: context.advertise(topics::CLIMBER_TRANSFORM, QosPreset::State)?,
                markers: context.advertise(topics::MARKERS, QosPreset::State)?,
                camera: context.advertise(topics::CAMERA_INFO, QosPreset::CameraInfo)?,
                pose: context.advertise(topics::SET_POSE, QosPreset::State)?,
            };
            sender.send(publishers).unwrap();
            Ok(|_: &mut NodeContext<()>, ()| ())
        });
        started.unwrap();
        Self { publishers: publishers.recv().unwrap(), received, _process: process }
    }

    /// At least `seconds` of new odometry: stamps, errors in m, variances of the velocity.
    fn after(&self, seconds: f64, run: &simulated::Run) -> Vec<(Stamp, f64, f64)> {
        let odometry = || self.received.odometry.lock().unwrap();
        let newest = || odometry().last().map(|m| convert::stamp(&m.header.stamp));
        assert!(wait_until(Duration::from_secs(20), || newest().is_some()), "no odometry came");
        let from = newest().unwrap();
        let later = || newest().is_some_and(|stamp| stamp.seconds_since(from) >= seconds);
        assert!(wait_until(Duration::from_secs(30), later), "odometry has ended");
        let received = odometry();
        let since = received.iter().filter(|m| convert::stamp(&m.header.stamp) > from);
        since
            .map(|m| {
                let stamp = convert::stamp(&m.header.stamp);
                let pose = convert::pose(&m.pose.pose, "odometry").unwrap();
                let truth = run.pose_at(stamp).unwrap();
                (stamp, PoseError::new(&pose, &truth).position.norm(), m.twist.covariance[0])
            })
            .collect()
    }
}

fn feed(publishers: &RigPublishers, run: &simulated::Run, epoch: Stamp) {
    let frames = simulated::rig().frames;
    let begin = Instant::now();
    for (k, (at, input)) in run.inputs.iter().enumerate() {
        let due = Duration::from_secs_f64(at.seconds_since(epoch).max(0.0));
        sleep(due.saturating_sub(begin.elapsed()));
        // A camera repeats it with every image; the first may precede the discovery.
        if k % 100 == 0 {
            publishers.camera.publish(convert::camera_message(
                &frames.camera,
                *at,
                &simulated::camera(),
            ));
        }
        match input {
            Input::Imu(s) => {
                publishers.imu.publish(convert::imu_message(&frames.imu, s, None, None))
            }
            Input::Markers(m) => {
                publishers.markers.publish(convert::markers_message(&frames.camera, m))
            }
            Input::Climber(s) => publishers.climber.publish(convert::climber_message(s, &frames)),
            Input::Camera(_) => {}
        }
    }
}

/// A program in a domain; the client uses more than the loopback.
fn on_all_interfaces(domain: u16, program: impl AsRef<OsStr>) -> Command {
    let mut command = in_domain(domain, program);
    command.env_remove("ROS_AUTOMATIC_DISCOVERY_RANGE");
    command
}

struct Caller(Running);

impl Caller {
    fn start(domain: u16, python: &Path) -> Self {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/operator/caller.py");
        Self(Running::start(on_all_interfaces(domain, python).arg(script).stdin(Stdio::piped())))
    }

    fn reply(&mut self) -> Value {
        serde_json::from_str(&self.0.line_with("{", Duration::from_secs(60))).unwrap()
    }

    fn call(&mut self, line: &str) -> (bool, String) {
        self.0.write_line(line);
        let reply = self.reply();
        (reply["success"] == true, reply["message"].as_str().unwrap().to_owned())
    }
}

#[test]
fn the_operator_s_services_and_topic_work_over_dds() {
    const DOMAIN: u16 = 85;
    let Some(python) = test_support::python("cyclonedds") else { return };
    let sensors = SensorConfig::nominal(1);
    let motion = MotionConfig { duration: 40.0, ..MotionConfig::nominal(1) };
    let run = Arc::new(simulated::run(motion, &sensors));
    let folder = std::env::temp_dir().join(format!("volant-operator-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let (rig, kept) = (folder.join("rig.yaml"), folder.join("kept.json"));
    std::fs::write(&rig, RIG).unwrap();
    let others = Rig::start(DOMAIN);
    let _node = Running::start(
        on_all_interfaces(DOMAIN, env!("CARGO_BIN_EXE_pose_fusion"))
            .args(["--ros-args", "--params-file", rig.to_str().unwrap()])
            .args(["-p", &format!("checkpoint_file:={}", kept.display())])
            .env("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp"),
    );
    let mut caller = Caller::start(DOMAIN, &python);
    assert_eq!(caller.reply()["ready"], true);
    let (ok, why) = caller.call("save_checkpoint 0");
    assert!(!ok && why.contains("not initialized"), "{why}");
    let (feeding, publishers) = (run.clone(), others.publishers.clone());
    let _feeder = std::thread::spawn(move || feed(&publishers, &feeding, sensors.epoch));

    let last = |outputs: &[(Stamp, f64, f64)]| *outputs.last().unwrap();
    let (_, error, velocity) = last(&others.after(4.0, &run));
    assert!(error < 3e-3, "{error} m");
    let (ok, why) = caller.call("load_checkpoint 0");
    assert!(!ok && why.contains("cannot be read"), "{why}");
    let (ok, message) = caller.call("save_checkpoint 0");
    assert!(ok && message.contains("kept.json"), "{message}");
    let checkpoint: pose_fusion::Checkpoint =
        serde_json::from_str(&std::fs::read_to_string(&kept).unwrap()).unwrap();
    let saved = run.pose_at(Stamp::from_nanos(checkpoint.stamp_ns)).unwrap();
    assert!((nalgebra::Vector3::from(checkpoint.position) - saved.translation.vector).norm() < 0.1);

    // While frozen, a pose that was set does not change with the markers.
    let (ok, why) = caller.call("freeze 1");
    assert!(ok, "{why}");
    let (stamp, _, _) = last(&others.after(0.1, &run));
    let mut wrong = run.pose_at(stamp).unwrap();
    wrong.translation.vector.x += 0.5;
    let covariance = Matrix6::identity() * 1e-6;
    let message =
        |frame: &str| convert::pose_with_covariance_message(frame, stamp, &wrong, &covariance);
    others.publishers.pose.publish(message("another_frame"));
    let (_, error, _) = last(&others.after(0.2, &run));
    assert!(error < 0.02, "a pose in another frame is rejected: {error} m");
    others.publishers.pose.publish(message("world"));
    let (_, error, _) = last(&others.after(0.3, &run));
    assert!((0.3..0.8).contains(&error), "{error} m");
    let outcome = others.received.updates.lock().unwrap().last().unwrap().markers[0].outcome;
    assert!([MarkerUpdate::FROZEN, MarkerUpdate::GATED].contains(&outcome), "{outcome}");
    // Freed, it finds back.
    let (ok, why) = caller.call("freeze 0");
    assert!(ok, "{why}");
    let (_, error, _) = last(&others.after(2.0, &run));
    assert!(error < 0.01, "{error} m");

    let (ok, message) = caller.call("reset 0");
    assert!(ok && message.contains("initializes"), "{message}");
    let outputs = others.after(2.0, &run);
    let widest = outputs.iter().map(|s| s.2).fold(0.0, f64::max);
    assert!(widest > 100.0 * velocity, "after a reset nothing is known of the speed: {widest}");
    let (_, error, _) = last(&outputs);
    assert!(error < 0.01, "{error} m");

    let (ok, message) = caller.call("load_checkpoint 0");
    assert!(ok && message.contains("restored from"), "{message}");
    let (_, error, _) = last(&others.after(1.0, &run));
    assert!(error < 0.01, "{error} m");
    let _ = std::fs::remove_dir_all(&folder);
}

/// A controller that reads `volant/status` must see that the pose is old, whatever has ended. The
/// rig file of this run names the IMU's frame otherwise than its samples do.
#[test]
fn the_status_is_lost_once_all_inputs_have_ended_and_another_imu_frame_is_named() {
    const DOMAIN: u16 = 86;
    let sensors = SensorConfig::nominal(1);
    let motion = MotionConfig { duration: 5.0, ..MotionConfig::nominal(1) };
    let run = simulated::run(motion, &sensors);
    let folder = tempfile::tempdir().unwrap();
    let rig = folder.path().join("rig.yaml");
    std::fs::write(&rig, RIG.replace("imu: imu", "imu: imu_link")).unwrap();
    let others = Rig::start(DOMAIN);
    let node = Running::start(on_all_interfaces(DOMAIN, env!("CARGO_BIN_EXE_pose_fusion")).args([
        "--ros-args",
        "--params-file",
        rig.to_str().unwrap(),
    ]));
    let status = || others.received.status.lock().unwrap();
    let reports = wait_until(Duration::from_secs(20), || !status().is_empty());
    assert!(reports, "the node does not report that it waits");
    feed(&others.publishers, &run, sensors.epoch);
    assert!(status().iter().any(|s| s.valid), "the pose was never valid");
    let named = ["is in the frame `imu`", "frames.imu of the rig file is `imu_link`"];
    node.line_with_all(&named, Duration::from_secs(5));
    sleep(Duration::from_millis(700));
    status().clear();
    sleep(Duration::from_secs(2));
    let since = status();
    assert!((12..=24).contains(&since.len()), "{} status messages in two seconds", since.len());
    assert!(since.iter().all(|s| s.state == PoseStatus::LOST && !s.valid), "{since:?}");
    assert!(since.iter().all(|s| s.reason.contains("no input for")), "{since:?}");
}
