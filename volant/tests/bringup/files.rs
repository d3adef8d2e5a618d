//! What the steps make of rig files: lengths, unknown keys, blocks of namespaces.

use crate::{bringup, place::Place};
use rig_model::{MarkerColor, Rig};
use rig_simulator::RIG_YAML;
use ros_parameters::{ParameterFile, ParameterValue};
use std::fs;

#[test]
fn lengths_in_meters_are_rejected_at_the_prompts_for_millimeters() {
    let place = Place::new();
    let centers =
        "0.15 0.15 0.02\n15O 150 150 20\n150 150 20\n-150 150 20\n-150 -150 20\n150 -150 20\n";
    let mountings = "0\n0.5\n0 0 -100\n0 0 0 0\n0.7071 0.7071 0 0\n0 0 0\n0 0 0 1\n";
    let answers = format!("\n0.076\n76000\n80\n{centers}{mountings}");
    let (_, printed) = bringup(&place, "markers --rig rig.yaml", &answers);
    for needle in [
        "the side is 0.076 mm: give it in millimeters",
        "the side is 76000 mm",
        "the position is 0.15 0.15 0.02 mm: give it in millimeters",
        "write 3 numbers",
        "0 mm is not possible: 0.01 to 20",
        "its length is 0.000",
        "markers     PASS",
    ] {
        assert!(printed.contains(needle), "{needle} in\n{printed}");
    }
    // Repeated with Enter throughout, what a calibration found meanwhile stays.
    let surveyed = place.text("rig.yaml");
    assert!(surveyed.contains("0.0005") && surveyed.contains("0.0175"), "{surveyed}");
    let calibrated = surveyed.replace("0.0005", "0.00005").replace("0.0175", "0.002");
    place.write("rig.yaml", &calibrated);
    let (_, printed) = bringup(&place, "markers --rig rig.yaml", &"\n".repeat(20));
    assert!(printed.contains("markers     PASS"), "{printed}");
    assert_eq!(place.text("rig.yaml"), calibrated);
    // Another answer replaces a former one, and no better calibration.
    let again = |from: &str, answer: &str| {
        place.write("rig.yaml", from);
        let answers = format!("{}{answer}\n{}", "\n".repeat(6), "\n".repeat(8));
        bringup(&place, "markers --rig rig.yaml", &answers);
        let parameters = ParameterFile::parse(&place.text("rig.yaml")).unwrap();
        parameters.for_node("/pose_fusion")["calibration.marker_sigma"].as_f64().unwrap()
    };
    assert_eq!(again(&surveyed, "1"), 1e-3);
    assert_eq!(again(&surveyed, "0.2"), 2e-4);
    assert_eq!(again(&calibrated, "1"), 5e-5);
    place.write("rig.yaml", &calibrated);
    let rig = Rig::from_yaml(&place.text("rig.yaml")).unwrap();
    assert_eq!((rig.markers.side, rig.markers.centers[MarkerColor::Red].x), (0.08, 0.15));
}

#[test]
fn a_value_that_a_block_of_a_namespace_overrides_fails_the_step() {
    let place = Place::with_rig(&format!(
        "{RIG_YAML}/rig1/pose_fusion:\n  ros__parameters:\n    calibration.marker_sigma: 0.001\n"
    ));
    let (status, printed) =
        bringup(&place, "markers --rig rig.yaml", &format!("\n{}", "\n".repeat(20)));
    assert_eq!(status, Some(1), "{printed}");
    let needle = "has another `calibration.marker_sigma` for /rig1/pose_fusion";
    assert!(printed.contains(needle), "{printed}");
    // Repeated, it still does.
    let (status, _) = bringup(&place, "markers --rig rig.yaml", &"\n".repeat(20));
    assert_eq!(status, Some(1));
    place
        .write("rig.yaml", format!("# mine\n{}", place.text("rig.yaml").replace("/rig1/", "/**/")));
    let (status, printed) = bringup(&place, "markers --rig rig.yaml", &"\n".repeat(20));
    assert_eq!(status, Some(0), "{printed}");
    // Enter keeps what the file has.
    let parameters =
        ParameterFile::parse(&place.text("rig.yaml")).unwrap().for_node("/pose_fusion");
    assert_eq!(parameters["calibration.marker_sigma"], ParameterValue::Double(0.001));
    let centers = Rig::from_yaml(RIG_YAML).unwrap().markers.centers.0;
    let arms = centers.iter().map(|c| c.coords.xy().norm_squared()).sum::<f64>().sqrt();
    let layout = parameters["calibration.layout_sigma"].as_f64().unwrap();
    assert!((layout * arms / 1e-3 - 1.0).abs() < 0.1, "{layout}");
}

#[test]
fn a_misspelled_key_is_named_and_nothing_is_written_before_an_answer() {
    let text = RIG_YAML.replacen("position:", "postion:", 1);
    let place = Place::with_rig(&text);
    let here = || fs::read_dir(place.folder()).unwrap().count();
    let (status, printed) = bringup(&place, "--rig rig.yaml", "q\n");
    assert_eq!(status, Some(1), "{printed}");
    let named = "the parameter `camera.postion` is not known (did you mean `camera.position`?)";
    assert!(printed.contains("rig.yaml: ") && printed.contains(named), "{printed}");
    assert_eq!((place.text("rig.yaml"), here()), (text, 1));
    // A file without the key is completed at the first answer only.
    let text = "/**:\n  ros__parameters:\n    markers: {size: 0.08}\n";
    place.write("rig.yaml", text);
    let (_, printed) = bringup(&place, "--rig rig.yaml", "q\n");
    assert_eq!((place.text("rig.yaml").as_str(), here()), (text, 1), "{printed}");
    let (_, printed) = bringup(&place, "--rig rig.yaml", "\nq\n");
    assert!(printed.contains("side [80]"), "{printed}");
    let side = || Rig::from_yaml(&place.text("rig.yaml")).unwrap().markers.side;
    assert_eq!(side(), 0.08);
    // One with comments only is a new one.
    place.write("rig.yaml", "# mine\n\n  # to be measured\n");
    let (_, printed) = bringup(&place, "--rig rig.yaml", "\n80\nq\n");
    assert!(printed.contains("side [76]") && place.text("rig.yaml").starts_with("# mine"));
    assert_eq!(side(), 0.08, "{printed}");
}
