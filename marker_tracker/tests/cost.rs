//! Images per second of the tracking methods on one core, and the share of a JPEG's cost that is
//! left where only the windows of the markers are decoded; printed by `make bench`.

#![allow(clippy::unwrap_used, clippy::panic)] // clippy does not recognize helpers of tests
#![allow(clippy::disallowed_methods)] // measures time

mod common;
#[path = "common/recording.rs"]
mod recording;

use common::{ALL, HEIGHT, Noise, WIDTH, draw, new_tracker, observe, pose};
use marker_tracker::{Decoder, Input, Method, Tracker, TrackerConfig};
use recording::Recorded;
use rig_model::MarkerState;
use std::time::{Duration, Instant};

#[test]
#[ignore = "a measurement: `make bench`"]
fn images_per_second_on_one_core() {
    let mut noise = Noise(1);
    // Blue is hidden in a third of the images, two in a sixth, all in another sixth.
    let images: Vec<Vec<u8>> = (0..180)
        .map(|k| {
            let [red, green, _, yellow] = ALL;
            let paint = match k {
                60..120 => [red, green, None, yellow],
                120..150 => [None, green, None, yellow],
                150..180 => [None; 4],
                _ => ALL,
            };
            draw(&pose(0.033 * f64::from(k)), paint, &mut noise)
        })
        .collect();
    let methods = [
        ("outline", Method::Outline),
        #[cfg(feature = "opencv")]
        ("paper", Method::Paper(marker_tracker::BinaryThreshold::default())),
    ];
    for (name, method) in methods {
        let mut tracker = new_tracker(TrackerConfig { method, ..TrackerConfig::default() });
        let (mut times, mut detected) = (Vec::new(), 0);
        for (k, data) in images.iter().enumerate() {
            let start = Instant::now();
            let o = observe(&mut tracker, k as i64, data);
            times.push(start.elapsed());
            detected += o.markers.0.iter().filter(|m| m.state == MarkerState::Detected).count();
        }
        let total: Duration = times.iter().sum();
        times.sort_unstable();
        let rate = times.len() as f64 / total.as_secs_f64();
        eprintln!(
            "{name:8} {WIDTH}x{HEIGHT}: {rate:.0} images/s, median {:.2} ms, longest {:.2} ms, \
             {detected} markers detected",
            times[times.len() / 2].as_secs_f64() * 1e3,
            times[times.len() - 1].as_secs_f64() * 1e3,
        );
        // Of 480 visible ones.
        assert!(detected > 400, "{name}: {detected} markers detected");
        // The rate that the paper foresees for the camera.
        assert!(rate > 100.0, "{name}: {rate:.0} images/s");
    }
}

#[test]
#[ignore = "a measurement: `make bench`"]
fn jpeg_to_markers_by_windows_and_by_whole_images() {
    let Some(shared) = test_support::recordings() else { return };
    for bag in ["nominal", "occlude_two", "clutter", "fast_swing"] {
        let (rig, messages) = recording::read(&shared.join("bags").join(bag));
        // The same tracker twice, image by image in turn: one decodes windows, one whole images.
        let mut trackers =
            [(); 2].map(|()| Tracker::new(rig.markers.clone(), TrackerConfig::default()));
        let mut decoders = [(); 2].map(|()| Decoder::default());
        let mut times = [Vec::new(), Vec::new()];
        for message in messages {
            for k in [0, 1] {
                let tracker = &mut trackers[k];
                match &message {
                    Recorded::Camera(camera) => tracker.handle(Input::Camera(camera.clone())),
                    Recorded::Image { stamp, format, data } => {
                        let start = Instant::now();
                        let windows = (k == 0).then_some(&*tracker);
                        let image = decoders[k].decode(*stamp, format, data, windows);
                        tracker.handle_partial(&mut image.unwrap());
                        times[k].push(start.elapsed());
                    }
                }
                while tracker.poll().is_some() {}
            }
        }
        let [windows, whole] = times.map(|mut times| {
            times.sort_unstable();
            times[times.len() / 2].as_secs_f64() * 1e3
        });
        let ratio = windows / whole;
        eprintln!(
            "{bag:12} JPEG to markers, median: {windows:.2} ms by windows, {whole:.2} ms by whole \
             images: {ratio:.2}"
        );
        assert!(ratio <= 0.5, "{bag}: {ratio}");
    }
}
