//! Files of the rig that are wrong by more than their sigmas.

use super::*;
use nalgebra::Vector3;
use pose_fusion::{
    RigCheck,
    ekf::consider::{FOCAL, FileErrors, MOUNTING, SIZE},
};
use rig_model::{CameraModel, Rig};

/// Focal length too large by 1 %.
fn focal_length(_: &mut Rig, input: &mut Input) {
    if let Input::Camera(camera) = input {
        let (f, c) = (camera.focal_lengths() * 1.01, camera.principal_point());
        let (width, height) = camera.size();
        let lens = *camera.distortion();
        *camera = CameraModel::new(width, height, [f.x, f.y, c.x, c.y], lens).unwrap();
    }
}

fn layout(rig: &mut Rig, _: &mut Input) {
    rig.markers.centers.0.iter_mut().for_each(|center| center.coords *= 1.01);
}

fn mounting(rig: &mut Rig, _: &mut Input) {
    let tilt = Vector3::new(0.3_f64.to_radians(), 0.0, 0.0);
    rig.climber_from_camera.rotation *= nalgebra::UnitQuaternion::from_scaled_axis(tilt);
}

/// Before, the pose was off by 10 mm with a sigma below 1 mm, for good.
#[test]
fn wrong_files_widen_the_covariance_and_are_named() {
    type Change = fn(&mut Rig, &mut Input);
    let wrong: [(Change, usize, f64, &str); 4] = [
        (|_, _| {}, FOCAL, 0.0, ""),
        (focal_length, FOCAL, -0.01, "focal length"),
        (layout, SIZE, -0.01, "layout"),
        (mounting, MOUNTING, 0.0052, "camera.orientation"),
    ];
    for (change, error, truth, named) in wrong {
        for seed in 1..=2 {
            let motion = MotionConfig { duration: 30.0, ..MotionConfig::fast_swing(seed) };
            let run = simulated::run(motion, &SensorConfig::nominal(seed));
            let mut rig = run.rig.clone();
            let mut inputs: Vec<Input> = run.inputs().collect();
            let mut unused = rig.clone();
            inputs.iter_mut().for_each(|input| change(&mut unused, input));
            change(&mut rig, &mut inputs[0].clone());
            let mut fusion = Fusion::new(rig, FusionConfig::default());
            let outputs = scoring::run(&mut fusion, inputs);
            let found = fusion.status().file_errors;
            let mut check = RigCheck::default();
            check.note_camera();
            outputs.images.iter().for_each(|image| check.note(image));
            let findings = check.findings(&fusion.status());
            let score = scoring::score(&outputs.odometry, &run.truth, 15.0);
            let (position, rotation) = score.nees();
            let about = format!(
                "{named}, seed {seed}: {}{:.1} mm, NEES {position:.1}, {rotation:.1} {findings:?}",
                found.transpose(),
                score.position_rmse()
            );
            println!("{about}");
            assert!(position < 6.0 && rotation < 6.0, "{about}");
            assert!((found[error] - truth).abs() <= 0.4 * truth.abs(), "{about}");
            if named.is_empty() {
                assert!(findings.is_empty(), "{about}");
            } else {
                // What was found with another camera is forgotten.
                fusion.handle(Input::Camera(simulated::camera()));
                let forgotten = fusion.status().file_errors == FileErrors::zeros();
                assert_eq!(forgotten, named == "focal length", "{about}");
                assert!(findings.iter().any(|finding| finding.contains(named)), "{about}");
            }
        }
    }
}
