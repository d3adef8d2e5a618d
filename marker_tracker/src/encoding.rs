//! Raw images as `sensor_msgs/Image` carries them.

use crate::image::{ImageError, ImageView, OwnedImage, PixelFormat};
use rig_model::Stamp;

/// Views the fields of a `sensor_msgs/Image`. Three- and four-channel 8-bit images are borrowed;
/// Bayer and YUV 4:2:2 ones are converted into `scratch`, whose memory is reused.
///
/// # Errors
/// [`ImageError::NoColor`], [`ImageError::UnknownEncoding`] or [`ImageError::NeedsOpencv`] for the
/// encoding; [`ImageError::Size`] where size, step and data contradict each other;
/// [`ImageError::LowBits`] where 16-bit values use the low bits only.
#[allow(clippy::too_many_arguments)] // the fields of the message, in its order
pub fn from_encoding<'a>(
    stamp: Stamp,
    width: usize,
    height: usize,
    encoding: &str,
    big_endian: bool,
    step: usize,
    data: &'a [u8],
    scratch: &'a mut OwnedImage,
) -> Result<ImageView<'a>, ImageError> {
    let format = match encoding {
        "rgb8" => PixelFormat::Rgb8,
        "bgr8" | "8UC3" => PixelFormat::Bgr8,
        "rgba8" => PixelFormat::Rgba8,
        "bgra8" | "8UC4" => PixelFormat::Bgra8,
        _ if encoding.starts_with("mono")
            || ["8UC1", "8SC1", "16UC1", "16SC1", "32FC1", "64FC1"].contains(&encoding) =>
        {
            return Err(ImageError::NoColor(encoding.to_owned()));
        }
        #[cfg(feature = "opencv")]
        _ => {
            crate::opencv::convert(width, height, encoding, big_endian, step, data, scratch)?;
            return Ok(scratch.view(stamp));
        }
        #[cfg(not(feature = "opencv"))]
        _ => {
            let _ = (big_endian, scratch);
            let is_known = ["bayer_", "yuv422"].iter().any(|start| encoding.starts_with(start))
                || ["uyvy", "yuyv"].contains(&encoding);
            let encoding = encoding.to_owned();
            return Err(match is_known {
                true => ImageError::NeedsOpencv(encoding),
                false => ImageError::UnknownEncoding(encoding),
            });
        }
    };
    let view = ImageView { stamp, width, height, step, format, data };
    view.check()?;
    Ok(view)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_encoding_without_color_is_rejected_with_the_remedy() {
        for encoding in ["mono8", "mono16", "8UC1", "16UC1", "32FC1"] {
            let (stamp, mut scratch) = (Stamp::from_nanos(0), OwnedImage::default());
            let error = from_encoding(stamp, 2, 1, encoding, false, 8, &[0; 8], &mut scratch)
                .unwrap_err()
                .to_string();
            assert!(error.contains(encoding) && error.contains("set the camera to"), "{error}");
        }
    }
}
