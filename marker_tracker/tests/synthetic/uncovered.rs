//! A marker that is covered in part in its first images and then becomes whole.

use super::common::{ALL, HEIGHT, Noise, WIDTH, draw, new_tracker, observe, pose, truth};
use marker_tracker::TrackerConfig;
use nalgebra::Vector2;
use rig_model::{MarkerColor, MarkerState};

/// Half the side of a marker in these scenes, px.
const HALF: f64 = 18.2;

/// Covers what lies beyond `edge` px from the red marker's center in the direction `angle`.
fn cover(data: &mut [u8], center: Vector2<f64>, angle: f64, edge: f64) {
    let across = Vector2::new(angle.cos(), angle.sin());
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let place = Vector2::new(x as f64, y as f64) - center;
            if place.norm() < 45.0 {
                let share = (place.dot(&across) - edge + 0.5).clamp(0.0, 1.0);
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
            cover(&mut data, center, angle, edge);
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
        }
    }
    eprintln!("{missed} of {whole} images of the whole marker missed");
    // One case of 24 remains, in which an acquisition of three markers precedes: 1.5 % of the
    // images.
    assert!(missed * 50 <= whole, "{missed} of {whole} missed");
}
