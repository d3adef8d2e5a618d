//! Planar ambiguity: four coplanar points seen from straight above, with and without a tilt prior.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::panic)]

use nalgebra::{Isometry3, Matrix2, Translation3, UnitQuaternion, Vector2, Vector3};
use rig_model::{
    CameraModel, Distortion, PerColor, Rig,
    planar_pose::{self, TiltPrior},
};
use rig_simulator::{parallel, random::Random};

/// Frames of one seed.
const FRAMES: u64 = 1_000;

/// Number of frames with a tilt error above 5°, without and with prior, and the largest error with
/// prior, degrees.
fn frames(seed: u64) -> (u64, u64, f64) {
    let layout = Rig::from_yaml(rig_simulator::RIG_YAML).unwrap().markers;
    let lens = Distortion::PlumbBob([-0.23, 0.082, 7e-4, -4e-4, -0.006]);
    let camera = CameraModel::new(640, 480, [591.0, 589.0, 319.3, 235.2], lens).unwrap();
    let mut r = Random::new(seed);
    let sigma = 0.0096;
    let (mut without, mut with_prior, mut worst) = (0, 0, 0.0f64);
    for _ in 0..FRAMES {
        let (tilt, direction, yaw) =
            (10.0_f64.to_radians() * r.unit(), std::f64::consts::TAU * r.unit(), 6.2 * r.unit());
        let lean = Vector3::new(direction.cos(), direction.sin(), 0.0) * tilt;
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let truth = Isometry3::from_parts(
            Translation3::new(0.3 * r.unit() - 0.15, 0.2 * r.unit() - 0.1, 1.5 + 0.5 * r.unit()),
            down * UnitQuaternion::from_scaled_axis(lean)
                * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
        );
        let pixels = PerColor::from_fn(|color| {
            let seen = layout.projected_centroid(color, &camera, &truth).unwrap().pixel;
            let noise = Vector2::new(r.normal(), r.normal()) * 0.5;
            Some((seen + noise, Matrix2::identity() * 0.25))
        });
        let up_in_camera = -Vector3::z();
        // Roll and pitch of the IMU with its stated standard deviation.
        let error = Vector3::new(r.normal(), r.normal(), 0.0) * sigma;
        let up_in_volant =
            UnitQuaternion::from_scaled_axis(error) * (truth.rotation.inverse() * up_in_camera);
        let prior = TiltPrior { up_in_volant, up_in_camera, sigma };
        let off = |found: &[planar_pose::PlanarPose]| {
            found.first().map_or(f64::INFINITY, |best| {
                let up = best.camera_from_volant.rotation.inverse() * up_in_camera;
                up.angle(&(truth.rotation.inverse() * up_in_camera)).to_degrees()
            })
        };
        let alone = off(&planar_pose::candidates(&layout, &camera, &pixels, None));
        let with = off(&planar_pose::candidates(&layout, &camera, &pixels, Some(&prior)));
        without += u64::from(alone > 5.0);
        with_prior += u64::from(with > 5.0);
        worst = worst.max(with);
    }
    (without, with_prior, worst)
}

#[test]
fn a_tilt_prior_keeps_100_000_frames_within_five_degrees() {
    let found =
        parallel::map(parallel::processors(), 100, || (), |_, index| frames(index as u64 + 1));
    let count = found.len() as u64 * FRAMES;
    let without: u64 = found.iter().map(|f| f.0).sum();
    let with_prior: u64 = found.iter().map(|f| f.1).sum();
    let worst = found.iter().map(|f| f.2).fold(0.0, f64::max);
    println!(
        "{count} frames: tilt error above 5 deg in {:.1} % without prior, in {with_prior} with it; \
         largest {worst:.2} deg",
        100.0 * without as f64 / count as f64
    );
    assert_eq!(with_prior, 0);
    assert!(without > count / 10, "these views must be ambiguous: {without}");
}
