//! A tracked image allocates no memory, as counted by the allocator.

#![allow(missing_docs, clippy::unwrap_used, clippy::panic)]

mod common;

use allocation_counter::measure;
use common::{ALL, Noise, draw, image, new_tracker, pose};
use marker_tracker::{Input, Output, TrackerConfig};
use rig_model::MarkerState;

#[test]
fn a_tracked_image_allocates_nothing() {
    let mut tracker = new_tracker(TrackerConfig::default());
    let mut noise = Noise(1);
    for k in 0..24i64 {
        // Including images in which a marker is hidden.
        let paint = if (12..18).contains(&k) { [ALL[0], None, ALL[2], ALL[3]] } else { ALL };
        let data = draw(&pose(0.033 * k as f64), paint, &mut noise);
        let image = image(k, &data);
        let mut output = None;
        let allocated = measure(|| {
            tracker.handle(Input::Image(image));
            output = tracker.poll();
        })
        .count_total;
        let Some(Output::Observations(o)) = output else { panic!("image {k}") };
        let detected = o.markers.0.iter().filter(|m| m.state == MarkerState::Detected).count();
        assert_eq!(detected, paint.iter().flatten().count(), "image {k}");
        // The first search of the whole image and the first one for a hidden marker fill the
        // buffers.
        if k >= 2 && k != 12 {
            assert_eq!(allocated, 0, "image {k}");
        }
    }
}
