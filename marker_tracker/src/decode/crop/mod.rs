//! Lossless cropping of a JPEG: the blocks of some windows as a JPEG of their own.
//!
//! Entropy-coded data can only be read in sequence, but most of the work of decoding comes after
//! it. The blocks outside of the windows are read over, several symbols at a time; those in it are
//! copied bit by bit, except for the DC coefficients, which are differences from block to block.
//! The decoder then makes the same pixels of them.

mod entropy;
mod header;
mod huffman;

use crate::image::Window;
use entropy::{BitWriter, Segment};
use header::Header;
use std::ops::Range;

/// Pixels at a block's border, px, whose colors depend on the next block, where chroma has half the
/// resolution.
const BORDER: usize = 2;

/// A cropped JPEG's place in the image.
#[derive(Clone, Debug)]
pub(super) struct Place {
    /// Bounds of the cropped image.
    pub bounds: Window,
    /// Where its pixels are those of the whole image, around each of the windows.
    pub exact: [Window; 4],
}

/// Crops images; its memory is reused.
#[derive(Debug, Default)]
pub(super) struct Cropper {
    header: Header,
    segment: Segment,
    bits: BitWriter,
    /// The cropped image.
    pub jpeg: Vec<u8>,
}

/// Ranges of columns and rows of blocks.
type Blocks = [Range<usize>; 2];

impl Cropper {
    /// Crops a JPEG to the blocks of up to four windows; the blocks between them are left empty.
    ///
    /// `None` for anything but a valid image of 8 bits and three components in one baseline scan,
    /// and where no window is in the image. The data after the last block are only searched for
    /// markers, since no error in them would change the pixels of the windows.
    pub fn crop(&mut self, jpeg: &[u8], windows: &[Window]) -> Option<Place> {
        let data = self.header.read(jpeg)?;
        let Header { width, height, sampling: [across, down], .. } = self.header;
        let (size, pixels) = ([8 * across, 8 * down], [width, height]);
        let count = [0, 1].map(|k| pixels[k].div_ceil(size[k]));
        let mut blocks: [Blocks; 4] = Default::default();
        let mut place = Place { bounds: [usize::MAX, usize::MAX, 0, 0], exact: [[0; 4]; 4] };
        let mut wanted = 0;
        for window in windows.iter().filter(|w| w[0] < w[2].min(width) && w[1] < w[3].min(height)) {
            let ranges = [0, 1].map(|k| {
                let from = window[k].saturating_sub(BORDER) / size[k];
                from..(window[k + 2] + BORDER).div_ceil(size[k]).min(count[k])
            });
            let exact = place.exact.get_mut(wanted)?;
            for k in [0, 1] {
                let Range { start, end } = ranges[k];
                let (low, high) = (start * size[k], (end * size[k]).min(pixels[k]));
                place.bounds[k] = place.bounds[k].min(low);
                place.bounds[k + 2] = place.bounds[k + 2].max(high);
                exact[k] = if start == 0 { 0 } else { low + BORDER };
                exact[k + 2] = if end == count[k] { high } else { high - BORDER };
            }
            blocks[wanted] = ranges;
            wanted += 1;
        }
        let blocks = blocks.get(..wanted).filter(|b| !b.is_empty())?;
        let bounds = place.bounds;
        let all = [0, 1].map(|k| bounds[k] / size[k]..bounds[k + 2].div_ceil(size[k]));
        let end = self.copy(jpeg, data, count, blocks, &all)?;
        // Another image may follow, but nothing of this one.
        if jpeg.get(end..end + 2)? != [0xff, 0xd9] {
            return None;
        }
        self.jpeg.clear();
        self.header.write(&mut self.jpeg, bounds[2] - bounds[0], bounds[3] - bounds[1]);
        self.bits.finish(&mut self.jpeg);
        self.jpeg.extend_from_slice(&[0xff, 0xd9]);
        Some(place)
    }

    /// Reads the data from `at` on, up to the last of the blocks in `all`, and copies the ones in
    /// `wanted`; returns the end of the data.
    fn copy(
        &mut self,
        jpeg: &[u8],
        mut at: usize,
        [columns, rows]: [usize; 2],
        wanted: &[Blocks],
        all: &Blocks,
    ) -> Option<usize> {
        let Self { header, segment, bits, .. } = self;
        let tables = header.tables()?;
        let empty = tables.map(|(_, ac)| ac.code_of(0));
        let [across, down] = header.sampling;
        let blocks = [across * down, 1, 1];
        let (mut before, mut copied) = ([0i32; 3], [0i32; 3]);
        bits.clear();
        at += segment.load(jpeg.get(at..)?)?;
        let (mut restarts, mut until_restart) = (0, header.restart_interval);
        for row in 0..rows {
            // With restarts the decoder rejects some invalid data.
            if row == all[1].end && header.restart_interval == 0 {
                return Some(at);
            }
            for column in 0..columns {
                if until_restart == 0 && header.restart_interval > 0 {
                    if !segment.is_at_end() || jpeg.get(at + 1)? != &(0xd0 + restarts) {
                        return None;
                    }
                    restarts = (restarts + 1) % 8;
                    at += 2;
                    at += segment.load(jpeg.get(at..)?)?;
                    until_restart = header.restart_interval;
                    before = [0; 3];
                }
                until_restart = until_restart.wrapping_sub(1);
                let is_in = |b: &Blocks| b[0].contains(&column) && b[1].contains(&row);
                let (is_cropped, is_wanted) = (is_in(all), wanted.iter().any(is_in));
                for component in 0..3 {
                    let (dc, ac) = tables[component];
                    for _ in 0..blocks[component] {
                        let block = segment.block(dc, ac)?;
                        before[component] += block.difference;
                        if is_wanted {
                            let difference = before[component] - copied[component];
                            bits.copy(segment, &block, difference)?;
                            copied[component] = before[component];
                        } else if is_cropped {
                            bits.empty(empty[component]?);
                        }
                    }
                }
            }
        }
        segment.is_at_end().then_some(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        decode::{
            fixtures::{assert_same, encoded},
            jpeg::{self, WindowDecoder},
        },
        image::OwnedImage,
    };
    use jpeg_encoder::SamplingFactor;

    /// Windows in the middle, at the borders and beyond them.
    const WINDOWS: [Window; 4] =
        [[40, 30, 61, 47], [0, 0, 9, 5], [90, 60, 500, 400], [50, 0, 50, 70]];

    #[test]
    fn windows_have_the_pixels_of_the_whole_image() {
        let samplings = [
            SamplingFactor::R_4_4_4,
            SamplingFactor::R_4_4_0,
            SamplingFactor::R_4_2_2,
            SamplingFactor::R_4_2_0,
        ];
        for sampling in samplings {
            for (width, height) in [(128, 96), (121, 93), (107, 81), (98, 66)] {
                for interval in [0, 1, 5] {
                    let jpeg = encoded(width, height, |encoder| {
                        encoder.set_sampling_factor(sampling);
                        encoder.set_restart_interval(interval);
                    });
                    let mut whole = OwnedImage::default();
                    jpeg::decode(&jpeg, &mut whole).unwrap();
                    let mut image = OwnedImage::default();
                    let mut decoder = WindowDecoder::default();
                    let what = format!("{sampling:?} {width}x{height} {interval}");
                    let exact = decoder.decode(&jpeg, &WINDOWS, &mut image).unwrap();
                    let exact = exact.unwrap_or_else(|| panic!("{what}: not cropped"));
                    // The last one is empty.
                    for (window, wanted) in exact.iter().zip(&WINDOWS[..3]) {
                        let [x0, _, x1, _] = *window;
                        let inside = wanted[2].min(image.width) <= x1 && wanted[0] >= x0;
                        assert!(inside, "{what}: {window:?}");
                        assert_same(&image, &whole, *window, &what);
                    }
                }
            }
        }
    }

    #[test]
    fn other_images_are_left_to_the_decoder() {
        let mut cropper = Cropper::default();
        let jpeg = encoded(128, 96, |_| {});
        assert!(cropper.crop(&jpeg, &WINDOWS).is_some());
        assert!(cropper.crop(&jpeg, &[[5, 5, 5, 9], [128, 0, 140, 9]]).is_none());
        let progressive = encoded(128, 96, |encoder| encoder.set_progressive(true));
        assert!(cropper.crop(&progressive, &WINDOWS).is_none());
        let fine = encoded(128, 96, |encoder| encoder.set_sampling_factor(SamplingFactor::R_4_1_1));
        assert!(cropper.crop(&fine, &WINDOWS).is_none());
        let data = jpeg.windows(2).rposition(|pair| pair == [0xff, 0xda]).unwrap() + 14;
        for cut in [3, 20, data, data + 40, jpeg.len() - 2] {
            assert!(cropper.crop(&jpeg[..cut], &WINDOWS).is_none(), "{cut}");
        }
        // A marker within the data.
        let mut damaged = jpeg.clone();
        damaged[data + 60] = 0xff;
        damaged[data + 61] = 0xc4;
        assert!(cropper.crop(&damaged, &WINDOWS).is_none());
    }
}
