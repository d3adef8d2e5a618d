//! The published tracker (method paper) on rendered scenes.

#![cfg(feature = "opencv")]
#![allow(clippy::unwrap_used, clippy::panic)] // clippy does not recognize helpers of tests

mod common;

use common::{
    ALL, Noise, WIDTH, camera, draw, errors::Errors, image, in_other_formats, new_tracker, observe,
    pose, truth,
};
use marker_tracker::{BinaryThreshold, ImageView, Input, Method, Outcome, Output, TrackerConfig};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2};
use rig_model::{MarkerColor, MarkerObservations, MarkerState, PerColor, Rig};
use rig_simulator::{Covers, Exposure, Instant, RIG_YAML, Renderer, SceneConfig};

fn paper() -> TrackerConfig {
    let method = Method::Paper(BinaryThreshold::default());
    TrackerConfig { method, ..TrackerConfig::default() }
}

/// Images of the drawn scene, in which `paint(k)` says what is visible.
fn drawn(
    config: &TrackerConfig,
    count: i64,
    paint: impl Fn(i64) -> [Option<[f64; 3]>; 4],
) -> Vec<MarkerObservations> {
    let (mut tracker, mut noise) = (new_tracker(config.clone()), Noise(1));
    (0..count)
        .map(|k| observe(&mut tracker, k, &draw(&pose(0.033 * k as f64), paint(k), &mut noise)))
        .collect()
}

#[test]
fn markers_are_detected_within_a_pixel_with_an_honest_covariance() {
    let mut errors = Errors::default();
    for (k, o) in drawn(&paper(), 45, |_| ALL).iter().enumerate() {
        for (color, m) in o.markers.iter() {
            assert_eq!(m.state, MarkerState::Detected, "{color} in image {k}");
            errors.add(m, truth(color, &pose(0.033 * k as f64)));
            assert!((500.0..2500.0).contains(&m.area), "{color}: {} px²", m.area);
        }
    }
    let (rms, nes) = (errors.rms_per_axis(), errors.nes());
    eprintln!("published tracker, drawn scene: {errors}");
    assert!(rms < 0.5 && nes < 3.0, "RMS {rms} px, normalized squared error {nes}");
}

#[test]
fn a_hidden_marker_moves_with_the_mean_flow_of_the_others_for_six_images() {
    let green_gone = |k| if k < 6 { ALL } else { [ALL[0], None, ALL[2], ALL[3]] };
    let images = drawn(&paper(), 16, green_gone);
    for (k, o) in images.iter().enumerate().skip(6) {
        let m = &o.markers[MarkerColor::Green];
        let hidden = k as u16 - 5;
        assert_eq!(m.occluded_frames, hidden, "image {k}");
        if hidden > 6 {
            assert_eq!(m.state, MarkerState::Lost, "image {k}");
            continue;
        }
        assert_eq!(m.state, MarkerState::Predicted, "image {k}");
        // Eq. 3, with each visible marker's displacement for its flow.
        let before = &images[k - 1].markers;
        let others = [MarkerColor::Red, MarkerColor::Blue, MarkerColor::Yellow];
        let mean = others
            .iter()
            .map(|c| o.markers[*c].centroid - before[*c].centroid)
            .sum::<Vector2<f64>>()
            / 3.0;
        let moved = m.centroid - before[MarkerColor::Green].centroid;
        assert!((moved - mean).norm() < 0.6, "image {k}: {moved} instead of {mean}");
        let sigma = m.covariance[(0, 0)].sqrt();
        let error = (m.centroid - truth(MarkerColor::Green, &pose(0.033 * k as f64))).norm();
        assert!(error < 3.0 * sigma, "image {k}: {error} px off, sigma {sigma}");
    }
    // Without the flow it stays where it was.
    let off = TrackerConfig { use_flow: false, ..paper() };
    let images = drawn(&off, 8, green_gone);
    let at = |k: usize| images[k].markers[MarkerColor::Green];
    assert_eq!((at(7).state, at(7).centroid), (MarkerState::Predicted, at(5).centroid));
}

#[test]
fn with_two_hidden_markers_none_is_predicted() {
    let images = drawn(&paper(), 14, |k| match k {
        0..5 => ALL,
        5..8 => [ALL[0], None, None, ALL[3]],
        8..10 => [ALL[0], None, ALL[2], ALL[3]],
        _ => ALL,
    });
    for (k, o) in images.iter().enumerate() {
        let state = |color| o.markers[color].state;
        let [green, blue] = match k {
            5..8 => [MarkerState::Lost; 2],
            // Hidden for four and five images, alone in the last two.
            8..10 => [MarkerState::Predicted, MarkerState::Detected],
            _ => [MarkerState::Detected; 2],
        };
        assert_eq!(state(MarkerColor::Red), MarkerState::Detected, "image {k}");
        assert_eq!(state(MarkerColor::Yellow), MarkerState::Detected, "image {k}");
        assert_eq!([state(MarkerColor::Green), state(MarkerColor::Blue)], [green, blue], "{k}");
        if (5..8).contains(&k) {
            let m = &o.markers[MarkerColor::Green];
            assert!(m.centroid.x.is_nan() && m.occluded_frames == k as u16 - 4, "image {k}");
        }
    }
}

#[test]
fn every_pixel_format_gives_the_same_observations() {
    let rgb = draw(&pose(0.0), ALL, &mut Noise(5));
    in_other_formats(&paper(), &rgb, |format, reference, found| {
        assert_eq!(found, reference, "{format:?}");
    });
}

#[test]
fn a_changed_image_size_and_tiny_images_are_no_error() {
    let mut tracker = new_tracker(paper());
    let data = draw(&pose(0.0), ALL, &mut Noise(5));
    let sizes = [(640, 480), (320, 480), (1, 1), (2, 300), (300, 2), (640, 480)];
    for (i, (width, height)) in sizes.into_iter().enumerate() {
        let view = ImageView { width, height, ..image(i as i64, &data) };
        tracker.handle(Input::Image(view));
        assert!(matches!(tracker.poll(), Some(Output::Observations(_))), "{width}x{height}");
        assert!(tracker.poll().is_none(), "{width}x{height}");
    }
}

#[test]
fn an_image_without_color_has_no_marker_and_the_next_colored_one_has_all() {
    let mut tracker = new_tracker(paper());
    let mut noise = Noise(5);
    let mut gray = draw(&pose(0.0), ALL, &mut noise);
    for pixel in gray.chunks_exact_mut(3) {
        pixel.fill(pixel[1]);
    }
    for (k, image) in [&gray, &gray, &draw(&pose(0.0), ALL, &mut noise)].into_iter().enumerate() {
        let state = if k < 2 { MarkerState::Lost } else { MarkerState::Detected };
        for (color, m) in observe(&mut tracker, k as i64, image).markers.iter() {
            assert_eq!(m.state, state, "{color} in image {k}");
        }
    }
}

/// Images of a flight over a floor on which things of the markers' colors lie: camera and platform
/// move together. The red marker is hidden by a plank from the image `hidden` on.
fn flight(seed: u64, count: usize, hidden: usize) -> Vec<(Vec<u8>, PerColor<Vector2<f64>>)> {
    let rig = Rig::from_yaml(RIG_YAML).unwrap();
    let scene = SceneConfig { seed, clutter: true, ..SceneConfig::default() };
    let mut renderer = Renderer::new(camera(), &rig, scene);
    (0..count)
        .map(|k| {
            let t = k as f64 / 30.0;
            let world_from_climber = Translation3::new(0.5 * t - 0.4, 0.2 * t, 2.8).into();
            let sway = Translation3::new(0.03 * (4.0 * t).sin(), 0.03 * (3.0 * t).cos(), 0.0);
            let world_from_volant = Isometry3::from_parts(
                sway * Translation3::new(0.5 * t - 0.4, 0.2 * t, 1.4),
                UnitQuaternion::from_euler_angles(0.05 * (4.0 * t).sin(), 0.0, 0.3),
            );
            let instant = Instant { world_from_climber, world_from_volant };
            let mut covers = Covers::default();
            covers[MarkerColor::Red] = if k < hidden { 0.0 } else { 1.0 };
            let noise = Some(k as u64);
            let image =
                renderer.render(&Exposure { instants: vec![instant], covers, seconds: t, noise });
            let pose = (world_from_climber * rig.climber_from_camera).inverse() * world_from_volant;
            let truth = PerColor::from_fn(|color| {
                rig.markers.projected_centroid(color, &camera(), &pose).unwrap().pixel
            });
            (image.data, truth)
        })
        .collect()
}

/// Number of detections that are not the marker: more than 5 px off, or while red is hidden.
fn wrong(
    images: &[(Vec<u8>, PerColor<Vector2<f64>>)],
    hidden: usize,
    config: &TrackerConfig,
) -> usize {
    let mut tracker = new_tracker(config.clone());
    let mut wrong = 0;
    for (k, (data, truth)) in images.iter().enumerate() {
        for (color, m) in observe(&mut tracker, k as i64, data).markers.iter() {
            let is_visible = color != MarkerColor::Red || k < hidden;
            let is_right = is_visible && (m.centroid - truth[color]).norm() < 5.0;
            wrong += usize::from(m.state == MarkerState::Detected && !is_right);
        }
    }
    wrong
}

#[test]
fn without_the_flow_things_on_the_floor_are_taken_for_markers() {
    let off = TrackerConfig { use_flow: false, ..paper() };
    let (mut with, mut without) = (0, 0);
    for seed in [3, 4] {
        let images = flight(seed, 60, 30);
        let counts = [wrong(&images, 30, &paper()), wrong(&images, 30, &off)];
        eprintln!(
            "floor {seed}: wrong detections {} with the flow, {} without",
            counts[0], counts[1]
        );
        with += counts[0];
        without += counts[1];
    }
    assert!(without >= 3 * with + 20, "{with} with the flow, {without} without");
}

#[test]
fn without_the_hue_a_thing_that_moves_with_the_camera_is_taken_for_a_marker() {
    let mut images = flight(2, 56, 30);
    // Magenta is bright in the red layer, R − G.
    for (data, _) in &mut images {
        for y in 60..96 {
            for x in 80..116 {
                data[3 * (y * WIDTH + x)..][..3].copy_from_slice(&[190, 60, 150]);
            }
        }
    }
    let off = TrackerConfig { use_hue: false, ..paper() };
    let (with, without) = (wrong(&images, 30, &paper()), wrong(&images, 30, &off));
    eprintln!("thing beside the camera: wrong detections {with} with the hue, {without} without");
    assert!(without >= with + 15, "{with} with the hue, {without} without");
}

#[test]
fn two_runs_are_identical_and_use_one_thread() {
    let run = || {
        let gone = |k| if k > 8 { [ALL[0], None, ALL[2], ALL[3]] } else { ALL };
        // As text, because the NaN of a lost marker is not equal to itself.
        format!("{:?}", drawn(&paper(), 18, gone))
    };
    assert_eq!(run(), run());
    assert_eq!(opencv::core::get_num_threads().unwrap(), 1);
}

#[test]
fn settings_change_while_the_method_stays() {
    let mut tracker = new_tracker(paper());
    let mut noise = Noise(2);
    observe(&mut tracker, 0, &draw(&pose(0.0), ALL, &mut noise));
    tracker.set_config(TrackerConfig { max_predicted: 0, ..TrackerConfig::default() });
    let o =
        observe(&mut tracker, 1, &draw(&pose(0.03), [ALL[0], None, ALL[2], ALL[3]], &mut noise));
    // The outline method would name what it found; this one has none and predicts for no image.
    assert_eq!(o.markers[MarkerColor::Green].state, MarkerState::Lost);
    let view = tracker.views()[MarkerColor::Red];
    assert!(view.outcome == Outcome::Whole && view.outline.is_none());
}
