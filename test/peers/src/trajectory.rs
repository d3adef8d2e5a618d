//! How the platform moves below the camera.

use crate::scene::Pinhole;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use std::f64::consts::{PI, TAU};

/// `camera_from_volant` of a platform whose center is seen at `pixel`, `range` m below, tilted by
/// `tilt` about the axis along `direction` in its plane, with yaw `yaw`.
pub fn pose(
    camera: &Pinhole,
    pixel: Vector2<f64>,
    range: f64,
    tilt: f64,
    direction: f64,
    yaw: f64,
) -> Isometry3<f64> {
    let offset = (pixel - camera.center()) * (range / camera.focal);
    let axis = Vector3::new(direction.cos(), direction.sin(), 0.0);
    let rotation = UnitQuaternion::from_scaled_axis(axis * tilt)
        * UnitQuaternion::from_scaled_axis(Vector3::x() * PI)
        * UnitQuaternion::from_scaled_axis(Vector3::z() * yaw);
    Isometry3::from_parts(Translation3::new(offset.x, offset.y, range), rotation)
}

/// The pose of [`pose`] that is nearest to it on the paper's bench: a pan-tilt unit with steps of
/// 0.01°, and a laser, here with steps of 0.1 mm. So the truth is what those instruments would
/// show, without an error of their own.
pub fn on_bench(
    camera: &Pinhole,
    pixel: Vector2<f64>,
    range: f64,
    tilt: f64,
    direction: f64,
    yaw: f64,
) -> Isometry3<f64> {
    let step = |v: f64| (v.to_degrees() * 100.0).round().to_radians() / 100.0;
    let mut pose = pose(camera, pixel, range, step(tilt), step(direction), step(yaw));
    pose.translation.vector.apply(|v| *v = (*v * 1e4).round() / 1e4);
    pose
}

/// True where the square of edge `footprint` m is in the frame with `margin` px to spare.
pub fn is_inside(camera: &Pinhole, pose: &Isometry3<f64>, footprint: f64, margin: f64) -> bool {
    let h = footprint / 2.0;
    [(-h, -h), (h, -h), (h, h), (-h, h)].iter().all(|&(x, y)| {
        let p = camera.project(&(pose * Point3::new(x, y, 0.0)));
        p.x > margin
            && p.y > margin
            && p.x < camera.width as f64 - 1.0 - margin
            && p.y < camera.height as f64 - 1.0 - margin
    })
}

/// The bench's standard motion at `t` s: 1 to 2 m, tilt to 28°, always in the frame.
pub fn standard(camera: &Pinhole, t: f64) -> Isometry3<f64> {
    let range = 1.5 - 0.5 * (TAU * 0.1 * t).cos();
    let room = Vector2::new(310.0, 230.0) - Vector2::repeat(0.275 * camera.focal / (range - 0.1));
    let sway = Vector2::new((TAU * 0.23 * t).sin(), (TAU * 0.31 * t + 1.0).sin());
    let tilt = 28f64.to_radians() * (0.5 - 0.5 * (TAU * 0.37 * t + 0.6).cos());
    let pixel = camera.center() + sway.component_mul(&room.map(|r| r.clamp(5.0, 110.0)));
    pose(camera, pixel, range, tilt, TAU * 0.13 * t, 0.5 * (TAU * 0.17 * t).sin() + 0.2)
}
