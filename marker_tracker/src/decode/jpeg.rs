//! JPEG.

use crate::{
    decode::{
        check_claim,
        crop::{Cropper, Place},
        tables::with_tables,
    },
    image::{ImageError, OwnedImage, PixelFormat, Window},
};
use std::fmt::Debug;
use zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

/// Largest number of pixels per byte: the emptiest block of 64 (or, with halved chroma, 170 per
/// block) takes two bits.
const PIXELS_PER_BYTE: usize = 2048;
/// Largest number of scans. Cameras send one; libjpeg's progressive script has 10, and the work
/// grows with each.
const MAX_SCANS: usize = 32;

/// Decodes a JPEG into rgb8.
pub(super) fn decode(data: &[u8], image: &mut OwnedImage) -> Result<(), ImageError> {
    let data = with_tables(data);
    let mut decoder = check(&data, image)?;
    decoder.decode_into(&mut image.data).map_err(failed)
}

/// Decodes some windows of images; its memory is reused.
#[derive(Debug, Default)]
pub(super) struct WindowDecoder {
    cropper: Cropper,
    pixels: Vec<u8>,
}

impl WindowDecoder {
    /// Decodes at least the windows (px) of a JPEG into rgb8; the image's other pixels are
    /// unspecified. Returns what is decoded, or `None` for everything.
    pub fn decode(
        &mut self,
        data: &[u8],
        windows: &[Window; 4],
        image: &mut OwnedImage,
    ) -> Result<Option<[Window; 4]>, ImageError> {
        let data = &*with_tables(data);
        let mut whole = check(data, image)?;
        let Some(Place { bounds: [left, top, right, bottom], exact }) =
            self.cropper.crop(data, windows)
        else {
            whole.decode_into(&mut image.data).map_err(failed)?;
            return Ok(None);
        };
        let step = 3 * (right - left);
        self.pixels.resize(step * (bottom - top), 0);
        open(&self.cropper.jpeg).decode_into(&mut self.pixels).map_err(failed)?;
        for [x0, y0, x1, y1] in exact {
            for y in y0..y1 {
                let (from, to) = ((y - top) * step + 3 * (x0 - left), y * image.step + 3 * x0);
                let length = 3 * (x1 - x0);
                image.data[to..to + length].copy_from_slice(&self.pixels[from..from + length]);
            }
        }
        Ok(Some(exact))
    }
}

fn failed(error: impl Debug) -> ImageError {
    ImageError::Decode { format: "jpeg", reason: format!("{error:?}") }
}

fn open(data: &[u8]) -> JpegDecoder<ZCursor<&[u8]>> {
    let options = DecoderOptions::default()
        .jpeg_set_out_colorspace(ColorSpace::RGB)
        .set_max_width(usize::from(u16::MAX))
        .set_max_height(usize::from(u16::MAX));
    JpegDecoder::new_with_options(ZCursor::new(data), options)
}

/// Checks all that is known before the pixels are decoded, and makes room for them.
fn check<'a>(
    data: &'a [u8],
    image: &mut OwnedImage,
) -> Result<JpegDecoder<ZCursor<&'a [u8]>>, ImageError> {
    let invalid = |reason: &str| ImageError::Decode { format: "jpeg", reason: reason.to_owned() };
    // The decoder fills what is missing with gray and would cut off markers.
    if is_cut_off(data) {
        return Err(invalid("it is cut off"));
    }
    let scans = count_scans(data);
    if scans > MAX_SCANS {
        return Err(ImageError::TooManyScans { scans, limit: MAX_SCANS });
    }
    let mut decoder = open(data);
    decoder.decode_headers().map_err(failed)?;
    match decoder.info().map_or(0, |info| info.components) {
        1 => return Err(ImageError::NoColor("gray jpeg".to_owned())),
        // YCbCr or RGB.
        3 => {}
        // Often with inverted values, which nothing in the image reveals.
        4 => return Err(ImageError::UnknownEncoding("CMYK or YCCK jpeg".to_owned())),
        n => return Err(ImageError::UnknownEncoding(format!("jpeg with {n} components"))),
    }
    let (width, height) = decoder.dimensions().ok_or_else(|| invalid("it has no size"))?;
    // No camera does this, and the decoder panics on some.
    if is_color_finer_than_luma(data, width, height) {
        return Err(invalid("its color is sampled finer than its brightness"));
    }
    let most = data.len().saturating_mul(PIXELS_PER_BYTE);
    check_claim(width, height, width * height, most, data.len())?;
    image.data.resize(width * height * 3, 0);
    (image.width, image.height, image.step, image.format) =
        (width, height, width * 3, PixelFormat::Rgb8);
    Ok(decoder)
}

/// Whether no end of image follows the last scan. Within a scan 0xff is only followed by 0 or a
/// restart marker, so an end after the last start of a scan is the image's own (a thumbnail in the
/// header has one too). Cameras pad what follows it.
fn is_cut_off(jpeg: &[u8]) -> bool {
    const END: [u8; 2] = [0xff, 0xd9];
    const SCAN: [u8; 2] = [0xff, 0xda];
    jpeg.windows(2).rev().find(|pair| *pair == END || *pair == SCAN) != Some(&END)
}

/// Counts the scans (ITU-T T.81, B.1.1.2): each start of a scan that is no part of another segment.
///
/// The decoder works through every block of the image in each scan, and its own limit of 100 scans
/// only applies after a decoding error (zune-jpeg 0.5.15, `mcu_prog.rs`).
fn count_scans(jpeg: &[u8]) -> usize {
    const SCAN: u8 = 0xda;
    let (mut at, mut scans) = (0, 0);
    while let Some(found) = jpeg.get(at..).and_then(|rest| memchr::memchr(0xff, rest)) {
        at += found + 1;
        let Some(&marker) = jpeg.get(at) else { break };
        match marker {
            // Fill bytes, a stuffed 0, restarts, start and end of the image have no length.
            0xff | 0x00 | 0x01 | 0xd0..=0xd9 => {}
            _ => {
                scans += usize::from(marker == SCAN);
                let length =
                    jpeg.get(at + 1..at + 3).map_or(0, |l| u16::from_be_bytes([l[0], l[1]]));
                at += 1 + usize::from(length);
            }
        }
    }
    scans
}

/// Whether a frame header of this size (ITU-T T.81, B.2.2) gives a component a larger sampling
/// factor than the first one, which is luma.
///
/// Any place that reads like one counts, with a marker before it or not: the decoder does not
/// report which one it used, and eight such bytes do not occur by chance.
fn is_color_finer_than_luma(jpeg: &[u8], width: usize, height: usize) -> bool {
    let side = |n: usize| u16::try_from(n).unwrap_or(u16::MAX).to_be_bytes();
    let ([h1, h0], [w1, w0]) = (side(height), side(width));
    // After its length: 8 bits, the size, the number of components, and three bytes of each.
    memchr::memmem::find_iter(jpeg, &[8, h1, h0, w1, w0]).any(|at| {
        let count = jpeg.get(at + 5).copied().unwrap_or(0);
        if !(2..=4).contains(&count) || !jpeg[..at].ends_with(&[0, 8 + 3 * count]) {
            return false;
        }
        let components = jpeg[at + 6..].chunks_exact(3).take(usize::from(count));
        let mut factors = components.map(|c| [c[1] >> 4, c[1] & 15]);
        let Some([across, down]) = factors.next() else { return false };
        factors.any(|[a, d]| a > across || d > down)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decode::fixtures::encoded;

    #[test]
    fn a_cut_off_image_differs_from_a_padded_one() {
        let head = [0xff, 0xd8, 0xff, 0xe1, 0xff, 0xd9, 0xff, 0xda, 1, 0xff, 0, 2, 0xff, 0xd0, 3];
        assert!(is_cut_off(&head) && is_cut_off(&[]) && is_cut_off(&[0xff]));
        let whole = [&head[..], &[0xff, 0xd9]].concat();
        assert!(!is_cut_off(&whole) && !is_cut_off(&[&whole[..], &[0; 9]].concat()));
        let cut = decode(&head, &mut OwnedImage::default()).unwrap_err().to_string();
        assert!(cut.contains("cut off"), "{cut}");
    }

    #[test]
    fn an_ordinary_progressive_image_is_decoded() {
        let jpeg = encoded(64, 64, |e| e.set_progressive_scans(10));
        assert!((10..MAX_SCANS).contains(&count_scans(&jpeg)), "{}", count_scans(&jpeg));
        decode(&jpeg, &mut OwnedImage::default()).unwrap();
    }

    #[test]
    fn another_color_space_is_rejected_by_its_name() {
        use jpeg_encoder::{ColorType, Encoder};
        let colors = [(ColorType::Cmyk, 4, "CMYK"), (ColorType::Luma, 1, "gray")];
        for (color, components, name) in colors {
            let mut jpeg = Vec::new();
            let pixels = vec![90u8; components * 16 * 16];
            Encoder::new(&mut jpeg, 90).encode(&pixels, 16, 16, color).unwrap();
            let error = decode(&jpeg, &mut OwnedImage::default()).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
    }

    #[test]
    fn an_image_with_2000_scans_is_rejected_before_it_is_decoded() {
        // The last scan of an ordinary image, repeated.
        let jpeg = encoded(64, 64, |e| e.set_progressive_scans(4));
        let last = jpeg.windows(2).rposition(|pair| pair == [0xff, 0xda]).unwrap();
        let (head, scan) = (&jpeg[..last], &jpeg[last..jpeg.len() - 2]);
        let bomb = [head, &scan.repeat(2000), &[0xff, 0xd9]].concat();
        let error = decode(&bomb, &mut OwnedImage::default()).unwrap_err();
        let scans = count_scans(head) + 2000;
        assert_eq!(error, ImageError::TooManyScans { scans, limit: MAX_SCANS });
    }
}
