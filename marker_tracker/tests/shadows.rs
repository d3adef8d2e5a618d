//! Shadow edges across the markers: of a wall that sweeps over the scene, and of the rope.

#![allow(clippy::unwrap_used, clippy::panic)] // clippy does not recognize helpers of tests

use marker_tracker::{Input, Output, Tracker, TrackerConfig, decode_compressed};
use nalgebra::{Point3, Vector2};
use rig_model::{CameraModel, Distortion, MarkerColor, MarkerState, PerColor, Rig, Stamp};
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

#[derive(Clone, Copy, Default)]
struct Score {
    markers: usize,
    detected: usize,
    /// Σ of the squared errors of both coordinates, px².
    square: f64,
    variance: f64,
    /// Σ of the normalized squared errors.
    nes: f64,
}

impl Score {
    fn add(&mut self, other: &Self) {
        self.markers += other.markers;
        self.detected += other.detected;
        self.square += other.square;
        self.variance += other.variance;
        self.nes += other.nes;
    }
    fn share(&self) -> f64 {
        self.detected as f64 / self.markers.max(1) as f64
    }
    fn rms(&self) -> f64 {
        (self.square / (2 * self.detected.max(1)) as f64).sqrt()
    }
    fn normalized(&self) -> f64 {
        self.nes / self.detected.max(1) as f64
    }
    fn text(&self) -> String {
        let n = self.detected.max(1) as f64;
        format!(
            "{:5} markers, {:5.1} % detected, {:.3} px RMS per axis, sigma {:.3} px, \
             normalized squared error {:.2}",
            self.markers,
            100.0 * self.share(),
            self.rms(),
            (self.variance / n).sqrt(),
            self.normalized(),
        )
    }
}

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

/// Tracks 60 images (30 Hz) of a swing under a shadow; scores by the shadowed share.
fn sweep(seed: u64, shadow: Shadow) -> [Score; CLASSES.len()] {
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
    let mut scores = [Score::default(); CLASSES.len()];
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
            let score = &mut scores[class];
            score.markers += 1;
            if m.state == MarkerState::Detected {
                let e = m.centroid - truth;
                score.detected += 1;
                score.square += e.norm_squared();
                score.variance += m.covariance.trace() / 2.0;
                score.nes += (e.transpose() * m.covariance.try_inverse().unwrap() * e)[0];
            }
            if std::env::var("VERBOSE").is_ok() {
                let e = m.centroid - truth;
                eprintln!(
                    "{seed} {k:3} {color:6} {share:.2} {:?} {:.3} {:.3} sigma {:.3} {}",
                    m.state,
                    e.x,
                    e.y,
                    (m.covariance.trace() / 2.0).sqrt(),
                    tracker.outcomes()[color]
                );
            }
        }
    }
    scores
}

fn total(name: &str, shadows: impl Iterator<Item = (u64, Shadow)>) -> [Score; CLASSES.len()] {
    let mut scores = [Score::default(); CLASSES.len()];
    for (seed, shadow) in shadows {
        for (sum, score) in scores.iter_mut().zip(sweep(seed, shadow)) {
            sum.add(&score);
        }
    }
    for ((_, class), score) in CLASSES.iter().zip(&scores) {
        eprintln!("{name:5} {class:8} {}", score.text());
    }
    scores
}

/// Asserts that the markers of each class are detected, precisely and consistently.
fn assert_measured(scores: &[Score]) {
    for ((_, class), score) in CLASSES.iter().zip(scores).filter(|(_, s)| s.markers > 0) {
        assert!(score.share() >= 0.97, "{class}: {}", score.text());
        assert!(score.rms() <= 0.12, "{class}: {}", score.text());
        assert!(score.normalized() <= 2.8, "{class}: {}", score.text());
    }
}

#[test]
fn markers_under_the_edge_of_a_walls_shadow_are_measured() {
    let walls = (0..8u64).map(|seed| {
        let light = [0.35, 0.5, 0.65][seed as usize % 3];
        let direction = seed as f32 * 0.7;
        (seed + 1, Shadow::half_plane(light, direction, -0.45, 0.45))
    });
    assert_measured(&total("wall", walls));
}

#[test]
fn markers_under_the_ropes_shadow_are_measured() {
    let ropes = (0..8u64).map(|seed| {
        let light = [0.6, 0.75, 0.85][seed as usize % 3];
        let direction = seed as f32 * 0.7;
        (seed + 1, Shadow::rope(light, direction, -0.22, 0.22))
    });
    assert_measured(&total("rope", ropes));
}
