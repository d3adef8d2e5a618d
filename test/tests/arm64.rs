//! The programs for 64-bit ARM give the poses of those for this computer: `make arm64-test`.
//!
//! `VOLANT_ARM64` is the command line of that `volant`, an emulator first if need be.
#![allow(clippy::unwrap_used, reason = "a test")]

use bag::BagReader;
use nalgebra::Isometry3;
use node_kit::convert;
use rig_model::topics::absolute::ODOMETRY;
use std::{path::Path, process::Command};
use volant_msgs::{cdr, nav_msgs::msg::Odometry};
use volant_test::live::processes::executables;

/// Largest difference of a position, m, and of a rotation, rad. The two differ in their elementary
/// functions and in fused multiplications.
const EQUAL: f64 = 1e-9;

fn replay(volant: &[&str], bag: &Path, out: &Path) {
    let (program, first) = volant.split_first().unwrap();
    let output = Command::new(program)
        .args(first)
        .arg("replay")
        .arg(bag.join("in.mcap"))
        .arg("--rig")
        .arg(bag.join("rig.yaml"))
        .arg("--out")
        .arg(out)
        .output()
        .unwrap();
    assert!(output.status.success(), "{program}: {}", String::from_utf8_lossy(&output.stderr));
}

/// `world_from_volant` of the odometry.
fn poses(path: &Path) -> Vec<Isometry3<f64>> {
    let mut bag = BagReader::open(path).unwrap();
    let mut poses = vec![];
    while let Some(message) = bag.next_message().unwrap() {
        if message.topic.name == ODOMETRY {
            let odometry: Odometry = cdr::from_bytes(&message.data).unwrap();
            poses.push(convert::pose(&odometry.pose.pose, "odometry").unwrap());
        }
    }
    poses
}

#[test]
#[ignore = "needs programs for arm64, and minutes in an emulator: make arm64-test"]
fn a_replay_on_arm64_gives_the_poses_of_a_replay_here() {
    let Some(recordings) = test_support::recordings() else { return };
    let Ok(arm64) = std::env::var("VOLANT_ARM64") else {
        test_support::skip("VOLANT_ARM64 is not set: make arm64-test");
        return;
    };
    let here = executables().join("volant");
    let folder = tempfile::tempdir().unwrap();
    let mut bags: Vec<_> =
        std::fs::read_dir(recordings.join("bags")).unwrap().map(|e| e.unwrap().path()).collect();
    bags.retain(|bag| bag.join("in.mcap").exists());
    bags.sort();
    assert!(!bags.is_empty());
    for bag in bags {
        let [here_out, arm64_out] =
            ["here", "arm64"].map(|name| folder.path().join(name).with_extension("mcap"));
        replay(&[here.to_str().unwrap()], &bag, &here_out);
        replay(&arm64.split_whitespace().collect::<Vec<_>>(), &bag, &arm64_out);
        let [here, arm64] = [&here_out, &arm64_out].map(|path| poses(path));
        assert!(here.len() > 500 && here.len() == arm64.len(), "{} {}", here.len(), arm64.len());
        let mut most = (0.0_f64, 0.0_f64);
        for (a, b) in here.iter().zip(&arm64) {
            let between = a.inv_mul(b);
            most.0 = most.0.max(between.translation.vector.norm());
            most.1 = most.1.max(between.rotation.angle());
        }
        let name = bag.file_name().unwrap().to_string_lossy().into_owned();
        println!(
            "{name}: {} poses differ by at most {:.1e} m, {:.1e} rad",
            here.len(),
            most.0,
            most.1
        );
        assert!(most.0 < EQUAL && most.1 < EQUAL, "{name}: {most:?}");
        for out in [here_out, arm64_out] {
            std::fs::remove_file(out).unwrap();
        }
    }
}
