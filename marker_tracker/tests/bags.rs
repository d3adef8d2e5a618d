//! The recorded bags against their truth, marker by marker.

#![allow(clippy::unwrap_used, clippy::panic)] // clippy does not recognize helpers of tests

#[path = "common/recording.rs"]
mod recording;

use marker_tracker::{Input, Output, Tracker, TrackerConfig, decode_compressed};
use nalgebra::Vector2;
use recording::Recorded;
use rig_model::{MarkerColor, MarkerObservations, MarkerState, PerColor};
use std::{collections::BTreeMap, path::Path};

/// Runs the tracker over a bag's compressed images.
pub fn track_bag(folder: &Path, config: TrackerConfig) -> Vec<MarkerObservations> {
    let (rig, messages) = recording::read(folder);
    let mut tracker = Tracker::new(rig.markers, config);
    let mut out = Vec::new();
    for message in messages {
        match message {
            Recorded::Camera(camera) => tracker.handle(Input::Camera(camera)),
            Recorded::Image { stamp, format, data } => {
                let image = decode_compressed(&format, &data).unwrap();
                tracker.handle(Input::Image(image.view(stamp)));
            }
        }
        while let Some(output) = tracker.poll() {
            if let Output::Observations(o) = output {
                out.push(o);
            }
        }
    }
    out
}

#[derive(Clone, Copy)]
struct Truth {
    centroid: Vector2<f64>,
    shown: f64,
}

fn truth(folder: &Path) -> BTreeMap<i64, PerColor<Truth>> {
    let text = std::fs::read_to_string(folder.join("truth_markers.csv")).unwrap();
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap().split(',').collect();
    let column = |name: String| header.iter().position(|h| *h == name).unwrap();
    lines
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            let number = |name: String| cells[column(name)].parse::<f64>().unwrap();
            let markers = PerColor::from_fn(|c| Truth {
                centroid: Vector2::new(number(format!("{c}_cx")), number(format!("{c}_cy"))),
                shown: number(format!("{c}_shown")),
            });
            (cells[0].parse().unwrap(), markers)
        })
        .collect()
}

#[derive(Default)]
struct Score {
    whole: usize,
    whole_detected: usize,
    square: Vector2<f64>,
    sum: Vector2<f64>,
    nes: f64,
    part: usize,
    part_detected: usize,
    part_square: f64,
    part_nes: f64,
    part_worst: f64,
    hidden: usize,
    hidden_detected: usize,
    wrong: usize,
    predicted: usize,
    predicted_square: f64,
    predicted_nes: f64,
}

fn score(folder: &Path, observations: &[MarkerObservations], verbose: bool) -> PerColor<Score> {
    let truth = truth(folder);
    let mut scores: PerColor<Score> = PerColor::from_fn(|_| Score::default());
    for (k, o) in observations.iter().enumerate() {
        let t = &truth[&o.stamp.as_nanos()];
        for color in MarkerColor::ALL {
            let (m, t, s) = (&o.markers[color], &t[color], &mut scores[color]);
            let detected = m.state == MarkerState::Detected;
            let error = m.centroid - t.centroid;
            let nes =
                m.covariance.try_inverse().map_or(0.0, |i| (error.transpose() * i * error)[0]);
            if verbose
                && (t.shown < 1.0 || !detected || nes > 12.0)
                && std::env::var("VERBOSE").is_ok()
            {
                eprintln!(
                    "{k:4} {color:6} shown {:.3} {:?} error {:6.3} {:6.3} sigma {:.3} nes {nes:.1}",
                    t.shown,
                    m.state,
                    error.x,
                    error.y,
                    (m.covariance.trace() / 2.0).sqrt()
                );
            }
            if detected && error.norm() > 5.0 {
                s.wrong += 1;
            }
            if m.state == MarkerState::Predicted {
                s.predicted += 1;
                s.predicted_square += error.norm_squared();
                s.predicted_nes += nes;
            }
            if t.shown >= 1.0 {
                s.whole += 1;
                if detected {
                    s.whole_detected += 1;
                    s.square += error.component_mul(&error);
                    s.sum += error;
                    s.nes += nes;
                }
            } else if t.shown > 0.0 {
                s.part += 1;
                if detected {
                    s.part_detected += 1;
                    s.part_square += error.norm_squared() / 2.0;
                    s.part_nes += nes;
                    s.part_worst = s.part_worst.max(error.norm());
                }
            } else {
                s.hidden += 1;
                s.hidden_detected += usize::from(detected);
            }
        }
    }
    scores
}

/// Prints the figures of one marker.
fn print(bag: &str, color: MarkerColor, s: &Score) {
    let n = s.whole_detected.max(1) as f64;
    let rms = (s.square / n).map(f64::sqrt);
    eprintln!(
        "{bag:12} {color:6} whole {:3}/{:3} rms {:.4} {:.4} mean {:7.4} {:7.4} nes {:5.2} | \
         part {:3}/{:3} rms {:.3} nes {:5.2} worst {:.2} | hidden {}/{} wrong {} | \
         predicted {} rms {:.2} nes {:.2}",
        s.whole_detected,
        s.whole,
        rms.x,
        rms.y,
        s.sum.x / n,
        s.sum.y / n,
        s.nes / n,
        s.part_detected,
        s.part,
        (s.part_square / s.part_detected.max(1) as f64).sqrt(),
        s.part_nes / s.part_detected.max(1) as f64,
        s.part_worst,
        s.hidden_detected,
        s.hidden,
        s.wrong,
        s.predicted,
        (s.predicted_square / s.predicted.max(1) as f64).sqrt(),
        s.predicted_nes / s.predicted.max(1) as f64,
    );
}

#[test]
fn centroids_states_and_covariances_on_the_recorded_bags() {
    let Some(shared) = test_support::recordings() else { return };
    let only = std::env::var("BAG").unwrap_or_default();
    for bag in ["nominal", "occlude_two", "clutter", "fast_swing"] {
        if !bag.contains(&only) {
            continue;
        }
        let folder = shared.join("bags").join(bag);
        let observations = track_bag(&folder, TrackerConfig::default());
        let scores = score(&folder, &observations, true);
        let (mut all, mut square) = (Score::default(), Vector2::zeros());
        for (color, s) in scores.iter() {
            print(bag, color, s);
            square += s.square;
            all.whole += s.whole;
            all.whole_detected += s.whole_detected;
            all.nes += s.nes;
            all.part_detected += s.part_detected;
            all.part_nes += s.part_nes;
            all.part_square += s.part_square;
            all.part_worst = all.part_worst.max(s.part_worst);
            all.predicted += s.predicted;
            all.predicted_nes += s.predicted_nes;
            all.hidden_detected += s.hidden_detected;
            all.wrong += s.wrong;
        }
        let n = all.whole_detected.max(1) as f64;
        let rms = (square / n).map(f64::sqrt);
        let share = all.whole_detected as f64 / all.whole as f64;
        let nes = all.nes / n;
        let parts = all.part_detected.max(1) as f64;
        eprintln!(
            "{bag:12} all    whole {}/{} = {:.2} %  rms {:.4} {:.4} px  nes {nes:.2} | \
             part nes {:.2} rms {:.3}",
            all.whole_detected,
            all.whole,
            100.0 * share,
            rms.x,
            rms.y,
            all.part_nes / parts,
            (all.part_square / parts).sqrt(),
        );
        assert!(observations.len() == 358, "{bag}: an observation per image");
        assert!(share >= 0.999, "{bag}: whole markers detected {share}");
        assert!(rms.x <= 0.06 && rms.y <= 0.06, "{bag}: centroid RMS {rms}");
        assert!((1.6..=2.6).contains(&nes), "{bag}: normalized squared error {nes}");
        assert!(all.part_nes / parts < 4.0, "{bag}: partly covered markers are inconsistent");
        assert!(
            all.part_worst < 1.0,
            "{bag}: a partly covered marker is {} px off",
            all.part_worst
        );
        if all.predicted > 20 {
            let nes = all.predicted_nes / all.predicted as f64;
            assert!(nes < 4.0, "{bag}: predictions are inconsistent: {nes}");
        }
        assert_eq!(all.hidden_detected, 0, "{bag}: hidden markers detected");
        assert_eq!(all.wrong, 0, "{bag}: detected more than 5 px off");
    }
}

/// The published tracker on the same bags. It knows neither layout nor camera, so it is not asked
/// for the accuracy of the outlines, and things of the markers' colors mislead it (`clutter`).
#[cfg(feature = "opencv")]
#[test]
fn the_published_tracker_on_the_recorded_bags() {
    let Some(shared) = test_support::recordings() else { return };
    for bag in ["nominal", "occlude_two", "fast_swing", "clutter"] {
        let folder = shared.join("bags").join(bag);
        let method = marker_tracker::Method::Paper(marker_tracker::BinaryThreshold::default());
        let observations = track_bag(&folder, TrackerConfig { method, ..TrackerConfig::default() });
        let (mut square, mut detected, mut whole, mut whole_detected) = (0.0, 0, 0, 0);
        let (mut nes, mut hidden) = (0.0, 0);
        for (color, s) in score(&folder, &observations, true).iter() {
            print(bag, color, s);
            square += s.square.sum() / 2.0 + s.part_square;
            detected += s.whole_detected + s.part_detected;
            (whole, whole_detected) = (whole + s.whole, whole_detected + s.whole_detected);
            (nes, hidden) = (nes + s.nes, hidden + s.hidden_detected);
        }
        let (rms, share) =
            ((square / detected as f64).sqrt(), whole_detected as f64 / whole as f64);
        let nes = nes / whole_detected as f64;
        eprintln!(
            "{bag:12} published tracker: whole {:.1} %, rms {rms:.3} px with partly covered ones, \
             nes of whole ones {nes:.2}",
            100.0 * share
        );
        assert_eq!(observations.len(), 358, "{bag}: an observation per image");
        let printed = marker_tracker::BinaryThreshold { share: 0.75, of_maximum: false };
        let method = marker_tracker::Method::Paper(printed);
        let found = track_bag(&folder, TrackerConfig { method, ..TrackerConfig::default() })
            .iter()
            .flat_map(|o| o.markers.0)
            .filter(|m| m.state == MarkerState::Detected)
            .count();
        eprintln!("{bag:12} threshold as printed, 0.75 of 255: {found} markers detected");
        assert_eq!(found, 0, "{bag}: the colors are muted");
        if bag != "clutter" {
            assert!(rms < 1.0, "{bag}: centroid RMS {rms} px");
            assert!(share > 0.9, "{bag}: whole markers detected {share}");
            assert!(nes < 2.6, "{bag}: normalized squared error {nes}");
            assert_eq!(hidden, 0, "{bag}: hidden markers detected");
        }
    }
}
