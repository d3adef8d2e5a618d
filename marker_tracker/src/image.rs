//! Images: borrowed or owned pixels with their layout, and the errors of unusable ones.

use rig_model::Stamp;
use std::{cell::Cell, ops::Deref};
use thiserror::Error;

/// Order of the 8-bit channels in memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// Red, green, blue.
    #[default]
    Rgb8,
    /// Blue, green, red.
    Bgr8,
    /// Red, green, blue, and an ignored one.
    Rgba8,
    /// Blue, green, red, and an ignored one.
    Bgra8,
}

impl PixelFormat {
    /// Bytes from pixel to pixel.
    pub const fn bytes_per_pixel(self) -> usize {
        match self {
            PixelFormat::Rgb8 | PixelFormat::Bgr8 => 3,
            PixelFormat::Rgba8 | PixelFormat::Bgra8 => 4,
        }
    }

    /// Whether blue comes first.
    pub const fn blue_first(self) -> bool {
        matches!(self, PixelFormat::Bgr8 | PixelFormat::Bgra8)
    }
}

/// Why an image cannot be used.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ImageError {
    /// An encoding without color, as in the message.
    #[error(
        "image encoding `{0}` has no color, which identifies the markers; set the camera to \
         rgb8, bgr8, Bayer or YUV 4:2:2"
    )]
    NoColor(String),
    /// An encoding that is not supported, as in the message.
    #[error(
        "image encoding `{0}` is not supported; use rgb8, bgr8, rgba8, bgra8, bayer_*8, \
         bayer_*16, yuv422 (uyvy), yuv422_yuy2 (yuyv), jpeg (YCbCr or RGB) or png"
    )]
    UnknownEncoding(String),
    /// An encoding that needs the `opencv` feature, as in the message.
    #[error(
        "image encoding `{0}` is converted by OpenCV, which this build omits; build with \
         feature `opencv`"
    )]
    NeedsOpencv(String),
    /// 16-bit values of which the upper bits are not used.
    #[error(
        "image encoding `{encoding}` with values up to {largest} of 65535: they are in the low \
         bits, or the image is black; set the camera to 8 bits or to values in the high bits, or \
         raise the exposure"
    )]
    LowBits {
        /// As in the message.
        encoding: String,
        /// Largest value in the image.
        largest: u16,
    },
    /// An invalid width, height or step.
    #[error(
        "image of {width}x{height} with step {step} and {length} bytes of data: a side must have 1 \
         to 16384 px (Bayer: at least 2, YUV: an even width), and step and data must hold them; \
         check the camera driver"
    )]
    Size {
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
        /// Bytes from row to row.
        step: usize,
        /// Bytes of data.
        length: usize,
    },
    /// Invalid compressed data.
    #[error("compressed image ({format}) is invalid: {reason}; the image is ignored")]
    Decode {
        /// Detected format.
        format: &'static str,
        /// The decoder's reason.
        reason: String,
    },
    /// Compressed data that claim more pixels than are supported, or than their bytes can hold.
    #[error(
        "compressed image of {width}x{height} in {length} bytes is rejected: a side has at most \
         16384 px, an image 2^25 px (8K) and no more than its bytes can hold"
    )]
    TooLarge {
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
        /// Bytes of data.
        length: usize,
    },
    /// A progressive JPEG whose decoding would take too long.
    #[error(
        "compressed image has {scans} scans and is rejected: at most {limit} are decoded; set the \
         camera to baseline JPEG"
    )]
    TooManyScans {
        /// Number of scans.
        scans: usize,
        /// Largest supported number.
        limit: usize,
    },
    /// A format, as in the message, that is neither jpeg nor png.
    #[error("compressed image of format `{0}` is neither jpeg nor png; set the camera to one")]
    UnknownCompression(String),
}

/// Borrowed pixels of one image.
#[derive(Clone, Copy, Debug)]
pub struct ImageView<'a> {
    /// Middle of the exposure.
    pub stamp: Stamp,
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Bytes from row to row.
    pub step: usize,
    /// Order of the channels.
    pub format: PixelFormat,
    /// `height` rows of `step` bytes (the last may end after its pixels).
    pub data: &'a [u8],
}

impl ImageView<'_> {
    /// Largest width and height, px.
    pub const MAX_SIDE: usize = 16_384;
    /// Largest number of pixels of a compressed image: 7680 × 4320 is less. (A raw one carries its
    /// bytes.)
    pub const MAX_PIXELS: usize = 1 << 25;

    /// Whether size (px), step, bytes of a row's pixels and bytes of data agree.
    pub(crate) fn fits(w: usize, h: usize, step: usize, row: usize, length: usize) -> bool {
        let sides = 1..=Self::MAX_SIDE;
        let needed = step.checked_mul(h.saturating_sub(1)).and_then(|n| n.checked_add(row));
        sides.contains(&w)
            && sides.contains(&h)
            && step >= row
            && needed.is_some_and(|needed| length >= needed)
    }

    /// The pixels as r, g, b without padding; fields that contradict each other panic.
    pub fn to_rgb(&self) -> Vec<u8> {
        let bytes = self.format.bytes_per_pixel();
        let order = if self.format.blue_first() { [2, 1, 0] } else { [0, 1, 2] };
        let rows = (0..self.height).map(|y| &self.data[y * self.step..][..self.width * bytes]);
        rows.flat_map(|row| row.chunks_exact(bytes).flat_map(|p| order.map(|c| p[c]))).collect()
    }

    /// Checks that size, step and data agree.
    ///
    /// # Errors
    /// [`ImageError::Size`] where they do not.
    pub fn check(&self) -> Result<(), ImageError> {
        let Self { width, height, step, format, data, .. } = *self;
        let (row, length) = (width.saturating_mul(format.bytes_per_pixel()), data.len());
        let fits = Self::fits(width, height, step, row, length);
        if fits { Ok(()) } else { Err(ImageError::Size { width, height, step, length }) }
    }
}

/// A rectangle: left, top, right, bottom (the last two excluded), px.
pub(crate) type Window = [usize; 4];

/// The windows of an image that are decoded, and whether anything else was read.
#[derive(Debug, Default)]
pub(crate) struct Coverage {
    windows: [Window; 4],
    missed: Cell<bool>,
}

impl Coverage {
    /// Records that the pixels from column `x0` and row `y0` to `x1` and `y1` (both included, px)
    /// are read.
    #[inline(always)]
    pub fn read(&self, [x0, y0]: [i32; 2], [x1, y1]: [i32; 2]) {
        let within = |w: &Window| {
            x0 >= w[0] as i32 && y0 >= w[1] as i32 && x1 < w[2] as i32 && y1 < w[3] as i32
        };
        if !self.windows.iter().any(within) {
            self.missed.set(true);
        }
    }
}

/// An image as a tracker reads it: whole, or in part and watched for what is missing.
#[derive(Debug)]
pub(crate) struct Pixels<'a> {
    view: ImageView<'a>,
    /// The windows, where the image is not decoded as a whole.
    pub coverage: Option<Coverage>,
    /// The image as it was compressed; `None` for a raw one.
    pub compressed: Option<&'a [u8]>,
}

impl<'a> Pixels<'a> {
    /// A whole image.
    pub fn whole(view: ImageView<'a>, compressed: Option<&'a [u8]>) -> Self {
        Self { view, coverage: None, compressed }
    }

    /// A compressed image of which these windows are decoded.
    pub fn partial(view: ImageView<'a>, windows: [Window; 4], compressed: &'a [u8]) -> Self {
        let coverage = Coverage { windows, missed: Cell::new(false) };
        Self { view, coverage: Some(coverage), compressed: Some(compressed) }
    }

    /// Whether anything was read that is not decoded.
    pub fn is_missing(&self) -> bool {
        self.coverage.as_ref().is_some_and(|c| c.missed.get())
    }
}

impl<'a> Deref for Pixels<'a> {
    type Target = ImageView<'a>;

    fn deref(&self) -> &ImageView<'a> {
        &self.view
    }
}

/// Pixels of one image with their memory, which is reused from image to image.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct OwnedImage {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Bytes from row to row.
    pub step: usize,
    /// Order of the channels.
    pub format: PixelFormat,
    /// `height` rows of `step` bytes.
    pub data: Vec<u8>,
}

impl OwnedImage {
    /// The pixels with their stamp (middle of the exposure).
    pub fn view(&self, stamp: Stamp) -> ImageView<'_> {
        ImageView {
            stamp,
            width: self.width,
            height: self.height,
            step: self.step,
            format: self.format,
            data: &self.data,
        }
    }
}

#[cfg(test)]
pub(crate) mod fixtures {
    use super::{OwnedImage, PixelFormat, Window};

    /// A gray rgb8 image with rectangles of other colors.
    pub fn drawn(
        width: usize,
        height: usize,
        gray: u8,
        rectangles: &[(Window, [u8; 3])],
    ) -> OwnedImage {
        let step = 3 * width;
        let mut data = vec![gray; step * height];
        for ([x0, y0, x1, y1], rgb) in rectangles {
            for row in data.chunks_exact_mut(step).take(*y1).skip(*y0) {
                row[3 * x0..3 * x1].copy_from_slice(&rgb.repeat(x1 - x0));
            }
        }
        OwnedImage { width, height, step, format: PixelFormat::Rgb8, data }
    }
}
