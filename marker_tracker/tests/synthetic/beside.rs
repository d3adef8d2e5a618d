//! Things that lie beside the markers all the time: borders of the paper, cables.

use super::common::{ALL, Noise, draw_beside, errors::Errors, new_tracker, observe, pose, truth};
use marker_tracker::TrackerConfig;
use rig_model::MarkerState;

/// Half the side of a marker, m.
const HALF: f64 = 0.038;

/// Color of what lies at a place about a marker's center, m.
type Beside = Box<dyn Fn(f64, f64) -> Option<[f64; 3]>>;

/// A border of this width, m, and brightness.
fn border(width: f64, brightness: f64) -> Beside {
    Box::new(move |a, b| (a.abs().max(b.abs()) < HALF + width).then_some([brightness; 3]))
}

/// A border along two adjacent sides.
fn two_sides(width: f64, brightness: f64) -> Beside {
    let reach = HALF + width;
    let is_beside = move |a: f64, b: f64| a > -HALF && b > -HALF && a.max(b) < reach;
    Box::new(move |a, b| is_beside(a, b).then_some([brightness; 3]))
}

/// A cable 6 mm wide along one side, at this distance from it, m, of this brightness.
fn cable(distance: f64, brightness: f64) -> Beside {
    let from = HALF + distance;
    Box::new(move |a, _| (from..from + 0.006).contains(&a).then_some([brightness; 3]))
}

#[test]
fn markers_with_borders_or_cables_beside_them_are_tracked() {
    let things: [(&str, Beside); 9] = [
        ("black line of 1.5 mm", border(0.0015, 25.0)),
        ("black line of 3 mm", border(0.003, 25.0)),
        ("white border of 2 mm", border(0.002, 235.0)),
        ("white border of 5 mm", border(0.005, 235.0)),
        ("white border of 10 mm", border(0.010, 235.0)),
        ("black cable at 3 mm", cable(0.003, 25.0)),
        ("black cable at 6 mm", cable(0.006, 25.0)),
        ("white cable at 6 mm", cable(0.006, 235.0)),
        ("black cable at 10 mm", cable(0.010, 25.0)),
    ];
    for (thing, beside) in things {
        let (missed, errors) = track(beside);
        eprintln!("{thing}: {missed} of 160 missed, {errors}");
        assert_eq!(missed, 0, "{thing}");
        assert!(errors.rms().amax() < 0.04, "{thing}: {errors}");
        assert!(errors.nes() < 4.0, "{thing}: {errors}");
        assert!(errors.worst < 0.2, "{thing}: {errors}");
    }
}

/// What lies beside two adjacent sides moves the centroid a little; its covariance says so.
#[test]
fn tape_on_two_sides_is_no_certain_error() {
    for (thing, width) in [("black tape of 3 mm", 0.003), ("black tape of 6 mm", 0.006)] {
        let (missed, errors) = track(two_sides(width, 25.0));
        eprintln!("{thing}: {missed} of 160 missed, {errors}");
        assert_eq!(missed, 0, "{thing}");
        assert!(errors.rms().amax() < 0.04, "{thing}: {errors}");
        assert!(errors.nes() < 4.5, "{thing}: {errors}");
        assert!(errors.worst < 0.2, "{thing}: {errors}");
    }
}

/// Tracks the four markers over 40 images; returns the number of missed ones and the errors.
fn track(beside: Beside) -> (usize, Errors) {
    let (mut tracker, mut noise) = (new_tracker(TrackerConfig::default()), Noise(21));
    let (mut errors, mut missed) = (Errors::default(), 0);
    for k in 0..40 {
        let pose = pose(0.066 * k as f64);
        let data = draw_beside(&pose, ALL, &beside, &mut noise);
        for (color, m) in observe(&mut tracker, k, &data).markers.iter() {
            if m.state == MarkerState::Detected {
                errors.add(m, truth(color, &pose));
            } else {
                missed += 1;
            }
        }
    }
    (missed, errors)
}
