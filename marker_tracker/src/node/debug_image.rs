//! Debug images as JPEG.

use crate::{debug_view::MarkerView, image::ImageView};
use rig_model::PerColor;

/// Draws and encodes a debug image (quality 80).
///
/// # Errors
/// OpenCV's reason, the encoder's, or a side of more than 65535 px.
pub(super) fn encode(
    view: &ImageView<'_>,
    markers: &PerColor<MarkerView>,
) -> Result<Vec<u8>, String> {
    let image = crate::opencv::draw(view, markers)?;
    let (width, height) = (u16::try_from(image.width), u16::try_from(image.height));
    let (Ok(width), Ok(height)) = (width, height) else {
        return Err("a side is larger than 65535 px".to_owned());
    };
    let mut data = Vec::new();
    jpeg_encoder::Encoder::new(&mut data, 80)
        .encode(&image.data, width, height, jpeg_encoder::ColorType::Rgb)
        .map_err(|e| e.to_string())?;
    Ok(data)
}
