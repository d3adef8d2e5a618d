//! A marker that is covered in part: it is not measured, and as soon as it is whole it is.

use super::common::{ALL, HEIGHT, Noise, WIDTH, draw, new_tracker, observe, pose, truth};
use marker_tracker::TrackerConfig;
use nalgebra::Vector2;
use rig_model::{MarkerColor, MarkerState};

/// Half the side of a marker in these scenes, px.
const HALF: f64 = 18.2;

/// Covers what lies from `edge` px to `end` px from a marker's center in the direction `angle`.
fn cover(data: &mut [u8], center: Vector2<f64>, angle: f64, edge: f64, end: f64) {
    let across = Vector2::new(angle.cos(), angle.sin());
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let place = Vector2::new(x as f64, y as f64) - center;
            if place.norm() < 45.0 {
                let along = place.dot(&across);
                let share =
                    (along - edge + 0.5).clamp(0.0, 1.0).min((end - along + 0.5).clamp(0.0, 1.0));
                for (value, own) in data[3 * (y * WIDTH + x)..][..3].iter_mut().zip([98, 84, 70]) {
                    *value = (f64::from(*value) * (1.0 - share) + f64::from(own) * share) as u8;
                }
            }
        }
    }
}

#[test]
fn a_marker_first_seen_in_part_is_detected_as_soon_as_it_is_whole() {
    let (mut whole, mut missed) = (0, 0);
    let (mut cut, mut measured) = (0, 0);
    for case in 0..24u32 {
        let (mut tracker, mut noise) = (new_tracker(TrackerConfig::default()), Noise(case.into()));
        // A plank that is pushed away along one of the marker's sides, or obliquely.
        let offset = [0.0, 0.15, 0.8][case as usize % 3];
        let first = -14.0 + 4.0 * f64::from(case % 8);
        let speed = [0.9, 1.5, 5.0][case as usize / 8];
        for k in 0..40u32 {
            let pose = pose(1.7 * f64::from(case) + 0.033 * f64::from(k));
            let center = truth(MarkerColor::Red, &pose);
            let side = truth(MarkerColor::Green, &pose) - center;
            let angle = side.y.atan2(side.x) + offset;
            let edge = first + speed * f64::from(k);
            let mut data = draw(&pose, ALL, &mut noise);
            cover(&mut data, center, angle, edge, f64::INFINITY);
            let o = observe(&mut tracker, k.into(), &data);
            let m = &o.markers[MarkerColor::Red];
            let detected = m.state == MarkerState::Detected;
            // The cover is also clear of the band beside the edges in which the level is measured.
            let reach = HALF * ((offset + 0.1).cos() + (offset + 0.1).sin()).max(1.1);
            let is_whole = edge > reach + 5.0;
            if is_whole {
                whole += 1;
                missed += usize::from(!detected);
            }
            let inner = HALF * (offset.cos() - offset.sin());
            if edge.abs() < inner - 4.0 {
                cut += 1;
                measured += usize::from(detected);
            }
        }
    }
    assert!(cut > 100 && measured == 0, "{measured} of {cut} images of a cut marker measured");
    eprintln!("{missed} of {whole} images of the whole marker missed");
    // One case of 24 remains, in which an acquisition of three markers precedes: 1.5 % of the
    // images.
    assert!(missed * 50 <= whole, "{missed} of {whole} missed");
}

/// Number of images, number of measurements and largest error (px) of the red marker, while a pole
/// covers it and after that. The pole is `first` px before its center in the first image.
fn behind_a_pole(case: u32, first: f64) -> [(usize, usize, f64); 2] {
    let (mut tracker, mut noise) = (new_tracker(TrackerConfig::default()), Noise(case.into()));
    let width = 6.0 + 2.0 * f64::from(case % 4);
    let mut seen = [(0, 0, 0.0f64); 2];
    for k in 0..u32::try_from((40.0 - first) as i32).unwrap_or(0) {
        let pose = pose(2.3 * f64::from(case) + 0.033 * f64::from(k));
        let center = truth(MarkerColor::Red, &pose);
        let edge = first + 1.2 * f64::from(k);
        let mut data = draw(&pose, ALL, &mut noise);
        cover(&mut data, center, 0.4 * f64::from(case), edge, edge + width);
        let o = observe(&mut tracker, k.into(), &data);
        let m = &o.markers[MarkerColor::Red];
        let behind = edge < HALF - 4.0 && edge + width > 4.0 - HALF;
        let passed = edge > 1.5 * HALF + 5.0;
        for ((images, measured, worst), is_so) in seen.iter_mut().zip([behind, passed]) {
            *images += usize::from(is_so);
            if is_so && m.state == MarkerState::Detected {
                *measured += 1;
                *worst = worst.max((m.centroid - center).norm());
            }
        }
    }
    eprintln!("{case}: images, measured, error at most: {seen:?}");
    seen
}

#[test]
fn a_marker_behind_a_pole_is_measured_where_its_shape_is_known() {
    for case in [1, 3, 6] {
        let [covered, whole] = behind_a_pole(case, -75.0);
        assert!(10 * covered.1 > 9 * covered.0 && covered.2 < 0.4, "{case}: {covered:?}");
        assert!(10 * whole.1 > 9 * whole.0 && whole.2 < 0.1, "{case}: {whole:?}");
    }
}

#[test]
fn a_pole_before_a_new_marker_is_not_learned_as_its_shape() {
    for case in [0, 3, 4, 11, 13] {
        let [covered, whole] = behind_a_pole(case, -34.0);
        assert!(covered.2 < 1.0, "{case}: {covered:?}");
        assert!(10 * whole.1 > 9 * whole.0 && whole.2 < 0.15, "{case}: {whole:?}");
    }
}

#[test]
fn a_marker_that_was_mounted_elsewhere_is_measured_again_after_two_seconds() {
    /// Displacement, px: 6 mm.
    const SHIFT: usize = 3;
    let (mut tracker, mut noise) = (new_tracker(TrackerConfig::default()), Noise(12));
    for k in 0..96i64 {
        let pose = pose(0.033 * k as f64);
        let red = if (16..24).contains(&k) { None } else { ALL[0] };
        let mut data = draw(&pose, [red, ALL[1], ALL[2], ALL[3]], &mut noise);
        let mut center = truth(MarkerColor::Red, &pose);
        if k >= 24 {
            let (left, top) = (center.x as usize - 30, center.y as usize - 30);
            for row in top..top + 60 {
                let start = 3 * (row * WIDTH + left);
                data.copy_within(start..start + 3 * 60, start + 3 * SHIFT);
            }
            center.x += SHIFT as f64;
        }
        let o = observe(&mut tracker, k, &data);
        if k < 90 {
            continue;
        }
        let off = (o.markers[MarkerColor::Red].centroid - center).norm();
        let all = o.markers.0.iter().all(|m| m.state == MarkerState::Detected);
        assert!(all && off < 0.2, "image {k}: {off} px, {:?}", tracker.views());
    }
}
