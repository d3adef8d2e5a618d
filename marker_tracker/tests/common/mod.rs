//! Drawn scenes with exact edges.

#![allow(dead_code, clippy::unwrap_used, clippy::panic)] // each test uses a part

pub mod errors;

use marker_tracker::{ImageView, Input, Output, PixelFormat, Tracker, TrackerConfig};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use rig_model::{
    CameraModel, Distortion, MarkerColor, MarkerLayout, MarkerObservations, PerColor, Stamp,
};

/// Of every image, px.
pub const WIDTH: usize = 640;
/// Of every image, px.
pub const HEIGHT: usize = 480;
/// Colors of the four, r, g, b of 0–255.
pub const PAINT: [[f64; 3]; 4] =
    [[168.0, 47.0, 49.0], [77.0, 132.0, 76.0], [40.0, 93.0, 146.0], [194.0, 166.0, 67.0]];

/// Layout of the markers (volant frame, m).
pub fn layout() -> MarkerLayout {
    MarkerLayout {
        side: 0.076,
        centers: PerColor([
            Point3::new(0.157, 0.145, 0.022),
            Point3::new(-0.154, 0.151, 0.022),
            Point3::new(-0.145, -0.142, 0.022),
            Point3::new(0.147, -0.152, 0.022),
        ]),
    }
}

/// The camera of every image.
pub fn camera() -> CameraModel {
    CameraModel::new(640, 480, [600.0, 600.0, 319.5, 239.5], Distortion::PlumbBob([0.0; 5]))
        .unwrap()
}

/// Pose of the platform (`camera_from_volant`) at `t` s.
pub fn pose(t: f64) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(0.03 * (1.3 * t).sin(), 0.05 * (0.9 * t).cos(), 1.25),
        UnitQuaternion::from_euler_angles(
            std::f64::consts::PI + 0.15 * t.sin(),
            0.1 * t.cos(),
            0.4 + 0.1 * t,
        ),
    )
}

/// A small generator: the noise is the same in every run.
pub struct Noise(pub u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Draws a gray platform on a darker floor, with the markers that have a paint; rgb8.
pub fn draw(pose: &Isometry3<f64>, paint: [Option<[f64; 3]>; 4], noise: &mut Noise) -> Vec<u8> {
    draw_beside(pose, paint, |_, _| None, noise)
}

/// The same with things beside the markers: their color at a place about a marker's center, m along
/// its sides.
pub fn draw_beside(
    pose: &Isometry3<f64>,
    paint: [Option<[f64; 3]>; 4],
    beside: impl Fn(f64, f64) -> Option<[f64; 3]>,
    noise: &mut Noise,
) -> Vec<u8> {
    let inverse = pose.inverse();
    let layout = layout();
    let color_at = |u: f64, v: f64| {
        let ray = inverse.rotation * Vector3::new((u - 319.5) / 600.0, (v - 239.5) / 600.0, 1.0);
        let eye = inverse.translation.vector;
        let p = eye + ray * ((0.022 - eye.z) / ray.z);
        for (color, center) in layout.centers.iter() {
            let turn = 0.03 * (color.index() as f64 - 1.5);
            let (s, c) = turn.sin_cos();
            let (dx, dy) = (p.x - center.x, p.y - center.y);
            let (a, b) = (c * dx + s * dy, -s * dx + c * dy);
            if a.abs() < 0.038 && b.abs() < 0.038 {
                return paint[color.index()].unwrap_or([125.0; 3]);
            }
            if a.abs().max(b.abs()) < 0.06
                && let Some(thing) = beside(a, b)
            {
                return thing;
            }
        }
        if p.x.abs() < 0.23 && p.y.abs() < 0.23 { [125.0; 3] } else { [80.0, 82.0, 84.0] }
    };
    let mut data = Vec::with_capacity(WIDTH * HEIGHT * 3);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let corner = |i: f64, j: f64| color_at(x as f64 + i, y as f64 + j);
            let first = corner(-0.5, -0.5);
            let plain =
                [(0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)].iter().all(|&(i, j)| corner(i, j) == first);
            let mut sum = [0.0; 3];
            let n = if plain { 1 } else { 8 };
            for i in 0..n {
                for j in 0..n {
                    let at = |k: i32| (f64::from(k) + 0.5) / f64::from(n) - 0.5;
                    let c = corner(at(i), at(j));
                    (0..3).for_each(|k| sum[k] += c[k]);
                }
            }
            for s in sum {
                data.push(
                    (s / f64::from(n * n) + 2.0 * noise.normal()).round().clamp(0.0, 255.0) as u8
                );
            }
        }
    }
    data
}

/// Paint of all four.
pub const ALL: [Option<[f64; 3]>; 4] =
    [Some(PAINT[0]), Some(PAINT[1]), Some(PAINT[2]), Some(PAINT[3])];

/// The image number `k` in rgb8.
pub fn image(k: i64, data: &[u8]) -> ImageView<'_> {
    ImageView {
        stamp: Stamp::from_nanos(k * 33_333_333),
        width: WIDTH,
        height: HEIGHT,
        step: 3 * WIDTH,
        format: PixelFormat::Rgb8,
        data,
    }
}

/// Calls `check` with the observations of an rgb8 image and of the same one in each other format,
/// with padded rows, by new trackers.
pub fn in_other_formats(
    config: &TrackerConfig,
    rgb: &[u8],
    check: impl Fn(PixelFormat, &MarkerObservations, &MarkerObservations),
) {
    let reference = observe(&mut new_tracker(config.clone()), 0, rgb);
    for format in [PixelFormat::Bgr8, PixelFormat::Rgba8, PixelFormat::Bgra8] {
        let n = format.bytes_per_pixel();
        let step = n * WIDTH + 5;
        let mut data = vec![0; step * HEIGHT];
        for (i, p) in rgb.chunks_exact(3).enumerate() {
            let mut p = [p[0], p[1], p[2]];
            if format.blue_first() {
                p.reverse();
            }
            data[i / WIDTH * step + i % WIDTH * n..][..3].copy_from_slice(&p);
        }
        let view = ImageView { step, format, data: &data, ..image(0, rgb) };
        check(format, &reference, &observe_view(&mut new_tracker(config.clone()), view));
    }
}

/// The observations of the image number `k`.
pub fn observe(tracker: &mut Tracker, k: i64, data: &[u8]) -> MarkerObservations {
    observe_view(tracker, image(k, data))
}

fn observe_view(tracker: &mut Tracker, view: ImageView<'_>) -> MarkerObservations {
    tracker.handle(Input::Image(view));
    match tracker.poll() {
        Some(Output::Observations(o)) => o,
        other => panic!("{other:?}"),
    }
}

/// A tracker with the camera's model.
pub fn new_tracker(config: TrackerConfig) -> Tracker {
    let mut tracker = Tracker::new(layout(), config);
    tracker.handle(Input::Camera(camera()));
    tracker
}

/// True centroid of a marker, px.
pub fn truth(color: MarkerColor, pose: &Isometry3<f64>) -> Vector2<f64> {
    layout().projected_centroid(color, &camera(), pose).unwrap().pixel
}
