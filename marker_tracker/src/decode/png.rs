//! PNG.

use crate::{
    decode::check_claim,
    image::{ImageError, OwnedImage, PixelFormat},
};
use std::io::Cursor;

/// Largest number of bytes that DEFLATE makes of one, rounded up.
const BYTES_PER_BYTE: usize = 1040;
/// Memory for what precedes the pixels (a profile, texts), bytes.
const HEADER: usize = 1 << 22;

/// Decodes a PNG into rgb8 or rgba8.
pub(super) fn decode(data: &[u8], image: &mut OwnedImage) -> Result<(), ImageError> {
    let failed = |reason: String| ImageError::Decode { format: "png", reason };
    let limits = ::png::Limits { bytes: HEADER };
    let mut decoder = ::png::Decoder::new_with_limits(Cursor::new(data), limits);
    decoder.set_transformations(::png::Transformations::EXPAND | ::png::Transformations::STRIP_16);
    // The size first: the decoder's own memory grows with it.
    let (width, height) = {
        let header = decoder.read_header_info().map_err(|e| failed(e.to_string()))?;
        (header.width as usize, header.height as usize)
    };
    check_claim(width, height, 0, 0, data.len())?;
    let mut reader = decoder.read_info().map_err(|e| failed(e.to_string()))?;
    // The decoder panics where the palette's last color is cut off.
    if reader.info().palette.as_ref().is_some_and(|p| p.len() % 3 != 0) {
        return Err(failed("its palette ends within a color".to_owned()));
    }
    let (color, _) = reader.output_color_type();
    let needed = reader.info().raw_bytes();
    check_claim(width, height, needed, data.len().saturating_mul(BYTES_PER_BYTE), data.len())?;
    let format = match color {
        ::png::ColorType::Rgb => PixelFormat::Rgb8,
        ::png::ColorType::Rgba => PixelFormat::Rgba8,
        _ => return Err(ImageError::NoColor("gray png".to_owned())),
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
    fn an_invalid_palette_is_rejected() {
        let with = |palette: Vec<u8>| {
            let mut bytes = Vec::new();
            let mut encoder = ::png::Encoder::new(&mut bytes, 4, 4);
            encoder.set_color(::png::ColorType::Indexed);
            encoder.set_palette(palette);
            let mut writer = encoder.write_header().unwrap();
            writer.write_image_data(&[1; 16]).unwrap();
            writer.finish().unwrap();
            let mut image = OwnedImage::default();
            decode(&bytes, &mut image).map(|()| image)
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
