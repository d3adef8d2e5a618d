//! What an operator does: set the pose, freeze, reset, keep what is known and take it up again.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::panic)] // test code, outside of #[test]
mod common;

use common::{
    rig::{inertial::SensorConfig, motion::MotionConfig},
    scoring, simulated,
};
use nalgebra::Matrix6;
use pose_fusion::{Fusion, FusionConfig, Input, PoseEstimate, Refusal};
use rig_model::MarkerColor;

fn fusion() -> Fusion {
    Fusion::new(simulated::rig(), FusionConfig::default())
}

/// The run, cut at `cut` seconds of arrival.
fn cut(run: &simulated::Run, sensors: &SensorConfig, cut: f64) -> (Vec<Input>, Vec<Input>) {
    let (before, after): (Vec<_>, Vec<_>) =
        run.inputs.iter().cloned().partition(|(at, _)| at.seconds_since(sensors.epoch) < cut);
    (before.into_iter().map(|(_, i)| i).collect(), after.into_iter().map(|(_, i)| i).collect())
}

#[test]
fn a_checkpoint_goes_on_where_it_was_taken() {
    let sensors = SensorConfig::nominal(1);
    let run = simulated::run(MotionConfig::nominal(1), &sensors);
    let (before, after) = cut(&run, &sensors, 8.0);
    let mut first = fusion();
    assert_eq!(first.checkpoint(), Err(Refusal::NotInitialized));
    scoring::run(&mut first, before);
    let checkpoint = first.checkpoint().unwrap();
    let mut second = fusion();
    second.handle(Input::Camera(simulated::camera()));
    second.restore(&checkpoint).unwrap();
    let said = scoring::run(&mut second, after.clone());
    let expected = scoring::run(&mut first, after);
    // From the very next sample on, and within what the first image of a fresh start would not know.
    assert!(said.odometry[0].stamp.seconds_since(expected.odometry[0].stamp).abs() < 0.02);
    let score = scoring::score(&said.odometry, &run.truth, 0.0);
    let reference = scoring::score(&expected.odometry, &run.truth, 8.0);
    println!("restored {score}\nwent on  {reference}");
    assert!(score.position_rmse() < 1.1 * reference.position_rmse() + 0.05, "{score}");
    assert!(!second.status().time_offset.searching);
    assert!((second.status().biases[0] - first.status().biases[0]).norm() < 0.01);
}

#[test]
fn an_old_checkpoint_gives_clocks_and_biases() {
    let sensors =
        SensorConfig { camera_clock_ahead: 0.06, climber_clock_ahead: 0.06, ..SensorConfig::nominal(2) };
    let run = simulated::run(MotionConfig::nominal(2), &sensors);
    let all: Vec<Input> = run.inputs.iter().map(|(_, i)| i.clone()).collect();
    let mut first = fusion();
    scoring::run(&mut first, all.clone());
    let checkpoint = first.checkpoint().unwrap();
    let mut second = fusion();
    second.restore(&checkpoint).unwrap();
    let said = scoring::run(&mut second, all);
    // Without it the first seconds search for the clock.
    let early = |o: &[pose_fusion::Odometry]| {
        let until = sensors.epoch.plus_seconds(3.0);
        let first: Vec<_> = o.iter().filter(|o| o.stamp < until).cloned().collect();
        scoring::score(&first, &run.truth, 0.3)
    };
    let score = early(&said.odometry);
    println!("{score}");
    assert!(score.position_rmse() < 1.5, "{score}");
    assert!((second.status().time_offset.offset + 0.06).abs() < 1e-3);
}

#[test]
fn a_checkpoint_that_cannot_be_is_refused() {
    let sensors = SensorConfig::nominal(1);
    let run = simulated::run(MotionConfig { duration: 3.0, ..MotionConfig::nominal(1) }, &sensors);
    let mut first = fusion();
    scoring::run(&mut first, run.inputs.iter().map(|(_, i)| i.clone()));
    let good = first.checkpoint().unwrap();
    assert!(first.restore(&good).is_ok());
    type Spoil = fn(&mut pose_fusion::Checkpoint);
    let spoils: [Spoil; 6] = [
        |c| c.version = 99,
        |c| c.position[1] = f64::NAN,
        |c| c.attitude = [0.0; 4],
        |c| c.covariance.truncate(100),
        |c| c.covariance[1] += 1.0,
        |c| c.covariance[0] = -1.0,
    ];
    for spoil in spoils {
        let mut bad = good.clone();
        spoil(&mut bad);
        let refusal = first.restore(&bad).unwrap_err();
        println!("{refusal}");
        assert!(matches!(refusal, Refusal::Invalid { .. }));
    }
}

#[test]
fn a_pose_that_is_set_is_taken_and_one_that_cannot_be_is_refused() {
    let sensors = SensorConfig {
        hidden: MarkerColor::ALL.map(|m| (m, 4.0, 20.0)).to_vec(),
        ..SensorConfig::nominal(3)
    };
    let run = simulated::run(MotionConfig::nominal(3), &sensors);
    let (before, after) = cut(&run, &sensors, 9.0);
    let mut fusion = fusion();
    let stamp = sensors.epoch.plus_seconds(8.9);
    let truth = scoring::pose_at(&run.truth, stamp).unwrap();
    let covariance = Matrix6::from_diagonal(&nalgebra::Vector6::new(1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-6));
    let pose = PoseEstimate { stamp, pose: truth, covariance };
    assert!(matches!(fusion.set_pose(&pose), Err(Refusal::Missing { .. })));
    scoring::run(&mut fusion, before);
    let late = PoseEstimate { stamp: stamp.plus_seconds(-5.0), ..pose.clone() };
    assert!(matches!(fusion.set_pose(&late), Err(Refusal::OutOfReach { .. })));
    let vague = PoseEstimate { covariance: Matrix6::zeros(), ..pose.clone() };
    assert!(matches!(fusion.set_pose(&vague), Err(Refusal::Invalid { .. })));
    fusion.set_pose(&pose).unwrap();
    let said = scoring::run(&mut fusion, after);
    let next = &said.odometry[0];
    let age = next.stamp.seconds_since(stamp);
    let (p, r) = scoring::errors(&next.world_from_volant, &scoring::pose_at(&run.truth, next.stamp).unwrap());
    println!("{age:.3} s after it was set: {:.1} mm {:.2} deg", p.norm() * 1e3, r.norm().to_degrees());
    // The velocity is not known: within its three sigmas.
    assert!(p.norm() < 3.0 * 1.5 * age + 5e-3 && r.norm() < 0.02);
    let c = next.pose_covariance;
    assert!(
        (0..3).all(|i| p[i].abs() < 5.0 * c[(i, i)].sqrt() && r[i].abs() < 5.0 * c[(i + 3, i + 3)].sqrt())
    );
}

#[test]
fn frozen_it_compares_and_does_not_use_and_reset_it_starts_anew() {
    let sensors = SensorConfig::nominal(1);
    let run = simulated::run(MotionConfig { duration: 8.0, ..MotionConfig::nominal(1) }, &sensors);
    let (before, after) = cut(&run, &sensors, 5.0);
    let mut fusion = fusion();
    scoring::run(&mut fusion, before);
    fusion.freeze(true);
    let used = fusion.status().counts.used_markers;
    let (while_frozen, rest) = after.split_at(after.len() / 3);
    let said = scoring::run(&mut fusion, while_frozen.to_vec());
    assert_eq!(fusion.status().counts.used_markers, used);
    assert!(
        said.records.iter().any(|r| r.outcome == pose_fusion::MarkerOutcome::Frozen && r.nis.is_finite())
    );
    fusion.freeze(false);
    fusion.reset();
    assert!(!fusion.status().initialized);
    let said = scoring::run(&mut fusion, rest.to_vec());
    let score = scoring::score(&said.odometry, &run.truth, 0.0);
    println!("{score}");
    assert!(fusion.status().initialized && score.position_max < 0.05, "{score}");
}

/// The real node, a process of its own, fed over DDS and asked by a client that is not ours.
mod live {
    #![allow(clippy::disallowed_methods, reason = "a live test waits")]
    use super::*;
    use node_kit::{
        RosArguments, convert,
        environment::Network,
        node::{Kit, NodeError, NodeShell, Process, Publisher},
        qos::QosPreset,
    };
    use rig_model::Stamp;
    use serde_json::Value;
    use std::{
        io::{BufRead, BufReader, Lines, Write},
        path::Path,
        process::{Child, ChildStdout, Command, Stdio},
        sync::{Arc, Mutex, OnceLock},
        thread::sleep,
        time::{Duration, Instant},
    };
    use volant_msgs::{
        geometry_msgs::msg::{PoseWithCovarianceStamped, TransformStamped},
        msg::{MarkerObservations, MarkerUpdate, MarkerUpdates},
        nav_msgs::msg::Odometry,
        sensor_msgs::msg::{CameraInfo, Imu},
    };

    const DOMAIN: u16 = 76;
    const RIG: &str = include_str!("../../test/src/rig/rig.yaml");

    struct Mouth {
        imu: Publisher<Imu>,
        climber: Publisher<TransformStamped>,
        markers: Publisher<MarkerObservations>,
        camera: Publisher<CameraInfo>,
        pose: Publisher<PoseWithCovarianceStamped>,
    }

    static MOUTH: OnceLock<Mouth> = OnceLock::new();
    static HEARD: Mutex<Vec<Arc<Odometry>>> = Mutex::new(Vec::new());
    static UPDATES: Mutex<Vec<Arc<MarkerUpdates>>> = Mutex::new(Vec::new());

    /// The rest of the rig.
    struct Others;

    impl NodeShell for Others {
        const NAME: &'static str = "others";
        type Parameters = ();
        type Input = ();

        fn start(kit: &mut Kit<()>, (): ()) -> Result<Self, NodeError> {
            kit.subscribe("volant/odometry", QosPreset::State, |m: Arc<Odometry>| -> Option<()> {
                HEARD.lock().unwrap().push(m);
                None
            })?;
            kit.subscribe(
                "volant/marker_updates",
                QosPreset::State,
                |m: Arc<MarkerUpdates>| -> Option<()> {
                    UPDATES.lock().unwrap().push(m);
                    None
                },
            )?;
            let mouth = Mouth {
                imu: kit.advertise("volant/imu/data", QosPreset::Sensor)?,
                climber: kit.advertise("climber/transform", QosPreset::State)?,
                markers: kit.advertise("climber/markers", QosPreset::State)?,
                camera: kit.advertise("climber/camera/camera_info", QosPreset::Sensor)?,
                pose: kit.advertise("volant/set_pose", QosPreset::State)?,
            };
            assert!(MOUTH.set(mouth).is_ok());
            Ok(Self)
        }

        fn handle(&mut self, _: &mut Kit<()>, (): ()) {}
    }

    fn feed(run: &simulated::Run, epoch: Stamp) {
        let (frames, mouth) = (simulated::rig().frames, MOUTH.get().unwrap());
        let begin = Instant::now();
        for (k, (at, input)) in run.inputs.iter().enumerate() {
            let due = Duration::from_secs_f64(at.seconds_since(epoch).max(0.0));
            sleep(due.saturating_sub(begin.elapsed()));
            // A camera says it with every image; the first may come before the other side has matched.
            if k % 100 == 0 {
                mouth.camera.publish(convert::camera_message(&frames.camera, *at, &simulated::camera()));
            }
            match input {
                Input::Imu(s) => mouth.imu.publish(convert::imu_message(&frames.imu, s, None, None)),
                Input::Markers(m) => mouth.markers.publish(convert::markers_message(&frames.camera, m)),
                Input::Climber(s) => mouth.climber.publish(convert::climber_message(s, &frames)),
                Input::Camera(_) => {}
            }
        }
    }

    struct Ended(Child);

    impl Drop for Ended {
        fn drop(&mut self) {
            let _ = self.0.kill();
            let _ = self.0.wait();
        }
    }

    struct Caller(Ended, Lines<BufReader<ChildStdout>>);

    impl Caller {
        fn start(python: &std::ffi::OsStr) -> Self {
            let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/operator_peer.py");
            let mut child = Command::new(python)
                .arg(script)
                .env("ROS_DOMAIN_ID", DOMAIN.to_string())
                .stdin(Stdio::piped())
                .stdout(Stdio::piped())
                .spawn()
                .unwrap();
            let lines = BufReader::new(child.stdout.take().unwrap()).lines();
            Self(Ended(child), lines)
        }

        fn reply(&mut self) -> Value {
            serde_json::from_str(&self.1.next().unwrap().unwrap()).unwrap()
        }

        fn call(&mut self, line: &str) -> (bool, String) {
            writeln!(self.0.0.stdin.as_mut().unwrap(), "{line}").unwrap();
            let reply = self.reply();
            println!("{line}: {reply}");
            (reply["success"] == true, reply["message"].as_str().unwrap().to_owned())
        }
    }

    /// Odometry of at least `seconds` after now's newest, with what came since: stamps, errors in m, variances of the velocity.
    fn after(seconds: f64, run: &simulated::Run) -> Vec<(Stamp, f64, f64)> {
        let newest = || HEARD.lock().unwrap().last().map(|m| convert::stamp(&m.header.stamp));
        let begin = Instant::now();
        let from = loop {
            if let Some(stamp) = newest() {
                break stamp;
            }
            assert!(begin.elapsed().as_secs() < 20, "no odometry came");
            sleep(Duration::from_millis(10));
        };
        while newest().is_none_or(|stamp| stamp.seconds_since(from) < seconds) {
            assert!(begin.elapsed().as_secs() < 30, "odometry has ended");
            sleep(Duration::from_millis(10));
        }
        let heard = HEARD.lock().unwrap();
        let since = heard.iter().filter(|m| convert::stamp(&m.header.stamp) > from);
        since
            .map(|m| {
                let stamp = convert::stamp(&m.header.stamp);
                let pose = convert::pose(&m.pose.pose, "odometry").unwrap();
                let (p, _) = scoring::errors(&pose, &scoring::pose_at(&run.truth, stamp).unwrap());
                (stamp, p.norm(), m.twist.covariance[0])
            })
            .collect()
    }

    #[test]
    fn an_operator_s_services_and_topic_do_what_they_say_over_dds() {
        let Some(python) = std::env::var_os("VOLANT_PYTHON").filter(|v| !v.is_empty()) else {
            eprintln!("skipped: VOLANT_PYTHON names no Python with cyclonedds");
            return;
        };
        let sensors = SensorConfig::nominal(1);
        let motion = MotionConfig { duration: 40.0, ..MotionConfig::nominal(1) };
        let run = Arc::new(simulated::run(motion, &sensors));
        let folder = std::env::temp_dir().join(format!("volant-operator-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (rig, kept) = (folder.join("rig.yaml"), folder.join("kept.json"));
        std::fs::write(&rig, RIG).unwrap();
        let network = Network { domain_id: DOMAIN, ..Network::default() };
        let mut others = Process::new(network).unwrap();
        others.start::<Others>(&RosArguments::default()).unwrap();
        let node = Command::new(env!("CARGO_BIN_EXE_pose_fusion"))
            .args(["--ros-args", "--params-file", rig.to_str().unwrap()])
            .args(["-p", &format!("checkpoint_file:={}", kept.display())])
            .env("ROS_DOMAIN_ID", DOMAIN.to_string())
            .env("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")
            .spawn()
            .unwrap();
        let _node = Ended(node);
        let mut caller = Caller::start(&python);
        assert_eq!(caller.reply()["ready"], true);
        let (ok, why) = caller.call("save_checkpoint 0");
        assert!(!ok && why.contains("not initialized"), "{why}");
        let feeding = run.clone();
        let _feeder = std::thread::spawn(move || feed(&feeding, sensors.epoch));

        let last = |said: &[(Stamp, f64, f64)]| *said.last().unwrap();
        let (_, error, velocity) = last(&after(4.0, &run));
        assert!(error < 3e-3, "{error} m");
        let (ok, why) = caller.call("load_checkpoint 0");
        assert!(!ok && why.contains("cannot be read"), "{why}");
        let (ok, message) = caller.call("save_checkpoint 0");
        assert!(ok && message.contains("kept.json"), "{message}");
        let checkpoint: pose_fusion::Checkpoint =
            serde_json::from_str(&std::fs::read_to_string(&kept).unwrap()).unwrap();
        let saved = scoring::pose_at(&run.truth, Stamp::from_nanos(checkpoint.stamp_ns)).unwrap();
        assert!((nalgebra::Vector3::from(checkpoint.position) - saved.translation.vector).norm() < 0.1);

        // Frozen, a pose that is set stands whatever the markers say.
        assert!(caller.call("freeze 1").0);
        let (stamp, _, _) = last(&after(0.1, &run));
        let mut wrong = scoring::pose_at(&run.truth, stamp).unwrap();
        wrong.translation.vector.x += 0.5;
        let covariance = Matrix6::identity() * 1e-6;
        let message = |frame: &str| convert::pose_with_covariance_message(frame, stamp, &wrong, &covariance);
        let mouth = MOUTH.get().unwrap();
        mouth.pose.publish(message("another_frame"));
        let (_, error, _) = last(&after(0.2, &run));
        assert!(error < 0.02, "a pose in another frame is refused: {error} m");
        mouth.pose.publish(message("world"));
        let (_, error, _) = last(&after(0.3, &run));
        assert!((0.3..0.8).contains(&error), "{error} m");
        let outcome = UPDATES.lock().unwrap().last().unwrap().markers[0].outcome;
        assert!([MarkerUpdate::FROZEN, MarkerUpdate::GATED].contains(&outcome), "{outcome}");
        // Freed, it finds back.
        assert!(caller.call("freeze 0").0);
        let (_, error, _) = last(&after(2.0, &run));
        assert!(error < 0.01, "{error} m");

        let (ok, message) = caller.call("reset 0");
        assert!(ok && message.contains("initializes"), "{message}");
        let said = after(2.0, &run);
        let widest = said.iter().map(|s| s.2).fold(0.0, f64::max);
        assert!(widest > 100.0 * velocity, "after a reset nothing is known of the speed: {widest}");
        let (_, error, _) = last(&said);
        assert!(error < 0.01, "{error} m");

        let (ok, message) = caller.call("load_checkpoint 0");
        assert!(ok && message.contains("restored from"), "{message}");
        let (_, error, _) = last(&after(1.0, &run));
        assert!(error < 0.01, "{error} m");
        let _ = std::fs::remove_dir_all(&folder);
    }
}
