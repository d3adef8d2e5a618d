//! A compressed image, decoded as far as the tracker needs it.

use crate::{
    decode::{decode_compressed_into, is_jpeg, jpeg},
    image::{ImageError, ImageView, OwnedImage, Pixels, Window},
    tracker::Tracker,
};
use rig_model::Stamp;

/// Decodes the compressed images of one camera; its memory is reused from image to image.
#[derive(Debug, Default)]
pub struct Decoder {
    image: OwnedImage,
    windows: jpeg::WindowDecoder,
}

/// A compressed image with the pixels that have been decoded.
#[derive(Debug)]
pub struct PartialImage<'a> {
    stamp: Stamp,
    format: &'a str,
    data: &'a [u8],
    decoder: &'a mut Decoder,
    /// The decoded windows; `None` where everything is.
    windows: Option<[Window; 4]>,
}

impl Decoder {
    /// Decodes a compressed image: of a JPEG only what `tracker` will probably read, where one is
    /// given. `stamp`: middle of the exposure; the others as in
    /// [`decode_compressed`](crate::decode_compressed).
    ///
    /// # Errors
    /// As [`decode_compressed`](crate::decode_compressed).
    pub fn decode<'a>(
        &'a mut self,
        stamp: Stamp,
        format: &'a str,
        data: &'a [u8],
        tracker: Option<&Tracker>,
    ) -> Result<PartialImage<'a>, ImageError> {
        let windows = match tracker.and_then(|t| t.windows(stamp)) {
            Some(windows) if is_jpeg(data) => {
                self.windows.decode(data, &windows, &mut self.image)?
            }
            _ => {
                decode_compressed_into(format, data, &mut self.image)?;
                None
            }
        };
        Ok(PartialImage { stamp, format, data, decoder: self, windows })
    }
}

impl PartialImage<'_> {
    /// The whole image.
    ///
    /// # Errors
    /// As [`decode_compressed`](crate::decode_compressed).
    pub fn whole(&mut self) -> Result<ImageView<'_>, ImageError> {
        if self.windows.is_some() {
            decode_compressed_into(self.format, self.data, &mut self.decoder.image)?;
            self.windows = None;
        }
        Ok(self.view())
    }

    /// Whether only some windows of it are decoded.
    pub fn is_partial(&self) -> bool {
        self.windows.is_some()
    }

    /// Width and height, px.
    pub fn size(&self) -> (usize, usize) {
        (self.decoder.image.width, self.decoder.image.height)
    }

    /// The image, of which only some windows may be decoded.
    pub(crate) fn view(&self) -> ImageView<'_> {
        self.decoder.image.view(self.stamp)
    }

    /// The pixels that are decoded.
    pub(crate) fn pixels(&self) -> Pixels<'_> {
        match self.windows {
            Some(windows) => Pixels::partial(self.view(), windows, self.data),
            None => Pixels::whole(self.view(), Some(self.data)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_damaged_image_stays_damaged() {
        let (stamp, mut decoder) = (Stamp::from_nanos(0), Decoder::default());
        let data = &[0xFF, 0xD8, 0xFF, 0xE0];
        let windows = Some([Window::default(); 4]);
        let mut image =
            PartialImage { stamp, format: "jpeg", data, decoder: &mut decoder, windows };
        for _ in 0..2 {
            assert!(image.whole().is_err());
        }
    }
}
