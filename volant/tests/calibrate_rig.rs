//! Calibration of the rig: a wrong rig file is corrected.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout)]

use nalgebra::{UnitQuaternion, Vector3};
use rig_calibration::Refinement;
use rig_model::{MarkerColor, Rig};
use std::fs;
use volant::{calibration::refine_from_bag, replay::Cores};

use MarkerColor::{Blue, Green, Red, Yellow};

#[test]
fn a_wrong_rig_file_is_corrected() {
    let Some(shared) = test_support::recordings() else { return };
    for (bag, sure) in [("nominal", 4.0), ("fast_swing", 5.0)] {
        let folder = shared.join("bags").join(bag);
        let truth = Rig::from_yaml(&fs::read_to_string(folder.join("rig.yaml")).unwrap()).unwrap();
        let mut wrong = truth.clone();
        let turn = |x: f64, y: f64, z: f64| {
            UnitQuaternion::from_scaled_axis(Vector3::new(
                x.to_radians(),
                y.to_radians(),
                z.to_radians(),
            ))
        };
        wrong.climber_from_camera.rotation =
            turn(1.0, -1.5, 0.0) * truth.climber_from_camera.rotation;
        wrong.imu.volant_from_imu.rotation =
            turn(2.0, 1.0, -2.5) * truth.imu.volant_from_imu.rotation;
        wrong.imu.volant_from_imu.translation.vector += Vector3::new(0.01, -0.01, 0.01);
        // One diagonal longer, the other shorter: no translation, rotation or scaling, which images
        // do not determine.
        for (color, x, y) in
            [(Red, 2e-3, 2e-3), (Blue, -2e-3, -2e-3), (Green, 2e-3, -2e-3), (Yellow, -2e-3, 2e-3)]
        {
            wrong.markers.centers[color] += Vector3::new(x, y, 0.0);
        }
        let estimate =
            refine_from_bag(&folder.join("in.mcap"), &Cores::of(&wrong), &[], &mut vec![]).unwrap();
        println!("{bag}: {:?}", estimate.pixel_rms);
        let found = &estimate.rig;
        let deviation = |name: &str| {
            let row = estimate.rows.iter().find(|r| r.name == name).unwrap();
            assert_eq!(row.refinement, Refinement::Refined, "{bag}: {name}");
            row.deviation
        };
        let check = |name: &str, error: f64| {
            let d = deviation(name);
            assert!(error.abs() < sure * d, "{bag}: {name} is off by {error}, and says {d}");
        };
        let camera = (found.climber_from_camera.rotation
            * truth.climber_from_camera.rotation.inverse())
        .scaled_axis();
        let imu = (found.imu.volant_from_imu.rotation
            * truth.imu.volant_from_imu.rotation.inverse())
        .scaled_axis();
        let place = found.imu.volant_from_imu.translation.vector
            - truth.imu.volant_from_imu.translation.vector;
        for (i, axis) in ["x", "y", "z"].iter().enumerate() {
            if i < 2 {
                check(&format!("camera rotation about climber {axis}"), camera[i].to_degrees());
                assert!(camera[i].abs().to_degrees() < 0.15);
            }
            check(&format!("imu rotation about volant {axis}"), imu[i].to_degrees());
            assert!(imu[i].abs().to_degrees() < 0.3);
            check(&format!("imu position along volant {axis}"), 1e3 * place[i]);
        }
        // The climber hardly accelerates: the camera's rotation about the vertical and its position
        // stay undetermined.
        for name in ["camera rotation about climber z", "camera position along climber z"] {
            let row = estimate.rows.iter().find(|r| r.name == name).unwrap();
            assert_eq!(row.refinement, Refinement::Undetermined, "{bag}: {name}");
        }
        let side = |r: &Rig, a, b| (r.markers.centers[a] - r.markers.centers[b]).norm();
        for (a, b, c, d) in [(Red, Blue, Green, Yellow), (Red, Green, Blue, Yellow)] {
            let ratio = |r: &Rig| side(r, a, b) / side(r, c, d);
            let off = ratio(found) / ratio(&truth) - 1.0;
            println!("{bag}: {a} to {b} over {c} to {d}: off by {off:.1e}");
            assert!(off.abs() < 1e-3, "{bag}: {a} to {b} is off by {off}");
        }
    }
}

/// The files of the recordings are exact. Real IMU samples have slow errors that the adjustment
/// does not model, and which a tilted camera explains.
#[test]
fn an_exact_rig_file_stays_as_it_is() {
    let Some(shared) = test_support::recordings() else { return };
    for bag in ["nominal", "fast_swing", "real_slow", "real_fast"] {
        let folder = shared.join("bags").join(bag);
        let exact = Rig::from_yaml(&fs::read_to_string(folder.join("rig.yaml")).unwrap()).unwrap();
        let bag_file = folder.join("in.mcap");
        let estimate = refine_from_bag(&bag_file, &Cores::of(&exact), &[], &mut vec![]).unwrap();
        for row in estimate.rows.iter().take(24) {
            let kept =
                row.refinement != Refinement::Refined || row.change.abs() < 2.0 * row.deviation;
            assert!(kept, "{bag}: {row:?}");
        }
        let camera = estimate.rig.climber_from_camera.rotation;
        let turned = camera.angle_to(&exact.climber_from_camera.rotation).to_degrees();
        let imu = estimate.rig.imu.volant_from_imu.rotation;
        let imu = imu.angle_to(&exact.imu.volant_from_imu.rotation).to_degrees();
        println!("{bag}: camera {turned:.3}°, IMU {imu:.3}°");
        assert!(turned < 0.02 && imu < 0.02, "{bag}: camera {turned}°, IMU {imu}°");
    }
}
