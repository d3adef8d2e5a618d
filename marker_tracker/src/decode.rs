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

fn decode_jpeg(data: &[u8], image: &mut OwnedImage) -> Result<(), ImageError> {
    let failed = |reason: String| ImageError::Decode { format: "jpeg", reason };
    let options = DecoderOptions::default()
        .jpeg_set_out_colorspace(ColorSpace::RGB)
        .set_max_width(ImageView::MAX_SIDE)
        .set_max_height(ImageView::MAX_SIDE);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(data), options);
    decoder.decode_headers().map_err(|e| failed(format!("{e:?}")))?;
    if decoder.input_colorspace() == Some(ColorSpace::Luma) {
        return Err(ImageError::NoColor { encoding: "grey jpeg".to_owned() });
    }
    let (width, height) = decoder.dimensions().ok_or_else(|| failed("it has no size".to_owned()))?;
    image.data.resize(width * height * 3, 0);
    decoder.decode_into(&mut image.data).map_err(|e| failed(format!("{e:?}")))?;
    (image.width, image.height, image.step, image.format) = (width, height, width * 3, PixelFormat::Rgb8);
    Ok(())
}

fn decode_png(data: &[u8], image: &mut OwnedImage) -> Result<(), ImageError> {
    let failed = |reason: String| ImageError::Decode { format: "png", reason };
    let mut decoder = png::Decoder::new(Cursor::new(data));
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let mut reader = decoder.read_info().map_err(|e| failed(e.to_string()))?;
    let (color, _) = reader.output_color_type();
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    if width > ImageView::MAX_SIDE || height > ImageView::MAX_SIDE {
        return Err(ImageError::Size { width, height, step: 0, length: data.len() });
    }
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
