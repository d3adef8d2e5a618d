//! Decoding of `sensor_msgs/CompressedImage`: JPEG and PNG.

mod crop;
mod jpeg;
mod partial;
mod png;
mod tables;

pub use partial::{Decoder, PartialImage};

use crate::image::{ImageError, ImageView, OwnedImage};

/// Allowance, so that a small image need not fill its size, bytes or pixels.
const SMALL: usize = 1 << 16;

/// Decodes a compressed image into rgb8 or rgba8. Its first bytes determine the format; `format`
/// (the message's field) only appears in errors, since cameras fill it in many ways.
///
/// # Errors
/// [`ImageError::UnknownCompression`] for anything but JPEG and PNG, [`ImageError::TooLarge`] and
/// [`ImageError::TooManyScans`] before any work is done, [`ImageError::Decode`] with the decoder's
/// reason, [`ImageError::NoColor`] for gray images, [`ImageError::UnknownEncoding`] for CMYK.
pub fn decode_compressed(format: &str, data: &[u8]) -> Result<OwnedImage, ImageError> {
    let mut image = OwnedImage::default();
    decode_compressed_into(format, data, &mut image)?;
    Ok(image)
}

/// Decodes a compressed image like [`decode_compressed`] into an image whose memory is reused.
///
/// # Errors
/// As [`decode_compressed`]; the image's contents are then unspecified.
pub fn decode_compressed_into(
    format: &str,
    data: &[u8],
    image: &mut OwnedImage,
) -> Result<(), ImageError> {
    if is_jpeg(data) {
        jpeg::decode(data, image)
    } else if data.starts_with(&[0x89, b'P', b'N', b'G']) {
        png::decode(data, image)
    } else {
        Err(ImageError::UnknownCompression(received(format, data)))
    }
}

/// Describes what was received: the message's format and the first bytes.
fn received(format: &str, data: &[u8]) -> String {
    let first: Vec<String> = data.iter().take(4).map(|byte| format!("{byte:02x}")).collect();
    format!("{format}, {} bytes {}", data.len(), first.join(" ")).trim_end().to_owned()
}

fn is_jpeg(data: &[u8]) -> bool {
    data.starts_with(&[0xff, 0xd8, 0xff])
}

/// Checks a claimed size (px) before memory is allocated for it: `needed` may not exceed `most`,
/// which is what `length` bytes can hold.
///
/// # Errors
/// [`ImageError::TooLarge`].
fn check_claim(
    width: usize,
    height: usize,
    needed: usize,
    most: usize,
    length: usize,
) -> Result<(), ImageError> {
    let small_side = width <= ImageView::MAX_SIDE && height <= ImageView::MAX_SIDE;
    // With both sides below 2^14 nothing overflows.
    if small_side && width * height <= ImageView::MAX_PIXELS && needed <= most.saturating_add(SMALL)
    {
        Ok(())
    } else {
        Err(ImageError::TooLarge { width, height, length })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn data_of_another_format_are_named_by_their_first_bytes() {
        for (data, words) in [
            (&b"RIFF-WEBP"[..], "`jpeg, 9 bytes 52 49 46 46` is neither jpeg nor png"),
            (&[], "`jpeg, 0 bytes` is neither"),
        ] {
            let error = decode_compressed("jpeg", data).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
    }
}

#[cfg(test)]
mod fixtures {
    use crate::image::{OwnedImage, Window};
    use jpeg_encoder::{ColorType, Encoder};

    /// A JPEG of a colored image with noise, so that no block is like another.
    pub fn encoded(
        width: u16,
        height: u16,
        change: impl Fn(&mut Encoder<&mut Vec<u8>>),
    ) -> Vec<u8> {
        let pixels: Vec<u8> = (0..u32::from(width) * u32::from(height) * 3)
            .map(|i| (i / 7 % 200) as u8 + (i.wrapping_mul(2_654_435_761) >> 29) as u8)
            .collect();
        let mut jpeg = Vec::new();
        let mut encoder = Encoder::new(&mut jpeg, 85);
        change(&mut encoder);
        encoder.encode(&pixels, width, height, ColorType::Rgb).unwrap();
        jpeg
    }

    /// Asserts that two images have the same pixels in a window.
    pub fn assert_same(a: &OwnedImage, b: &OwnedImage, [x0, y0, x1, y1]: Window, what: &str) {
        for y in y0..y1 {
            let row = y * a.step + 3 * x0..y * a.step + 3 * x1;
            assert_eq!(a.data[row.clone()], b.data[row], "{what}: {y}");
        }
    }
}
