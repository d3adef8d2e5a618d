//! Smoothing of the recorded runs: more accurate than the live estimate, with a consistent
//! covariance.
//!
//! The recordings are found through `VOLANT_SHARED`; without it this test is skipped.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, clippy::print_stdout)]

use rig_model::topics;
use std::{fs, path::Path, process::Command};
use tempfile::TempDir;
use volant::{
    evaluate::{EvaluateOptions, evaluate},
    replay::TopicNames,
};

#[test]
fn smoothed_odometry_is_more_accurate_and_consistent() {
    let Some(shared) = test_support::recordings() else { return };
    let dir = TempDir::new().unwrap();
    // The recordings have the rig file's calibration: an allowance for its errors would make the
    // covariance too large.
    let exact = dir.path().join("exact.yaml");
    let sigmas = [
        "calibration.focal_length_sigma",
        "calibration.layout_sigma",
        "calibration.mounting_sigma",
    ];
    let sigmas = sigmas.iter().chain(&["calibration.encoder_scale_sigma", "clock.climber_sigma"]);
    let lines: String = sigmas.map(|name| format!("    {name}: 0.0\n")).collect();
    fs::write(&exact, format!("pose_fusion:\n  ros__parameters:\n{lines}")).unwrap();
    for name in ["nominal", "occlude_two", "fast_swing", "clutter"] {
        let bag = Path::new(&shared).join("bags").join(name);
        let out = dir.path().join(name).with_extension("mcap");
        let output = Command::new(env!("CARGO_BIN_EXE_volant"))
            .args(["replay".as_ref(), bag.join("in.mcap").as_os_str(), "--rig".as_ref()])
            .args([
                bag.join("rig.yaml").as_os_str(),
                "--out".as_ref(),
                out.as_os_str(),
                "--smooth".as_ref(),
            ])
            .args(["--params-file".as_ref(), exact.as_os_str()])
            .output()
            .unwrap();
        assert!(output.status.success(), "{name}: {}", String::from_utf8_lossy(&output.stderr));
        let options = EvaluateOptions {
            estimates: out,
            truth: bag.join("truth.mcap"),
            skip: 1.0,
            names: TopicNames::default(),
        };
        let found = evaluate(&options).unwrap().estimates;
        let of = |topic: &str| found.iter().find(|q| q.estimate == topic).unwrap();
        let (live, smooth) = (of(topics::ODOMETRY), of(topics::SMOOTHED_ODOMETRY));
        println!(
            "{name:12} live {:.3} mm {:.4} deg; smoothed {:.3} mm {:.4} deg, max {:.2} mm, NEES \
             {:.2} {:.2}",
            live.position_mm.rmse,
            live.rotation_deg.rmse,
            smooth.position_mm.rmse,
            smooth.rotation_deg.rmse,
            smooth.position_mm.max,
            smooth.nees_position.unwrap(),
            smooth.nees_rotation.unwrap()
        );
        assert!(smooth.count + 3 >= live.count, "{} of {}", smooth.count, live.count);
        assert!(smooth.position_mm.rmse < live.position_mm.rmse, "{name}");
        assert!(smooth.rotation_deg.rmse < live.rotation_deg.rmse, "{name}");
        let consistent = |nees: Option<f64>| (0.5..6.0).contains(&nees.unwrap());
        assert!(consistent(smooth.nees_position) && consistent(smooth.nees_rotation), "{name}");
    }
}
