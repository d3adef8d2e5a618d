//! Real images of a ceiling camera: patches of red, green, blue and yellow paper, found in a video.

#![allow(clippy::unwrap_used, clippy::panic)] // clippy does not recognize helpers of tests

use marker_tracker::{OwnedImage, Patch, PixelFormat, decode_compressed, find_patches};
use nalgebra::Vector2;
use rig_model::{MarkerColor, Stamp};
use std::{
    io::Read,
    path::PathBuf,
    process::{Command, Stdio},
};

fn folder() -> Option<PathBuf> {
    Some(test_support::recordings()?.join("data/colour"))
}

/// Patches in the first image, located by eye: color and center, px. Pink paper has red's hue. (A
/// pale blue one at (112, 232), half below a robot's body, is no square.)
const FIRST: [(MarkerColor, f64, f64); 8] = [
    (MarkerColor::Blue, 204.0, 106.0),
    (MarkerColor::Green, 214.0, 118.0),
    (MarkerColor::Yellow, 458.0, 39.0),
    (MarkerColor::Red, 469.0, 50.0),
    (MarkerColor::Yellow, 529.0, 203.0),
    (MarkerColor::Red, 520.0, 215.0),
    (MarkerColor::Blue, 219.0, 366.0),
    (MarkerColor::Red, 226.0, 380.0),
];

/// Centers (px) in image 450 of the two patches that a rod pushes.
const MOVED: [(usize, f64, f64); 2] = [(0, 336.0, 112.0), (1, 327.0, 125.0)];

/// Whether a patch of this color is at most `reach` px from a place.
fn is_found(patches: &[Patch], color: MarkerColor, (x, y): (f64, f64), reach: f64) -> bool {
    let place = Vector2::new(x, y);
    patches.iter().any(|p| p.color == color && (p.centroid - place).norm() < reach)
}

#[test]
fn every_patch_is_found_throughout_the_video() {
    let Some(folder) = folder() else { return };
    let video = folder.join("robot_move.mp4");
    let child = Command::new("ffmpeg")
        .args(["-v", "error", "-i"])
        .arg(&video)
        .args(["-f", "rawvideo", "-pix_fmt", "rgb24", "-"])
        .stdout(Stdio::piped())
        .spawn();
    let Ok(mut child) = child else {
        test_support::skip("ffmpeg, which decodes the video, is not installed");
        return;
    };
    let mut pipe = child.stdout.take().unwrap();
    let (width, height, step, format) = (632, 468, 3 * 632, PixelFormat::Rgb8);
    let mut image = OwnedImage { width, height, step, format, data: vec![0; step * height] };
    let mut found = [0usize; FIRST.len()];
    let mut images = 0;
    while pipe.read_exact(&mut image.data).is_ok() {
        let patches = find_patches(&image.view(Stamp::default()), 60.0).unwrap();
        for (count, (color, x, y)) in found.iter_mut().zip(FIRST) {
            assert!(
                images > 0 || is_found(&patches, color, (x, y), 4.0),
                "{color} at ({x}, {y}) is not among {patches:?}"
            );
            // A patch at rest does not move, but its shade does a little.
            *count += usize::from(is_found(&patches, color, (x, y), 5.0));
        }
        if images == 450 {
            for (k, x, y) in MOVED {
                let color = FIRST[k].0;
                let is_there = is_found(&patches, color, (x, y), 3.0);
                assert!(is_there, "{color} at ({x}, {y}) is not among {patches:?}");
            }
        }
        images += 1;
    }
    child.wait().unwrap();
    assert_eq!(images, 502);
    for (k, (color, x, y)) in FIRST.iter().enumerate() {
        let share = found[k] as f64 / images as f64;
        eprintln!("{color} at ({x}, {y}): found in {share:.3} of the images");
        // The hand covers the ones that it passes.
        let is_still = !MOVED.iter().any(|m| m.0 == k);
        assert!(!is_still || share > 0.8, "{color} at ({x}, {y}): {share:.3}");
    }
}

#[test]
fn the_patches_of_a_still_image_are_found() {
    let Some(folder) = folder() else { return };
    let bytes = std::fs::read(folder.join("field_640x480.png")).unwrap();
    let image = decode_compressed("png", &bytes).unwrap();
    let patches = find_patches(&image.view(Stamp::default()), 40.0).unwrap();
    for color in [MarkerColor::Blue, MarkerColor::Green, MarkerColor::Yellow] {
        let count = patches.iter().filter(|p| p.color == color).count();
        eprintln!("{color}: {count} patches");
        assert!(count >= 1, "no {color} patch among {patches:?}");
    }
}
