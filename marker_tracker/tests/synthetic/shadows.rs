//! Shadow edges across the markers: of a wall that sweeps over the scene, and of the rope.

use super::common::errors::Errors;
use marker_tracker::{Input, Output, Tracker, TrackerConfig, decode_compressed};
use nalgebra::{Point3, Vector2};
use rig_model::{CameraModel, Distortion, MarkerColor, PerColor, Rig, Stamp};
use rig_simulator::{
    Exposure, Instant, RIG_YAML, Renderer, SceneConfig, Shadow,
    motion::{Motion, MotionConfig},
};

/// Upper bounds of the shadowed share of a marker's area, and the classes' names.
const CLASSES: [(f64, &str); 6] = [
    (0.02, "none"),
    (0.1, "2-10 %"),
    (0.3, "10-30 %"),
    (0.7, "30-70 %"),
    (0.98, "70-98 %"),
    (2.0, "all"),
];

/// Share of a marker's area that the shadow darkens by more than half of its depth.
fn shadowed(shadow: &Shadow, rig: &Rig, color: MarkerColor, at: &Instant, seconds: f64) -> f64 {
    const N: i32 = 40;
    let center = rig.markers.centers[color];
    let platform = at.world_from_volant.translation.vector.xy().cast::<f32>();
    let dark = (0..N * N)
        .filter(|i| {
            let offset = |k: i32| ((f64::from(k) + 0.5) / f64::from(N) - 0.5) * rig.markers.side;
            let point = Point3::new(center.x + offset(i % N), center.y + offset(i / N), center.z);
            let place = (at.world_from_volant * point).coords.xy().cast::<f32>();
            let light = shadow.light_at(place, platform, seconds, 1e-4)[0];
            light < 0.5 + 0.5 * shadow.light[0]
        })
        .count();
    f64::from(dark as u32) / f64::from(N * N)
}

/// Tracks 60 images (30 Hz) of a swing under a shadow; adds to the scores by the shadowed share.
fn sweep(seed: u64, shadow: Shadow, scores: &mut [Errors; CLASSES.len()]) {
    let rig = Rig::from_yaml(RIG_YAML).unwrap();
    let lens = Distortion::PlumbBob([-0.23, 0.08, 7e-4, -4e-4, -0.006]);
    let camera = CameraModel::new(640, 480, [590.0, 588.0, 319.3, 235.2], lens).unwrap();
    let motion = Motion::new(MotionConfig::nominal(seed));
    // So far behind the camera that the rope itself is not drawn: it covers no marker.
    let hoist = Point3::new(0.0, 0.0, 1000.0);
    let scene = SceneConfig { seed, hoist, shadows: vec![shadow], ..SceneConfig::default() };
    let mut renderer = Renderer::new(camera.clone(), &rig, scene);
    let mut tracker = Tracker::new(rig.markers.clone(), TrackerConfig::default());
    tracker.handle(Input::Camera(camera.clone()));
    for k in 0..60u32 {
        let seconds = f64::from(k) / 30.0;
        let instant = |t: f64| Instant {
            world_from_climber: motion.world_from_climber(t),
            world_from_volant: motion.world_from_volant(t),
        };
        let image = renderer.render(&Exposure {
            instants: [-0.003, 0.0, 0.003].map(|d| instant(seconds + d)).to_vec(),
            covers: PerColor([0.0; 4]),
            seconds,
            noise: Some(seed * 1000 + u64::from(k)),
        });
        let image = decode_compressed("jpeg", &image.to_jpeg(90).unwrap()).unwrap();
        tracker.handle(Input::Image(image.view(Stamp::from_nanos(i64::from(k) * 33_333_333))));
        let Some(Output::Observations(o)) = tracker.poll() else { panic!("image {k}") };
        let at = instant(seconds);
        let pose = motion.world_from_camera(seconds, &rig).inverse() * at.world_from_volant;
        for (color, m) in o.markers.iter() {
            let truth = rig.markers.projected_centroid(color, &camera, &pose).unwrap().pixel;
            let inside = |v: Vector2<f64>| v.x > 30.0 && v.y > 30.0 && v.x < 610.0 && v.y < 450.0;
            if !inside(truth) {
                continue;
            }
            let share = shadowed(&shadow, &rig, color, &at, seconds);
            let class = CLASSES.iter().position(|(limit, _)| share < *limit).unwrap();
            scores[class].show(m, truth);
        }
    }
}

/// Asserts that under eight shadows the markers of each class are detected, precisely and
/// consistently. `shadow`: of a light and a direction (rad).
fn assert_measured(name: &str, lights: [f32; 3], shadow: impl Fn(f32, f32) -> Shadow) {
    let mut scores = [Errors::default(); CLASSES.len()];
    for seed in 0..8u64 {
        let shadow = shadow(lights[seed as usize % 3], seed as f32 * 0.7);
        sweep(seed + 1, shadow, &mut scores);
    }
    for ((_, class), score) in CLASSES.iter().zip(&scores) {
        eprintln!("{name:5} {class:8} {score}");
    }
    for ((_, class), score) in CLASSES.iter().zip(scores).filter(|(_, s)| s.shown > 0) {
        assert!(score.share() >= 0.97, "{class}: {score}");
        assert!(score.rms_per_axis() <= 0.12, "{class}: {score}");
        assert!(score.nes() <= 2.8, "{class}: {score}");
    }
}

#[test]
fn markers_under_the_edge_of_a_walls_shadow_are_measured() {
    assert_measured("wall", [0.35, 0.5, 0.65], |light, direction| {
        Shadow::half_plane(light, direction, -0.45, 0.45)
    });
}

#[test]
fn markers_under_the_ropes_shadow_are_measured() {
    assert_measured("rope", [0.6, 0.75, 0.85], |light, direction| {
        Shadow::rope(light, direction, -0.22, 0.22)
    });
}
