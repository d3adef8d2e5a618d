//! The main job over DDS, with the four nodes as processes, simulated hardware, and a Cyclone DDS
//! peer that subscribes to their topics.
//!
//! The nodes' executables are in the folder of this test's build (`cargo build --release
//! --workspace --bins` makes them; `make test` does that first), or in `VOLANT_BIN`. The peer needs
//! `VOLANT_PYTHON`, a Python with `test/requirements.txt`; without it the test counts as skipped.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

use node_kit::{
    convert::{pose, stamp},
    environment::Network,
};
use rig_model::{
    Stamp,
    topics::{self, frames},
};
use std::{
    collections::{HashMap, HashSet},
    path::Path,
    process::{Command, Stdio},
    sync::Arc,
    time::Duration,
};
use test_support::process::Running;
use volant_msgs::{msg::MarkerObservation, std_msgs::msg::Header};
use volant_test::{
    accuracy::Errors,
    live::{Ended, ImageSequence, Received, Run, Scenario, Site, quantile},
};

const DOMAIN: u16 = 87;
const SECONDS: f64 = 7.0;
const LONG: Duration = Duration::from_secs(60);

/// Starts the peer; `None` where there is no Python for it.
fn start_peer() -> Option<Running> {
    test_support::python("rosbags")?;
    let python = test_support::python("cyclonedds")?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/peer/listen.py");
    let mut command = Command::new(python);
    command.arg(script).args([DOMAIN.to_string().as_str(), "60"]).stdin(Stdio::piped());
    let peer = Running::start(&mut command);
    peer.line_with("ready", LONG);
    Some(peer)
}

/// What the peer received, by topic and stamp: frame and values.
fn finish_peer(mut peer: Running) -> HashMap<(String, i64), (String, Vec<f64>)> {
    peer.write_line("end");
    let (status, lines) = peer.finish(LONG);
    assert!(status.success(), "{lines:?}");
    let parse = |line: &String| {
        let value: serde_json::Value = serde_json::from_str(line).unwrap();
        let values = value["values"].as_array().unwrap();
        let key = (value["topic"].as_str().unwrap().to_owned(), value["stamp"].as_i64().unwrap());
        let frame = value["frame"].as_str().unwrap().to_owned();
        (key, (frame, values.iter().map(|v| v.as_str().unwrap().parse().unwrap()).collect()))
    };
    // Warnings are not JSON.
    lines.iter().filter(|line| line.starts_with('{')).map(parse).collect()
}

/// Equal to the last bit, NaN being itself.
fn same(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a == b || (a.is_nan() && b.is_nan()))
}

fn render() -> (Scenario, Arc<ImageSequence>) {
    let scenario = Scenario::swing(7, SECONDS).unwrap();
    let images = ImageSequence::of(&scenario).unwrap();
    (scenario, Arc::new(images))
}

/// Runs the rig with its logs in `folder`; the stamp of the scenario's zero, and the instants
/// between which it is evaluated.
fn ran(
    scenario: &Scenario,
    images: Arc<ImageSequence>,
    folder: &Path,
) -> (Ended, Stamp, [Stamp; 2]) {
    let network = Network { domain_id: DOMAIN, ..Network::default() };
    let mut run = Run::start(scenario, images, &Site::here(&network), folder).unwrap();
    run.wait_for_pose(30.0).unwrap();
    let epoch = run.begin();
    run.play_until(SECONDS + 0.3, |_, _| {}).unwrap();
    let ended = run.finish().unwrap();
    (ended, epoch, [1.0, SECONDS - 0.1].map(|t| epoch.plus_seconds(t)))
}

#[test]
fn four_processes_turn_frames_bytes_and_encoders_into_the_pose() {
    let (scenario, images) = render();
    let folder = std::env::temp_dir().join(format!("volant-end-to-end-{}", std::process::id()));
    let peer = start_peer();
    let (ended, epoch, [from, to]) = ran(&scenario, images, &folder);
    let received = &ended.received;
    let truth = |at: Stamp| scenario.motion.world_from_volant(at.seconds_since(epoch));

    check_rates(received, from, to);
    check_frames(received);
    check_markers(received, &scenario, epoch);

    let errors = Errors::of(&received.fused(), from, to, truth);
    assert!(errors.position_rmse <= 2.0 && errors.rotation_rmse <= 0.3, "{errors:?}");
    let nees = received.nees(from, to, truth);
    for k in 0..2 {
        let mean = nees.iter().map(|(_, n)| n[k]).sum::<f64>() / nees.len() as f64;
        assert!(mean > 0.05 && mean < 12.0, "NEES {k}: {mean}");
    }
    for (name, status) in &ended.ends {
        assert!(status.success(), "{name} ended with {status}; see {}", folder.display());
    }
    if let Some(peer) = peer {
        std::thread::sleep(Duration::from_millis(200));
        check_peer(received, &finish_peer(peer), from, to);
    }
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
#[ignore = "measures wall time: make long"]
fn odometry_contains_an_image_within_50_ms() {
    let (scenario, images) = render();
    let folder = tempfile::tempdir().unwrap();
    let (ended, _, [from, to]) = ran(&scenario, images, folder.path());
    let latencies = ended.received.latencies(from, to);
    // Other processes delay some images; a wait inside the nodes would show in the best second too.
    let best = latencies
        .windows(30)
        .map(|second| quantile(second, 0.5))
        .min_by(f64::total_cmp)
        .unwrap_or(f64::NAN);
    println!(
        "image to odometry: median {:.1} ms of {}, {:.1} ms in the best second",
        1e3 * quantile(&latencies, 0.5),
        latencies.len(),
        1e3 * best
    );
    assert!(best < 0.05, "{latencies:?}");
}

/// Odometry and fused pose with every IMU sample, and bearing its stamp.
fn check_rates(received: &Received, from: Stamp, to: Stamp) {
    let within = |at: Stamp| at >= from && at <= to;
    let odometry: Vec<Stamp> = received
        .odometry
        .iter()
        .map(|(_, m)| stamp(&m.header.stamp))
        .filter(|s| within(*s))
        .collect();
    let samples: Vec<Stamp> =
        received.imu.iter().map(|(_, m)| stamp(&m.header.stamp)).filter(|s| within(*s)).collect();
    assert!(samples.len() as f64 > 0.97 * 100.0 * (SECONDS - 1.1), "{} IMU samples", samples.len());
    assert!(
        odometry.len() as f64 >= 0.97 * samples.len() as f64,
        "{} of {}",
        odometry.len(),
        samples.len()
    );
    assert!(odometry.windows(2).all(|w| w[0] < w[1]), "stamps go back");
    let known: std::collections::HashSet<Stamp> =
        received.imu.iter().map(|(_, m)| stamp(&m.header.stamp)).collect();
    let unknown = odometry.iter().filter(|s| !known.contains(s)).count();
    assert!(
        unknown as f64 <= 0.02 * odometry.len() as f64,
        "{unknown} stamps without an IMU sample"
    );
}

fn check_frames(received: &Received) {
    assert!(
        received
            .odometry
            .iter()
            .all(|(_, m)| m.header.frame_id == frames::WORLD && m.child_frame_id == frames::VOLANT)
    );
    assert!(received.fused_pose.iter().all(|(_, m)| m.header.frame_id == frames::VOLANT));
    assert!(received.visual_pose.iter().all(|(_, m)| m.header.frame_id == frames::WORLD));
    assert!(received.imu.iter().all(|(_, m)| m.header.frame_id == frames::IMU));
    assert!(received.markers.iter().all(|(_, m)| m.header.frame_id == frames::CAMERA));
    assert!(
        received
            .climber
            .iter()
            .all(|(_, m)| m.header.frame_id == frames::WORLD && m.child_frame_id == frames::CLIMBER)
    );
    let fixed = |parent: &str, child: &str| {
        received
            .tf_static
            .iter()
            .flat_map(|(_, m)| &m.transforms)
            .any(|t| t.header.frame_id == parent && t.child_frame_id == child)
    };
    assert!(fixed(frames::CLIMBER, frames::CAMERA) && fixed(frames::VOLANT, frames::IMU));
    let moving = |child: &str| {
        received
            .tf
            .iter()
            .flat_map(|(_, m)| &m.transforms)
            .any(|t| t.header.frame_id == frames::WORLD && t.child_frame_id == child)
    };
    assert!(moving(frames::CLIMBER) && moving(frames::VOLANT));
    for node in ["climber_driver", "imu_driver", "marker_tracker", "pose_fusion"] {
        let reported = received
            .diagnostics
            .iter()
            .flat_map(|(_, m)| &m.status)
            .any(|s| s.name.starts_with(node));
        assert!(reported, "no diagnostics of {node}");
    }
    // `odometry` and `fused_pose` are inverse to each other.
    let by_stamp: HashMap<Stamp, _> =
        received.fused_pose.iter().map(|(_, m)| (stamp(&m.header.stamp), m)).collect();
    let mut compared = 0;
    for (_, odometry) in &received.odometry {
        let Some(fused) = by_stamp.get(&stamp(&odometry.header.stamp)) else { continue };
        let a = pose(&odometry.pose.pose, "odometry").unwrap();
        let b = pose(&fused.pose.pose, "fused_pose").unwrap();
        let off = a * b;
        assert!(off.translation.vector.norm() < 1e-9 && off.rotation.angle() < 1e-7);
        compared += 1;
    }
    assert!(compared > 300, "{compared}");
    // Each odometry message has a status, and the same pose on `volant/pose`.
    let with_status: HashSet<Stamp> =
        received.status.iter().map(|(_, m)| stamp(&m.header.stamp)).collect();
    let poses: HashMap<Stamp, _> =
        received.pose.iter().map(|(_, m)| (stamp(&m.header.stamp), m)).collect();
    let both = received.odometry.iter().filter(|(_, odometry)| {
        let at = stamp(&odometry.header.stamp);
        with_status.contains(&at) && poses.get(&at).is_some_and(|p| p.pose == odometry.pose)
    });
    let (both, all) = (both.count(), received.odometry.len());
    assert!(both + 5 >= all, "{both} of {all} odometry messages with status and pose");
}

/// Detected where it can be seen, never detected while it is covered.
fn check_markers(received: &Received, scenario: &Scenario, epoch: Stamp) {
    let cover = scenario.covers[0];
    let (mut seen, mut images, mut covered) = (0, 0, 0);
    for (_, message) in &received.markers {
        let t = stamp(&message.header.stamp).seconds_since(epoch);
        let marker = &message.markers[cover.color.index()];
        if t > cover.seconds[0] && t < cover.seconds[1] {
            covered += 1;
            assert_ne!(
                marker.state,
                MarkerObservation::DETECTED,
                "covered {}, yet detected at {t}",
                cover.color
            );
        } else if t > 0.0 && (t < cover.seconds[0] - 0.5 || t > cover.seconds[1] + 0.5) {
            images += 1;
            seen +=
                usize::from(message.markers.iter().all(|m| m.state == MarkerObservation::DETECTED));
        }
    }
    assert!(covered > 15, "{covered} images with a covered marker");
    assert!(
        f64::from(images) > 0.9 * 30.0 * (SECONDS - 3.0) && seen as f64 > 0.95 * f64::from(images),
        "{seen} of {images}"
    );
}

/// The peer decodes the same values, to the last bit.
fn check_peer(
    received: &Received,
    peer: &HashMap<(String, i64), (String, Vec<f64>)>,
    from: Stamp,
    to: Stamp,
) {
    let of_pose = |p: &volant_msgs::geometry_msgs::msg::PoseWithCovariance| {
        let (t, q) = (&p.pose.position, &p.pose.orientation);
        let mut values = vec![t.x, t.y, t.z, q.x, q.y, q.z, q.w];
        values.extend(p.covariance);
        values
    };
    let mut ours: Vec<(&str, &Header, Vec<f64>)> = Vec::new();
    for (_, m) in &received.odometry {
        let mut values = of_pose(&m.pose);
        values.extend([m.twist.twist.linear.x, m.twist.twist.angular.z]);
        ours.push((topics::ODOMETRY, &m.header, values));
    }
    for (_, m) in &received.fused_pose {
        ours.push((topics::FUSED_POSE, &m.header, of_pose(&m.pose)));
    }
    for (_, m) in &received.markers {
        let values = m
            .markers
            .iter()
            .flat_map(|o| {
                [
                    f64::from(o.color),
                    f64::from(o.state),
                    f64::from(o.occluded_frames),
                    o.x,
                    o.y,
                    o.covariance[0],
                ]
            })
            .collect();
        ours.push((topics::MARKERS, &m.header, values));
    }
    for topic in [topics::ODOMETRY, topics::FUSED_POSE, topics::MARKERS] {
        let within = |header: &Header| (from..=to).contains(&stamp(&header.stamp));
        let of_topic: Vec<_> =
            ours.iter().filter(|(t, header, _)| *t == topic && within(header)).collect();
        let mut found = 0;
        for (_, header, values) in &of_topic {
            let at = stamp(&header.stamp);
            if let Some((their_frame, theirs)) = peer.get(&(topic.to_owned(), at.as_nanos())) {
                found += 1;
                assert_eq!(header.frame_id, *their_frame);
                assert!(same(values, theirs), "{topic} at {at}: {values:?} {theirs:?}");
            }
        }
        assert!(
            found as f64 > 0.97 * of_topic.len() as f64 && found > 100,
            "{topic}: {found} of {}",
            of_topic.len()
        );
    }
}
