//! Detection of repeated images: a camera that hangs sends the same image again, byte for byte,
//! including its noise. Such an image is no measurement.

use crate::image::Pixels;

/// Distance of the compared rows of a raw image, px: no marker of 8 px or more lies between them.
const ROWS: usize = 8;

/// Compares each image with its predecessor.
#[derive(Clone, Debug, Default)]
pub(super) struct RepeatDetector {
    /// Checksum of the last image.
    last: Option<u32>,
    /// Number of consecutive repetitions.
    pub count: u32,
}

impl RepeatDetector {
    /// Whether the image is a copy of its predecessor.
    pub fn is_repeated(&mut self, image: &Pixels<'_>) -> bool {
        let now = Some(checksum(image));
        let is_repeated = now == self.last;
        self.last = now;
        self.count = if is_repeated { self.count.saturating_add(1) } else { 0 };
        is_repeated
    }
}

/// Checksum of all bytes of a compressed image, else of every [`ROWS`]-th row: a few microseconds
/// of a VGA image.
fn checksum(image: &Pixels<'_>) -> u32 {
    let mut sum = crc32fast::Hasher::new();
    if let Some(bytes) = image.compressed {
        sum.update(bytes);
    } else {
        let row = image.width * image.format.bytes_per_pixel();
        for start in (0..image.height).step_by(ROWS).map(|y| y * image.step) {
            sum.update(image.data.get(start..start + row).unwrap_or(&[]));
        }
    }
    sum.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::fixtures::drawn;
    use rig_model::Stamp;

    #[test]
    fn a_square_that_appears_before_an_even_background_is_no_repetition() {
        let images = [drawn(64, 64, 90, &[]), drawn(64, 64, 90, &[([52, 21, 60, 29], [200; 3])])];
        for is_compressed in [false, true] {
            let mut detector = RepeatDetector::default();
            for (i, wanted) in [(0, false), (0, true), (1, false), (1, true)] {
                let compressed = is_compressed.then_some(&*images[i].data);
                let image = Pixels::whole(images[i].view(Stamp::default()), compressed);
                assert_eq!(detector.is_repeated(&image), wanted);
            }
        }
    }
}
