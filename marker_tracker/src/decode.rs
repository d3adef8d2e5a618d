//! JPEG and PNG into pixels.

use crate::image::{ImageError, ImageView, OwnedImage, PixelFormat};
use std::io::Cursor;
use zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions};
use zune_jpeg::JpegDecoder;

/// A `sensor_msgs/CompressedImage` decoded into rgb8. What it is is read from its first bytes; `format` (the message's
/// field) serves the error's text only, since cameras fill it in many ways.
///
/// # Errors
/// [`ImageError::UnknownCompression`] or [`ImageError::Decode`] with the decoder's reason; grey pictures are refused
/// ([`ImageError::NoColor`]).
pub fn decode_compressed(format: &str, data: &[u8]) -> Result<OwnedImage, ImageError> {
    let mut image = OwnedImage::default();
    decode_compressed_into(format, data, &mut image)?;
    Ok(image)
}

/// [`decode_compressed`] into an image whose memory is reused.
///
/// # Errors
/// As [`decode_compressed`]; the image's contents are then unspecified.
pub fn decode_compressed_into(format: &str, data: &[u8], image: &mut OwnedImage) -> Result<(), ImageError> {
    if data.starts_with(&[0xff, 0xd8, 0xff]) {
        decode_jpeg(data, image)
    } else if data.starts_with(&[0x89, b'P', b'N', b'G']) {
        decode_png(data, image)
    } else {
        Err(ImageError::UnknownCompression { format: format.to_owned() })
    }
}

/// Pixels per byte of a JPEG at most. Its emptiest block of 64 (or, with chroma halved, 170 per block) takes two bits.
const JPEG_PIXELS_PER_BYTE: usize = 2048;
/// DEFLATE makes at most 1032 bytes of one.
const PNG_BYTES_PER_BYTE: usize = 1040;
/// What is allowed beside, so that a small image need not be a full one.
const SMALL: usize = 1 << 16;

/// Refuses what a few bytes claim to be, before memory is taken for it. `needed` is what `most` of it must hold.
fn check_claim(
    width: usize,
    height: usize,
    needed: usize,
    most: usize,
    length: usize,
) -> Result<(), ImageError> {
    let small_side = width <= ImageView::MAX_SIDE && height <= ImageView::MAX_SIDE;
    // With both sides below 2^14 nothing overflows.
    if small_side && width * height <= ImageView::MAX_PIXELS && needed <= most.saturating_add(SMALL) {
        Ok(())
    } else {
        Err(ImageError::TooLarge { width, height, length })
    }
}

fn decode_jpeg(data: &[u8], image: &mut OwnedImage) -> Result<(), ImageError> {
    let failed = |reason: String| ImageError::Decode { format: "jpeg", reason };
    // The decoder fills what is missing with grey: markers would be cut off where the picture is.
    if is_cut_off(data) {
        return Err(failed("it is cut off".to_owned()));
    }
    let options = DecoderOptions::default()
        .jpeg_set_out_colorspace(ColorSpace::RGB)
        .set_max_width(usize::from(u16::MAX))
        .set_max_height(usize::from(u16::MAX));
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(data), options);
    decoder.decode_headers().map_err(|e| failed(format!("{e:?}")))?;
    if decoder.input_colorspace() == Some(ColorSpace::Luma) {
        return Err(ImageError::NoColor { encoding: "grey jpeg".to_owned() });
    }
    let (width, height) = decoder.dimensions().ok_or_else(|| failed("it has no size".to_owned()))?;
    // No camera does, and the decoder panics on some.
    if is_color_finer_than_luma(data, width, height) {
        return Err(failed("its colour is sampled finer than its brightness".to_owned()));
    }
    let most = data.len().saturating_mul(JPEG_PIXELS_PER_BYTE);
    check_claim(width, height, width * height, most, data.len())?;
    image.data.resize(width * height * 3, 0);
    decoder.decode_into(&mut image.data).map_err(|e| failed(format!("{e:?}")))?;
    (image.width, image.height, image.step, image.format) = (width, height, width * 3, PixelFormat::Rgb8);
    Ok(())
}

/// Within a scan, 0xff is followed by 0 or a restart marker only, so an end of image after the last start of a scan is the
/// picture's own (a thumbnail in the header has one too). Cameras pad what follows it.
fn is_cut_off(jpeg: &[u8]) -> bool {
    const END: [u8; 2] = [0xff, 0xd9];
    const SCAN: [u8; 2] = [0xff, 0xda];
    jpeg.windows(2).rev().find(|pair| *pair == END || *pair == SCAN) != Some(&END)
}

/// Whether a frame header of this size (ITU-T T.81, B.2.2) gives a component a larger sampling factor than the first one, which is luma.
///
/// Any place that reads like one counts, with a marker before it or not: which one the decoder took it does not tell, and by chance eight
/// such bytes do not occur.
fn is_color_finer_than_luma(jpeg: &[u8], width: usize, height: usize) -> bool {
    let side = |n: usize| u16::try_from(n).unwrap_or(u16::MAX).to_be_bytes();
    let ([h1, h0], [w1, w0]) = (side(height), side(width));
    // After its length: 8 bits, the size, how many components, and three bytes of each.
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

fn decode_png(data: &[u8], image: &mut OwnedImage) -> Result<(), ImageError> {
    let failed = |reason: String| ImageError::Decode { format: "png", reason };
    // What comes before the pixels (a profile, texts) is bounded too.
    let limits = png::Limits { bytes: 1 << 22 };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(data), limits);
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    // The size first: what the decoder takes for itself grows with it.
    let (width, height) = {
        let header = decoder.read_header_info().map_err(|e| failed(e.to_string()))?;
        (header.width as usize, header.height as usize)
    };
    check_claim(width, height, 0, 0, data.len())?;
    let mut reader = decoder.read_info().map_err(|e| failed(e.to_string()))?;
    // The decoder goes through a palette in threes, and panics where a colour is cut off.
    if reader.info().palette.as_ref().is_some_and(|p| p.len() % 3 != 0) {
        return Err(failed("its palette ends within a colour".to_owned()));
    }
    let (color, _) = reader.output_color_type();
    let needed = reader.info().raw_bytes();
    check_claim(width, height, needed, data.len().saturating_mul(PNG_BYTES_PER_BYTE), data.len())?;
    let format = match color {
        png::ColorType::Rgb => PixelFormat::Rgb8,
        png::ColorType::Rgba => PixelFormat::Rgba8,
        _ => return Err(ImageError::NoColor { encoding: "grey png".to_owned() }),
    };
    let size = reader.output_buffer_size().ok_or_else(|| failed("it is too large".to_owned()))?;
    image.data.resize(size, 0);
    reader.next_frame(&mut image.data).map_err(|e| failed(e.to_string()))?;
    (image.width, image.height, image.step, image.format) =
        (width, height, width * format.bytes_per_pixel(), format);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_that_is_cut_off_is_told_from_one_that_is_padded() {
        let head = [0xff, 0xd8, 0xff, 0xe1, 0xff, 0xd9, 0xff, 0xda, 1, 0xff, 0, 2, 0xff, 0xd0, 3];
        assert!(is_cut_off(&head) && is_cut_off(&[]) && is_cut_off(&[0xff]));
        let whole = [&head[..], &[0xff, 0xd9]].concat();
        assert!(!is_cut_off(&whole) && !is_cut_off(&[&whole[..], &[0; 9]].concat()));
        let cut = decode_compressed("jpeg", &head).unwrap_err().to_string();
        assert!(cut.contains("cut off"), "{cut}");
    }
    #[test]
    fn a_palette_that_cannot_be_is_refused() {
        let with = |palette: Vec<u8>| {
            let mut bytes = Vec::new();
            let mut encoder = png::Encoder::new(&mut bytes, 4, 4);
            encoder.set_color(png::ColorType::Indexed);
            encoder.set_palette(palette);
            let mut writer = encoder.write_header().unwrap();
            writer.write_image_data(&[1; 16]).unwrap();
            writer.finish().unwrap();
            decode_compressed("png", &bytes)
        };
        let whole = with([9, 90, 200].repeat(256)).unwrap();
        assert_eq!(whole.data[..3], [9, 90, 200]);
        for length in [4, 8, 766, 767] {
            let error = with(vec![9; length]).unwrap_err().to_string();
            assert!(error.contains("palette"), "{error}");
        }
        assert!(with(vec![9; 900]).is_err());
    }
}
