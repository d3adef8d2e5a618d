//! Images of which only the windows that the tracker reads are decoded, beside whole ones.

use super::recording::{self, Recorded};
use marker_tracker::{Decoder, Input, Tracker, TrackerConfig, decode_compressed};
use rig_simulator::random::Random;
use std::path::Path;

/// Tracks the same images whole and by windows; returns the number of images, and that of those
/// for which the windows sufficed.
fn compare(folder: &Path, mut change: impl FnMut(usize, &mut Vec<u8>)) -> (usize, usize) {
    let (rig, messages) = recording::read(folder);
    let mut whole = Tracker::new(rig.markers.clone(), TrackerConfig::default());
    let mut partial = Tracker::new(rig.markers, TrackerConfig::default());
    let mut decoder = Decoder::default();
    let (mut images, mut sufficed) = (0, 0);
    for message in messages {
        match message {
            Recorded::Camera(camera) => {
                whole.handle(Input::Camera(camera.clone()));
                partial.handle(Input::Camera(camera));
            }
            Recorded::Image { stamp, format, mut data } => {
                change(images, &mut data);
                images += 1;
                let expected = decode_compressed(&format, &data);
                let image = decoder.decode(stamp, &format, &data, Some(&partial));
                match (expected, image) {
                    (Ok(expected), Ok(mut image)) => {
                        whole.handle(Input::Image(expected.view(stamp)));
                        partial.handle_partial(&mut image);
                        sufficed += usize::from(image.is_partial());
                        if images % 10 == 0 {
                            assert_eq!(image.whole().unwrap().data, expected.data);
                        }
                    }
                    (expected, image) => {
                        assert_eq!(expected.err(), image.map(|_| ()).err(), "image {images}");
                    }
                }
            }
        }
        loop {
            let (expected, output) = (whole.poll(), partial.poll());
            // Debug prints every bit of a number, and lost markers have no place to compare.
            assert_eq!(format!("{expected:?}"), format!("{output:?}"), "image {images}");
            if output.is_none() {
                break;
            }
        }
    }
    (images, sufficed)
}

#[test]
fn observations_are_the_same_and_windows_suffice_for_most_images() {
    let Some(shared) = test_support::recordings() else { return };
    for (bag, least) in
        [("nominal", 0.95), ("clutter", 0.95), ("fast_swing", 0.95), ("occlude_two", 0.6)]
    {
        let (images, sufficed) = compare(&shared.join("bags").join(bag), |_, _| {});
        eprintln!("{bag}: windows sufficed for {sufficed} of {images} images");
        assert!(sufficed as f64 > least * images as f64, "{bag}: {sufficed} of {images}");
    }
}

#[test]
fn damaged_images_are_rejected_or_tracked_as_whole_ones_are() {
    let Some(shared) = test_support::recordings() else { return };
    let mut random = Random::new(7);
    compare(&shared.join("bags/nominal"), |k, data| {
        if k % 2 == 1 {
            for _ in 0..=random.index(3) {
                let at = random.index(data.len());
                data[at] = random.index(256) as u8;
            }
        }
        if k % 16 == 15 {
            data.truncate(random.index(data.len()));
        }
    });
}

#[test]
fn repeated_images_are_noticed_as_in_whole_ones() {
    let Some(shared) = test_support::recordings() else { return };
    let mut before = Vec::new();
    // A third of the images is a copy, up to three times in a row.
    compare(&shared.join("bags/occlude_two"), |k, data| {
        if [3, 7, 8, 9].contains(&(k % 12)) {
            data.clone_from(&before);
        }
        before.clone_from(data);
    });
}
