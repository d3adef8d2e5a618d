//! Programs of another build (64-bit ARM, statically linked) give the poses of those for this
//! computer: `make arm64-test`, `make tarball-test`.
//!
//! `VOLANT_OTHER` is the command line of that `volant`, an emulator first if need be.
#![allow(clippy::unwrap_used, reason = "a test")]

use bag::recording::map_messages;
use nalgebra::Isometry3;
use node_kit::convert;
use rig_model::topics::absolute::ODOMETRY;
use std::{path::Path, process::Command};
use volant_msgs::nav_msgs::msg::Odometry;
use volant_test::live::processes::executables;

/// Largest difference of a position, m, and of a rotation, rad, unless `VOLANT_OTHER_WITHIN` is
/// set. Builds differ in their elementary functions and in fused multiplications; with another C
/// library a decision at a threshold can differ (`real_tapping`, musl: 0.085 mm).
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
    map_messages(path, ODOMETRY, |_, odometry: Odometry| {
        convert::pose(&odometry.pose.pose, "odometry").unwrap()
    })
    .unwrap()
}

#[test]
#[ignore = "needs programs of another build: make arm64-test, make tarball-test"]
fn another_build_gives_the_poses_of_this_one() {
    let Some(recordings) = test_support::recordings() else { return };
    let Ok(other) = std::env::var("VOLANT_OTHER") else {
        test_support::skip("VOLANT_OTHER is not set: make arm64-test");
        return;
    };
    let within = std::env::var("VOLANT_OTHER_WITHIN").map_or(EQUAL, |text| text.parse().unwrap());
    let here = executables().join("volant");
    let folder = tempfile::tempdir().unwrap();
    let mut bags: Vec<_> =
        std::fs::read_dir(recordings.join("bags")).unwrap().map(|e| e.unwrap().path()).collect();
    bags.retain(|bag| bag.join("in.mcap").exists());
    bags.sort();
    assert!(!bags.is_empty());
    for bag in bags {
        let [here_out, other_out] =
            ["here", "other"].map(|name| folder.path().join(name).with_extension("mcap"));
        replay(&[here.to_str().unwrap()], &bag, &here_out);
        replay(&other.split_whitespace().collect::<Vec<_>>(), &bag, &other_out);
        let [here, other] = [&here_out, &other_out].map(|path| poses(path));
        assert!(here.len() > 500 && here.len() == other.len(), "{} {}", here.len(), other.len());
        let mut most = (0.0_f64, 0.0_f64);
        for (a, b) in here.iter().zip(&other) {
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
        assert!(most.0 < within && most.1 < within, "{name}: {most:?}");
        for out in [here_out, other_out] {
            std::fs::remove_file(out).unwrap();
        }
    }
}
