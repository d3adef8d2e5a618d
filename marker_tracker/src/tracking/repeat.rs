//! Detection of repeated images: a camera that hangs sends the same image again, byte for byte,
//! including its noise. Such an image is no measurement.

use crate::{
    decode::decode_compressed,
    image::{ImageView, Pixels},
    signal::Sampler,
    tracking::marker::MarkerTrack,
};
use rig_model::PerColor;

/// Number of places that are compared, and bytes of each. With sensor noise of one gray value the
/// chance that 768 bytes of another image are the same is below 1e-200.
const PLACES: usize = 16;
const BYTES: usize = 48;

/// Compares each image with its predecessor.
#[derive(Clone, Debug)]
pub(super) struct RepeatDetector {
    /// Width, height and bytes per pixel of the sampled image; 0 where only a part of it was
    /// decoded.
    size: [usize; 3],
    bytes: [[u8; BYTES]; PLACES],
    /// Number of consecutive repetitions.
    pub count: u32,
}

impl Default for RepeatDetector {
    fn default() -> Self {
        Self { size: [0; 3], bytes: [[0; BYTES]; PLACES], count: 0 }
    }
}

impl RepeatDetector {
    /// Whether the image is a copy of its predecessor: in places all over it and in every pixel of
    /// the tracked outlines. (A drawn scene without noise may stand still except for the markers.)
    pub fn is_repeated(&mut self, image: &Pixels<'_>, tracks: &PerColor<MarkerTrack>) -> bool {
        let unchanged = tracks.0.iter().all(|track| {
            let Some(appearance) = &track.appearance else { return true };
            track.features.is_unchanged(&Sampler::new(image, &appearance.discriminant))
        });
        if image.coverage().is_some() {
            if unchanged {
                image.need_all();
            }
            (self.size, self.count) = ([0; 3], 0);
            return false;
        }
        if unchanged
            && self.size == [0; 3]
            && let Some(previous) = image.previous.and_then(|p| decode_compressed("", p).ok())
        {
            self.is_sample_repeated(&previous.view(image.stamp));
        }
        let repeated = self.is_sample_repeated(image) && unchanged;
        self.count = if repeated { self.count.saturating_add(1) } else { 0 };
        repeated
    }

    /// Whether the image has the sampled bytes; samples it otherwise.
    fn is_sample_repeated(&mut self, image: &ImageView<'_>) -> bool {
        let size = [image.width, image.height, image.format.bytes_per_pixel()];
        let same = self.size == size
            && samples(image).zip(&self.bytes).all(|(new, old)| old[..new.len()] == *new);
        if !same {
            self.size = size;
            for (new, old) in samples(image).zip(&mut self.bytes) {
                old[..new.len()].copy_from_slice(new);
            }
        }
        same
    }
}

/// Bytes from places spread down the image and across it.
fn samples<'a>(image: &ImageView<'a>) -> impl Iterator<Item = &'a [u8]> {
    let ImageView { width, height, step, data, .. } = *image;
    let row = width * image.format.bytes_per_pixel();
    (0..PLACES).map(move |i| {
        let y = (2 * i + 1) * height / (2 * PLACES);
        let x = (i * 7 % PLACES) * row.saturating_sub(BYTES) / PLACES;
        let start = y * step + x;
        data.get(start..start + BYTES.min(row)).unwrap_or(&[])
    })
}
