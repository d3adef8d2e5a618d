//! Images per second of the tracking methods on one core, printed by `make bench`.

#![allow(clippy::unwrap_used, clippy::panic)] // clippy does not recognize helpers of tests
#![allow(clippy::disallowed_methods)] // measures time

mod common;

use common::{ALL, HEIGHT, Noise, WIDTH, draw, new_tracker, observe, pose};
use marker_tracker::{Method, TrackerConfig};
use rig_model::MarkerState;
use std::time::{Duration, Instant};

#[test]
#[ignore = "a measurement: `make bench`"]
fn images_per_second_on_one_core() {
    let mut noise = Noise(1);
    // Blue is hidden in a third of the images, two are in a sixth.
    let images: Vec<Vec<u8>> = (0..180)
        .map(|k| {
            let [red, green, _, yellow] = ALL;
            let paint = match k {
                60..120 => [red, green, None, yellow],
                120..150 => [None, green, None, yellow],
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
        eprintln!(
            "{name:8} {WIDTH}x{HEIGHT}: {:.0} images/s, median {:.2} ms, longest {:.2} ms, \
             {detected} markers detected",
            times.len() as f64 / total.as_secs_f64(),
            times[times.len() / 2].as_secs_f64() * 1e3,
            times[times.len() - 1].as_secs_f64() * 1e3,
        );
        // Of 600 visible ones.
        assert!(detected > 500, "{name}: {detected} markers detected");
    }
}
