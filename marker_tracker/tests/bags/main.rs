//! The recorded bags against their truth, marker by marker.

#![allow(clippy::unwrap_used, clippy::panic)] // clippy does not recognize helpers of tests

#[path = "../common/errors.rs"]
mod errors;
#[path = "../common/recording.rs"]
mod recording;
mod windows;

use errors::Errors;
use marker_tracker::{Input, Output, Tracker, TrackerConfig, decode_compressed};
use nalgebra::Vector2;
use recording::Recorded;
use rig_model::{MarkerObservation, MarkerObservations, MarkerState, PerColor};
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

/// Errors of the markers that are shown as a whole, in part, either, and not at all.
#[derive(Clone, Copy, Default)]
struct Score {
    whole: Errors,
    part: Errors,
    seen: Errors,
    predicted: Errors,
    hidden_detected: usize,
    /// Detected more than 5 px off.
    wrong: usize,
}

impl Score {
    fn add(&mut self, m: &MarkerObservation, t: &Truth) {
        let detected = m.state == MarkerState::Detected;
        self.wrong += usize::from(detected && (m.centroid - t.centroid).norm() > 5.0);
        if m.state == MarkerState::Predicted {
            self.predicted.add(m, t.centroid);
        }
        if t.shown > 0.0 {
            let class = if t.shown >= 1.0 { &mut self.whole } else { &mut self.part };
            class.show(m, t.centroid);
            self.seen.show(m, t.centroid);
        } else {
            self.hidden_detected += usize::from(detected);
        }
    }
}

/// Scores each marker, and prints the figures.
fn score(bag: &str, folder: &Path, observations: &[MarkerObservations]) -> Score {
    let truth = truth(folder);
    let (mut scores, mut all) = (PerColor::<Score>::default(), Score::default());
    for o in observations {
        let truth = &truth[&o.stamp.as_nanos()];
        for (color, m) in o.markers.iter() {
            scores[color].add(m, &truth[color]);
            all.add(m, &truth[color]);
        }
    }
    let named = scores.iter().map(|(color, s)| (color.name(), s));
    for (name, s) in named.chain([("all", &all)]) {
        eprintln!(
            "{bag:11} {name:6} whole {} | part {} | predicted {} | hidden detected {} wrong {}",
            s.whole, s.part, s.predicted, s.hidden_detected, s.wrong
        );
    }
    all
}

#[test]
fn centroids_states_and_covariances_on_the_recorded_bags() {
    let Some(shared) = test_support::recordings() else { return };
    for bag in ["nominal", "occlude_two", "clutter", "fast_swing"] {
        let folder = shared.join("bags").join(bag);
        let observations = track_bag(&folder, TrackerConfig::default());
        let all = score(bag, &folder, &observations);
        let (share, rms, nes) = (all.whole.share(), all.whole.rms(), all.whole.nes());
        assert!(observations.len() == 358, "{bag}: an observation per image");
        assert!(share >= 0.999, "{bag}: whole markers detected {share}");
        assert!(rms.x <= 0.06 && rms.y <= 0.06, "{bag}: centroid RMS {rms}");
        assert!((1.6..=2.6).contains(&nes), "{bag}: normalized squared error {nes}");
        assert!(all.part.nes() < 4.0, "{bag}: partly covered markers are inconsistent");
        let worst = all.part.worst;
        assert!(worst < 1.0, "{bag}: a partly covered marker is {worst} px off");
        if all.predicted.count > 20 {
            let nes = all.predicted.nes();
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
        let all = score(bag, &folder, &observations);
        let (rms, share) = (all.seen.rms_per_axis(), all.whole.share());
        let nes = all.whole.nes();
        eprintln!("{bag:11} published tracker: rms {rms:.3} px with partly covered ones");
        assert_eq!(observations.len(), 358, "{bag}: an observation per image");
        if bag != "clutter" {
            assert!(rms < 1.0, "{bag}: centroid RMS {rms} px");
            assert!(share > 0.9, "{bag}: whole markers detected {share}");
            assert!(nes < 2.6, "{bag}: normalized squared error {nes}");
            assert_eq!(all.hidden_detected, 0, "{bag}: hidden markers detected");
        }
    }
}
