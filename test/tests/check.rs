//! `volant check` on the simulated rig: one fault of each kind is named, unchanged runs are not
//! accused; and the command's exit status and JSON on a recording.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use rig_calibration::Verdict;
use rig_model::{MarkerColor, Rig};
use rig_simulator::motion::MotionConfig;
use serde_json::Value;
use std::fs;
use test_support::place::Place;
use volant_test::{
    check::{Bench, FAULTS, Fault, findings_while_running},
    robustness::recording::read,
};

/// Faults of the short form; `make checks` has all of them, on recordings too.
const KINDS: [&str; 16] = [
    "camera tilt 2°",
    "camera yaw 180°",
    "focal length +20 %",
    "distortion zeroed",
    "layout in cm",
    "red and green swapped",
    "IMU quaternion as w, x, y, z",
    "accelerometer negated",
    "gyroscope in deg/s",
    "encoders x and y exchanged",
    "rails in mm",
    "turn in degrees",
    "turn reversed",
    "encoder stamps + 0.2 s",
    "rolling shutter of 20 ms",
    "two climbers on one topic",
];

fn fault(name: &str) -> &'static Fault {
    FAULTS.iter().find(|f| f.name == name).unwrap()
}

#[test]
fn one_fault_of_each_kind_is_named() {
    let bench = Bench::simulated(1).unwrap();
    assert!(bench.clean().findings.is_empty(), "{:?}", bench.clean().findings);
    for kind in KINDS {
        let cell = bench.cell(fault(kind));
        assert!(cell.right, "{kind}: {} {:?}", cell.text, cell.sentences);
        let unit = cell.text.contains("climber.turn.unit");
        assert_eq!(unit, kind == "turn in degrees", "{kind}: {}", cell.text);
    }
}

#[test]
fn unchanged_runs_of_other_seeds_are_not_accused() {
    for seed in 11..14 {
        let bench = Bench::simulated(seed).unwrap();
        assert!(bench.clean().findings.is_empty(), "{seed}: {:?}", bench.clean().findings);
        assert!(bench.clean().rows.len() > 40);
    }
}

/// Faults with a symptom in the running filter, and a word of it.
const SYMPTOMS: [(&str, &str); 8] = [
    ("red and green swapped", "no pose fits"),
    ("red marker 20 cm off", "no pose fits"),
    ("IMU tilt 5°", "rotated by"),
    ("IMU yaw 5°", "gyroscope rotated by"),
    ("accelerometer in g", "linear_acceleration is 1.0"),
    ("gyroscope scale +2 %", "gyroscope scale factor 2"),
    ("IMU stamps + 0.2 s", "differ by 2"),
    ("distortion zeroed", "`camera_info`"),
];

#[test]
fn the_running_filter_reports_symptoms_and_none_of_correct_files() {
    let bench = Bench::simulated(1).unwrap();
    for (kind, word) in SYMPTOMS {
        let found = bench.while_running(Some(fault(kind))).join("; ");
        assert!(found.contains(word), "{kind}: {found}");
    }
    for seed in 11..14 {
        let found = Bench::simulated(seed).unwrap().while_running(None);
        assert!(found.is_empty(), "{seed}: {found:?}");
    }
}

#[test]
fn the_running_filter_reports_nothing_in_recordings_with_correct_files() {
    let Some(shared) = test_support::recordings() else { return };
    let bags = fs::read_dir(shared.join("bags")).unwrap().map(|entry| entry.unwrap().path());
    for folder in bags.filter(|folder| folder.join("truth.mcap").is_file()) {
        let found = findings_while_running(&read(&folder, None).unwrap());
        assert!(found.is_empty(), "{}: {found:?}", folder.display());
    }
}

#[test]
fn a_climber_at_rest_is_unobservable_and_not_stuck() {
    let config = MotionConfig {
        climber_speed: 0.0,
        climber_turn_rate: 0.0,
        swing: 0.2,
        ..MotionConfig::nominal(7)
    };
    let report = Bench::of_motion(config).unwrap().clean().clone();
    assert!(report.findings.is_empty(), "{:?}", report.findings);
    for name in ["climber.rail_x scale", "climber.rail_y scale", "climber.turn scale"] {
        let row = report.rows.iter().find(|r| r.name == name).unwrap();
        assert_eq!(row.verdict, Verdict::Unobservable, "{row:?}");
    }
}

/// With the markers that the tracker finds in the images.
#[test]
fn the_running_filter_reports_exchanged_colors_in_a_recording_with_images() {
    let Some(shared) = test_support::recordings() else { return };
    let bench = Bench::read(&shared.join("bags/nominal")).unwrap();
    let found = bench.while_running(Some(fault("red and green swapped"))).join("; ");
    assert!(found.contains("no pose fits"), "{found}");
    assert!(bench.while_running(None).is_empty(), "{:?}", bench.while_running(None));
}

#[test]
fn the_command_names_an_exchanged_pair_of_colors_in_a_recording_with_images() {
    let Some(shared) = test_support::recordings() else { return };
    let folder = shared.join("bags/nominal").canonicalize().unwrap();
    let text = fs::read_to_string(folder.join("rig.yaml")).unwrap();
    let place = Place::with_rig(&text);
    let check = format!("check {}/in.mcap --rig rig.yaml --json report.json", folder.display());
    place.done(&check);
    let report: Value = serde_json::from_slice(&place.read("report.json")).unwrap();
    assert_eq!(report["wrong"], false);
    let verdict = |name: &str| {
        let rows = report["rows"].as_array().unwrap();
        rows.iter().find(|r| r["name"] == name).unwrap()["verdict"].as_str().unwrap().to_owned()
    };
    assert_eq!(verdict("camera_info: fx"), "ok");
    assert_eq!(verdict("climber.height"), "unobservable");
    place.fails(&check, &["report.json", "exists already", "--overwrite"]);

    let swapped =
        text.replace("red:", "none:").replace("green:", "red:").replace("none:", "green:");
    let (a, b) = (Rig::from_yaml(&text).unwrap(), Rig::from_yaml(&swapped).unwrap());
    assert_eq!(a.markers.centers[MarkerColor::Red], b.markers.centers[MarkerColor::Green]);
    place.write("rig.yaml", &swapped);
    let ran = place.volant(&format!("{check} --overwrite"));
    assert_eq!(ran.status, Some(1), "{}{}", ran.out, ran.err);
    assert!(ran.out.contains("the markers red and green are exchanged"), "{}", ran.out);
}
