//! The tracker on drawn scenes with exact edges: precision, both criteria, loss and return, what is refused.

#![allow(clippy::unwrap_used, clippy::panic)] // helpers of tests are outside of what clippy takes for a test

use marker_tracker::{ImageView, Input, Output, PixelFormat, Tracker, TrackerConfig, Warning};
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use rig_model::{
    CameraModel, Distortion, MarkerColor, MarkerLayout, MarkerObservations, MarkerState, PerColor, Stamp,
};

const WIDTH: usize = 640;
const HEIGHT: usize = 480;
const PAINT: [[f64; 3]; 4] =
    [[168.0, 47.0, 49.0], [77.0, 132.0, 76.0], [40.0, 93.0, 146.0], [194.0, 166.0, 67.0]];

fn layout() -> MarkerLayout {
    MarkerLayout {
        side: 0.076,
        centres: PerColor([
            Point3::new(0.157, 0.145, 0.022),
            Point3::new(-0.154, 0.151, 0.022),
            Point3::new(-0.145, -0.142, 0.022),
            Point3::new(0.147, -0.152, 0.022),
        ]),
    }
}

fn camera() -> CameraModel {
    CameraModel::new(640, 480, [600.0, 600.0, 319.5, 239.5], Distortion::PlumbBob([0.0; 5])).unwrap()
}

fn pose(t: f64) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(0.03 * (1.3 * t).sin(), 0.05 * (0.9 * t).cos(), 1.25),
        UnitQuaternion::from_euler_angles(
            std::f64::consts::PI + 0.15 * t.sin(),
            0.1 * t.cos(),
            0.4 + 0.1 * t,
        ),
    )
}

/// A small generator, so that the noise is the same in every run.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }
    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// A grey platform on a darker floor, with those markers on it that have a paint.
fn draw(pose: &Isometry3<f64>, paint: [Option<[f64; 3]>; 4], noise: &mut Noise) -> Vec<u8> {
    let inverse = pose.inverse();
    let layout = layout();
    let color_at = |u: f64, v: f64| {
        let ray = inverse.rotation * Vector3::new((u - 319.5) / 600.0, (v - 239.5) / 600.0, 1.0);
        let eye = inverse.translation.vector;
        let p = eye + ray * ((0.022 - eye.z) / ray.z);
        for (color, centre) in layout.centres.iter() {
            let turn = 0.03 * (color.index() as f64 - 1.5);
            let (s, c) = turn.sin_cos();
            let (dx, dy) = (p.x - centre.x, p.y - centre.y);
            let (a, b) = (c * dx + s * dy, -s * dx + c * dy);
            if a.abs() < 0.038 && b.abs() < 0.038 {
                return paint[color.index()].unwrap_or([125.0; 3]);
            }
        }
        if p.x.abs() < 0.23 && p.y.abs() < 0.23 { [125.0; 3] } else { [80.0, 82.0, 84.0] }
    };
    let mut data = Vec::with_capacity(WIDTH * HEIGHT * 3);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let corner = |i: f64, j: f64| color_at(x as f64 + i, y as f64 + j);
            let first = corner(-0.5, -0.5);
            let plain = [(0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)].iter().all(|&(i, j)| corner(i, j) == first);
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
                data.push((s / f64::from(n * n) + 2.0 * noise.normal()).round().clamp(0.0, 255.0) as u8);
            }
        }
    }
    data
}

const ALL: [Option<[f64; 3]>; 4] = [Some(PAINT[0]), Some(PAINT[1]), Some(PAINT[2]), Some(PAINT[3])];

fn observe(tracker: &mut Tracker, k: i64, data: &[u8]) -> MarkerObservations {
    tracker.handle(Input::Image(ImageView {
        stamp: Stamp::from_nanos(k * 33_333_333),
        width: WIDTH,
        height: HEIGHT,
        step: 3 * WIDTH,
        format: PixelFormat::Rgb8,
        data,
    }));
    match tracker.poll() {
        Some(Output::Observations(o)) => o,
        other => panic!("{other:?}"),
    }
}

fn new_tracker(config: TrackerConfig) -> Tracker {
    let mut tracker = Tracker::new(layout(), config);
    tracker.handle(Input::Camera(camera()));
    tracker
}

fn truth(color: MarkerColor, pose: &Isometry3<f64>) -> Vector2<f64> {
    layout().projected_centroid(color, &camera(), pose).unwrap().pixel
}

#[test]
fn clean_scenes_are_told_to_a_hundredth_of_a_pixel_from_the_first_image_on() {
    let (mut tracker, mut noise) = (new_tracker(TrackerConfig::default()), Noise(1));
    let (mut square, mut nes, mut n) = (Vector2::zeros(), 0.0, 0.0);
    for k in 0..12 {
        let pose = pose(0.033 * k as f64 * 3.0);
        let o = observe(&mut tracker, k, &draw(&pose, ALL, &mut noise));
        for (color, m) in o.markers.iter() {
            assert_eq!(m.state, MarkerState::Detected, "{color} in image {k}");
            let e = m.centroid - truth(color, &pose);
            square += e.component_mul(&e);
            nes += (e.transpose() * m.covariance.try_inverse().unwrap() * e)[0];
            n += 1.0;
        }
    }
    let rms = (square / n).map(f64::sqrt);
    eprintln!("clean scenes: rms {:.4} {:.4} px, normalised squared error {:.2}", rms.x, rms.y, nes / n);
    assert!(rms.x < 0.015 && rms.y < 0.015, "{rms}");
    assert!((1.2..=3.2).contains(&(nes / n)), "{}", nes / n);
}

#[test]
fn hidden_markers_are_predicted_for_six_images_then_lost_and_are_back_at_once() {
    let (mut tracker, mut noise) = (new_tracker(TrackerConfig::default()), Noise(2));
    for k in 0..24 {
        let pose = pose(0.033 * k as f64);
        let hidden = (5..15).contains(&k);
        let paint = if hidden { [ALL[0], None, ALL[2], ALL[3]] } else { ALL };
        let o = observe(&mut tracker, k, &draw(&pose, paint, &mut noise));
        let m = &o.markers[MarkerColor::Green];
        match k {
            5..11 => {
                assert_eq!((m.state, m.occluded_frames), (MarkerState::Predicted, (k - 4) as u16));
                assert!((m.centroid - truth(MarkerColor::Green, &pose)).norm() < 1.0);
            }
            11..15 => {
                assert_eq!((m.state, m.occluded_frames), (MarkerState::Lost, (k - 4) as u16));
                assert!(m.centroid.x.is_nan());
            }
            _ => assert_eq!((m.state, m.occluded_frames), (MarkerState::Detected, 0), "image {k}"),
        }
    }
}

#[test]
fn all_four_are_back_in_the_first_image_in_which_they_are_whole() {
    let (mut tracker, mut noise) = (new_tracker(TrackerConfig::default()), Noise(3));
    for k in 0..20 {
        let gone = (4..16).contains(&k);
        let o = observe(
            &mut tracker,
            k,
            &draw(&pose(0.05 * k as f64), if gone { [None; 4] } else { ALL }, &mut noise),
        );
        for (_, m) in o.markers.iter() {
            assert_eq!(m.state == MarkerState::Detected, !gone, "image {k}");
        }
    }
}

#[test]
fn either_criterion_switched_off_changes_the_result() {
    let run = |config: TrackerConfig, last: [Option<[f64; 3]>; 4]| {
        let (mut tracker, mut noise) = (new_tracker(config), Noise(4));
        for k in 0..4 {
            observe(&mut tracker, k, &draw(&pose(0.1 * k as f64), ALL, &mut noise));
        }
        observe(&mut tracker, 4, &draw(&pose(0.4), last, &mut noise)).markers
    };
    let on = TrackerConfig::default();
    // Without the flow a hidden marker is not carried along with the others.
    let hidden = [ALL[0], None, ALL[2], ALL[3]];
    let place = truth(MarkerColor::Green, &pose(0.4));
    let off = TrackerConfig { use_flow: false, ..on.clone() };
    let with = (run(on.clone(), hidden)[MarkerColor::Green].centroid - place).norm();
    let without = (run(off, hidden)[MarkerColor::Green].centroid - place).norm();
    assert!(with < 0.5 && without > 2.0 * with, "{with} px with the flow, {without} px without");
    // Without the hue a crimson square that takes the red one's place is taken for it.
    let other = [Some([150.0, 40.0, 90.0]), ALL[1], ALL[2], ALL[3]];
    let off = TrackerConfig { use_hue: false, ..on.clone() };
    assert_ne!(run(on, other)[MarkerColor::Red].state, MarkerState::Detected);
    assert_eq!(run(off, other)[MarkerColor::Red].state, MarkerState::Detected);
}

#[test]
fn what_was_seen_is_one_on_the_marker_and_nought_beside_it_and_bears_its_hue() {
    let mut tracker = new_tracker(TrackerConfig::default());
    assert!(tracker.seen(MarkerColor::Red).is_none());
    let pose = pose(0.0);
    observe(&mut tracker, 0, &draw(&pose, ALL, &mut Noise(5)));
    for (color, degrees) in MarkerColor::ALL.into_iter().zip([359.0, 119.0, 210.0, 47.0]) {
        let seen = tracker.seen(color).unwrap();
        let pixel = truth(color, &pose);
        let at = |p: Vector2<f64>| {
            let (x, y) = (p.x.round() as i32 - seen.origin[0], p.y.round() as i32 - seen.origin[1]);
            seen.signal[y as usize * seen.width + x as usize]
        };
        assert!((at(pixel) - 1.0).abs() < 0.3, "{color}: {}", at(pixel));
        let edge = seen.signal.iter().filter(|v| v.is_finite() && v.abs() < 0.3).count();
        assert!(edge > 50, "{color}: only {edge} pixels beside it");
        assert!((seen.hue.iter().sum::<f32>() - 1.0).abs() < 1e-3);
        let peak = (0..seen.hue.len()).max_by(|a, b| seen.hue[*a].total_cmp(&seen.hue[*b])).unwrap();
        let middle = (peak as f64 + 0.5) * 360.0 / seen.hue.len() as f64;
        let off = (middle - degrees + 180.0).rem_euclid(360.0) - 180.0;
        assert!(off.abs() < 12.0, "{color}: {middle} deg for {degrees}");
    }
}

#[test]
fn every_order_of_channels_gives_the_same() {
    let rgb = draw(&pose(0.0), ALL, &mut Noise(5));
    let reference = observe(&mut new_tracker(TrackerConfig::default()), 0, &rgb);
    for format in [PixelFormat::Bgr8, PixelFormat::Rgba8, PixelFormat::Bgra8] {
        let n = format.bytes_per_pixel();
        let step = n * WIDTH + 5;
        let mut data = vec![0; step * HEIGHT];
        for y in 0..HEIGHT {
            for x in 0..WIDTH {
                let mut p =
                    [rgb[3 * (y * WIDTH + x)], rgb[3 * (y * WIDTH + x) + 1], rgb[3 * (y * WIDTH + x) + 2]];
                if format.blue_first() {
                    p.reverse();
                }
                data[y * step + n * x..y * step + n * x + 3].copy_from_slice(&p);
            }
        }
        let mut tracker = new_tracker(TrackerConfig::default());
        let stamp = Stamp::from_nanos(0);
        tracker.handle(Input::Image(ImageView {
            stamp,
            width: WIDTH,
            height: HEIGHT,
            step,
            format,
            data: &data,
        }));
        let Some(Output::Observations(o)) = tracker.poll() else { panic!("{format:?}") };
        for (color, m) in o.markers.iter() {
            assert!((m.centroid - reference.markers[color].centroid).norm() < 1e-3, "{format:?} {color}");
        }
    }
}

#[test]
fn images_that_cannot_be_and_stamps_from_the_past_are_refused() {
    let mut tracker = new_tracker(TrackerConfig::default());
    let data = [0u8; 100];
    for (width, height, step) in
        [(0, 1, 0), (10, 10, 30), (10, 4, 29), (usize::MAX, 2, 30), (10, usize::MAX, 30)]
    {
        let stamp = Stamp::from_nanos(1);
        let view = ImageView { stamp, width, height, step, format: PixelFormat::Rgb8, data: &data };
        tracker.handle(Input::Image(view));
        assert!(matches!(tracker.poll(), Some(Output::Warning(Warning::Image(_)))), "{width}x{height}");
    }
    let tiny = |nanos| ImageView {
        stamp: Stamp::from_nanos(nanos),
        width: 5,
        height: 4,
        step: 15,
        format: PixelFormat::Rgb8,
        data: &data,
    };
    tracker.handle(Input::Image(tiny(10)));
    assert!(matches!(tracker.poll(), Some(Output::Observations(_))));
    tracker.handle(Input::Image(tiny(10)));
    assert!(matches!(tracker.poll(), Some(Output::Warning(Warning::StampFromThePast { .. }))));
}
