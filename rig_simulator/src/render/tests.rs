//! Rendered centroids are the projected ones; the same seed gives the same bytes.

use super::*;
use nalgebra::{Translation3, UnitQuaternion};
use rig_model::Distortion;

const RIG: &str = "/**:
  ros__parameters:
    camera: {position: [0.0, 0.0, -0.10], orientation: [0.70710678, 0.70710678, 0.0, 0.0]}
    markers:
      {size: 0.076, red: [0.15, 0.15, 0.02], green: [-0.15, 0.15, 0.02],
      blue: [-0.15, -0.15, 0.02], yellow: [0.15, -0.15, 0.02]}
";

pub fn camera() -> CameraModel {
    let lens = Distortion::PlumbBob([-0.23, 0.08, 7e-4, -4e-4, -0.006]);
    CameraModel::new(640, 480, [590.0, 588.0, 319.3, 235.2], lens).unwrap()
}

fn instant(x: f64, y: f64, z: f64, roll: f64, pitch: f64, yaw: f64) -> Instant {
    Instant {
        world_from_climber: Isometry3::from_parts(
            Translation3::new(0.1, -0.2, 2.8),
            UnitQuaternion::identity(),
        ),
        world_from_volant: Isometry3::from_parts(
            Translation3::new(x, y, z),
            UnitQuaternion::from_euler_angles(roll, pitch, yaw),
        ),
    }
}

/// A scene in which an image's colors are linear in the covered share of a pixel.
fn plain() -> SceneConfig {
    SceneConfig {
        vignetting: 0.0,
        colours: Some([
            [190.0, 0.0, 0.0],
            [0.0, 190.0, 0.0],
            [0.0, 0.0, 190.0],
            [190.0, 190.0, 0.0],
        ]),
        // The rope hangs down, so that it crosses no square.
        hoist: Point3::new(-0.1, 0.2, -2.7),
        ..SceneConfig::default()
    }
}

/// Centroid of a square in the image: pixels weighted by their share of the marker's color, before
/// rounding to eight bits.
fn centroid(
    renderer: &Renderer,
    color: MarkerColor,
    near: Vector2<f64>,
    area: f64,
) -> Vector2<f64> {
    let (mut weight, mut sum) = (0.0, Vector2::zeros());
    // Wide enough for a turned square, narrow enough to stay on the plate.
    let reach = (0.85 * area.sqrt()) as i64;
    for dy in -reach..=reach {
        for dx in -reach..=reach {
            if dx * dx + dy * dy > reach * reach {
                continue;
            }
            let (x, y) = (near.x.round() as i64 + dx, near.y.round() as i64 + dy);
            let [r, g, b] = renderer.canvas[y as usize * 640 + x as usize].map(f64::from);
            // The plate is gray (its blue 2 % above), so this difference is zero on it and full on
            // the square.
            let w = match color {
                MarkerColor::Red => r - g,
                MarkerColor::Green => g - r,
                MarkerColor::Blue => b - 1.02 * r,
                MarkerColor::Yellow => g - b / 1.02,
            };
            weight += w;
            sum += Vector2::new(x as f64, y as f64) * w;
        }
    }
    sum / weight
}

fn rig() -> Rig {
    Rig::from_yaml(RIG).unwrap()
}

/// A renderer of the plain scene without grain on the plate, which would weigh the pixels.
fn without_grain() -> Renderer {
    let mut renderer = Renderer::new(camera(), &rig(), plain());
    for piece in &mut renderer.platform.pieces {
        piece.grain = 0.0;
    }
    renderer
}

/// An exposure without covers and noise.
fn exposure(instants: Vec<Instant>) -> Exposure {
    Exposure { instants, covers: Covers::default(), seconds: 0.0, noise: None }
}

/// Asserts that each marker's centroid in the canvas is at most `limit` px off the projected one.
fn assert_centroids(renderer: &Renderer, at: &Instant, limit: f64) {
    let rig = rig();
    let camera_from_volant =
        (at.world_from_climber * rig.climber_from_camera).inverse() * at.world_from_volant;
    for color in MarkerColor::ALL {
        let truth =
            rig.markers.projected_centroid(color, renderer.camera(), &camera_from_volant).unwrap();
        let off = (centroid(renderer, color, truth.pixel, truth.area) - truth.pixel).norm();
        assert!(off < limit, "{color} at {}: {off} px off", at.world_from_volant);
    }
}

#[test]
fn rendered_centroids_are_the_projected_ones_to_a_hundredth_of_a_pixel() {
    let mut renderer = without_grain();
    for (x, y, z, roll, pitch, yaw) in [
        (0.1, -0.2, 1.5, 0.0, 0.0, 0.0),
        (0.2, -0.1, 1.4, 0.3, -0.2, 0.5),
        (-0.1, -0.3, 1.1, -0.35, 0.25, -0.4),
        (0.3, 0.0, 0.9, 0.1, 0.5, 0.2),
    ] {
        let at = instant(x, y, z, roll, pitch, yaw);
        let _ = renderer.render(&exposure(vec![at]));
        assert_centroids(&renderer, &at, 0.01);
    }
}

#[test]
fn blur_keeps_the_centroid_of_the_middle_of_the_exposure() {
    let mut renderer = without_grain();
    let at = |t: f64| instant(0.1 + 0.008 * t, -0.2, 1.4, 0.1, 0.0, 0.3);
    let instants = (-2..=2).map(|i| at(f64::from(i) / 4.0)).collect();
    let _ = renderer.render(&exposure(instants));
    assert_centroids(&renderer, &at(0.0), 0.01);
}

#[test]
fn a_plank_hides_its_marker_and_no_other() {
    let mut renderer = Renderer::new(camera(), &rig(), plain());
    let mut exposure = exposure(vec![instant(0.15, -0.15, 1.4, 0.1, 0.05, 0.3)]);
    let bare = renderer.render(&exposure);
    exposure.covers[MarkerColor::Green] = 1.0;
    let covered = renderer.render(&exposure);
    let strength = |image: &RgbImage, color: MarkerColor| {
        let count = image
            .data
            .chunks_exact(3)
            .filter(|p| {
                let [r, g, b] = [p[0], p[1], p[2]].map(i32::from);
                match color {
                    MarkerColor::Red => r - g > 100 && r - b > 100,
                    MarkerColor::Green => g - r > 100,
                    MarkerColor::Blue => b - r > 100,
                    MarkerColor::Yellow => r - b > 100 && g - b > 100,
                }
            })
            .count();
        count as f64
    };
    for color in MarkerColor::ALL {
        let left = strength(&covered, color) / strength(&bare, color);
        assert_eq!(left, if color == MarkerColor::Green { 0.0 } else { 1.0 }, "{color}");
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_the_configured_noise() {
    let scene = || SceneConfig {
        read_noise: 2.0,
        shot_noise: 0.0,
        clutter: true,
        ..SceneConfig::default()
    };
    let mut renderer = Renderer::new(camera(), &rig(), scene());
    let mut exposure = Exposure {
        seconds: 1.0,
        noise: Some(5),
        ..exposure(vec![instant(0.1, -0.2, 1.4, 0.2, 0.1, 0.3)])
    };
    let noisy = renderer.render(&exposure);
    assert_eq!(noisy, Renderer::new(camera(), &rig(), scene()).render(&exposure));
    exposure.noise = None;
    let clean = renderer.render(&exposure);
    let n = clean.data.len() as f64;
    let variance: f64 = clean
        .data
        .iter()
        .zip(&noisy.data)
        .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
        .sum::<f64>()
        / n;
    // Rounding to eight bits adds 1/12 twice.
    assert!((variance - 4.0 - 1.0 / 6.0).abs() < 0.15, "{variance}");
    assert!(noisy.to_jpeg(90).unwrap().starts_with(&[0xff, 0xd8]));
}

#[test]
fn a_jpeg_keeps_the_centroids() {
    let mut renderer = without_grain();
    let at = instant(0.1, -0.2, 1.5, 0.1, 0.05, 0.3);
    let image = renderer.render(&exposure(vec![at]));
    let decoded = marker_tracker::decode_compressed("jpeg", &image.to_jpeg(90).unwrap()).unwrap();
    for (to, from) in renderer.canvas.iter_mut().zip(decoded.data.chunks_exact(3)) {
        *to = [f32::from(from[0]), f32::from(from[1]), f32::from(from[2])];
    }
    assert_centroids(&renderer, &at, 0.06);
}
