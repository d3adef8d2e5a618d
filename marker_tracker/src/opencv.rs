//! The one file that speaks to OpenCV: Bayer and YUV 4:2:2 into pixels, and the debug picture.

use crate::image::{ImageError, OwnedImage};

/// Bayer or YUV into rgb8.
pub(crate) fn convert(
    _width: usize,
    _height: usize,
    encoding: &str,
    _big_endian: bool,
    _step: usize,
    _data: &[u8],
    _scratch: &mut OwnedImage,
) -> Result<(), ImageError> {
    Err(ImageError::UnknownEncoding { encoding: encoding.to_owned() })
}
