//! Images as they come in: borrowed pixels with their layout, and the refusal of what cannot be read.

use rig_model::Stamp;
use thiserror::Error;

/// Order of the 8-bit channels in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PixelFormat {
    /// Red, green, blue.
    Rgb8,
    /// Blue, green, red.
    Bgr8,
    /// Red, green, blue, and one that is not looked at.
    Rgba8,
    /// Blue, green, red, and one that is not looked at.
    Bgra8,
}

impl PixelFormat {
    /// Bytes from one pixel to the next.
    pub const fn bytes_per_pixel(self) -> usize {
        match self {
            PixelFormat::Rgb8 | PixelFormat::Bgr8 => 3,
            PixelFormat::Rgba8 | PixelFormat::Bgra8 => 4,
        }
    }

    /// True where blue comes first.
    pub const fn blue_first(self) -> bool {
        matches!(self, PixelFormat::Bgr8 | PixelFormat::Bgra8)
    }

    /// The name in `sensor_msgs/Image.encoding`.
    pub const fn encoding(self) -> &'static str {
        match self {
            PixelFormat::Rgb8 => "rgb8",
            PixelFormat::Bgr8 => "bgr8",
            PixelFormat::Rgba8 => "rgba8",
            PixelFormat::Bgra8 => "bgra8",
        }
    }
}

/// Why an image cannot be used.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum ImageError {
    /// An encoding without colour.
    #[error(
        "image encoding `{encoding}` has no colour, and the markers are told by theirs; let the camera send rgb8, bgr8, Bayer or YUV 4:2:2"
    )]
    NoColor {
        /// As it stood in the message.
        encoding: String,
    },
    /// An encoding that is not handled.
    #[error(
        "image encoding `{encoding}` is not handled; use rgb8, bgr8, rgba8, bgra8, bayer_*8, bayer_*16, yuv422 (uyvy), yuv422_yuy2 (yuyv), jpeg or png"
    )]
    UnknownEncoding {
        /// As it stood in the message.
        encoding: String,
    },
    /// An encoding that needs the `opencv` feature.
    #[error(
        "image encoding `{encoding}` is converted by OpenCV, which this build leaves out; build with feature `opencv`"
    )]
    NeedsOpencv {
        /// As it stood in the message.
        encoding: String,
    },
    /// A width, height or step that cannot be.
    #[error(
        "image of {width}x{height} with step {step} and {length} bytes of data cannot be; the sender's fields contradict each other"
    )]
    Size {
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
        /// Bytes from one row to the next.
        step: usize,
        /// Bytes that there were.
        length: usize,
    },
    /// Compressed data that cannot be decoded.
    #[error("compressed image ({format}) cannot be decoded: {reason}; the frame is left out")]
    Decode {
        /// What it was taken for.
        format: &'static str,
        /// The decoder's words.
        reason: String,
    },
    /// Compressed data that claim more pixels than are taken, or than so few bytes can hold.
    #[error(
        "compressed image of {width}x{height} in {length} bytes is refused: a side has at most 16384 px, an image 2^25 px (8K) and no more than its bytes can hold"
    )]
    TooLarge {
        /// Width, px.
        width: usize,
        /// Height, px.
        height: usize,
        /// Bytes that there were.
        length: usize,
    },
    /// Neither jpeg nor png.
    #[error("compressed image of format `{format}` is neither jpeg nor png")]
    UnknownCompression {
        /// As it stood in the message.
        format: String,
    },
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
    /// Bytes from one row to the next.
    pub step: usize,
    /// Order of the channels.
    pub format: PixelFormat,
    /// `height` rows of `step` bytes (the last may end after its pixels).
    pub data: &'a [u8],
}

impl ImageView<'_> {
    /// Largest width and height that are taken, px.
    pub const MAX_SIDE: usize = 16_384;
    /// Most pixels that a compressed image may have: 7680 × 4320 is less. A raw one brings its bytes along.
    pub const MAX_PIXELS: usize = 1 << 25;

    /// Whether size, step and data agree.
    ///
    /// # Errors
    /// [`ImageError::Size`] where they do not.
    pub fn check(&self) -> Result<(), ImageError> {
        let row = self.width.checked_mul(self.format.bytes_per_pixel());
        let fits = match row {
            Some(row)
                if self.width > 0
                    && self.height > 0
                    && self.width <= Self::MAX_SIDE
                    && self.height <= Self::MAX_SIDE =>
            {
                self.step >= row
                    && (self.height - 1)
                        .checked_mul(self.step)
                        .and_then(|n| n.checked_add(row))
                        .is_some_and(|needed| self.data.len() >= needed)
            }
            _ => false,
        };
        if fits {
            Ok(())
        } else {
            Err(ImageError::Size {
                width: self.width,
                height: self.height,
                step: self.step,
                length: self.data.len(),
            })
        }
    }
}

/// Pixels of one image with their memory, which is kept from one image to the next.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OwnedImage {
    /// Width, px.
    pub width: usize,
    /// Height, px.
    pub height: usize,
    /// Bytes from one row to the next.
    pub step: usize,
    /// Order of the channels.
    pub format: PixelFormat,
    /// `height` rows of `step` bytes.
    pub data: Vec<u8>,
}

impl Default for OwnedImage {
    fn default() -> Self {
        Self { width: 0, height: 0, step: 0, format: PixelFormat::Rgb8, data: Vec::new() }
    }
}

impl OwnedImage {
    /// The pixels with the time at which they were taken.
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

/// The fields of a `sensor_msgs/Image` as a view. Three- and four-channel 8-bit images are borrowed; Bayer and YUV 4:2:2
/// ones are converted into `scratch`, whose memory is reused.
///
/// # Errors
/// An encoding without colour or one that is not handled, and sizes that contradict each other.
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
        "rgb8" | "8UC3_rgb" => PixelFormat::Rgb8,
        "bgr8" | "8UC3" => PixelFormat::Bgr8,
        "rgba8" => PixelFormat::Rgba8,
        "bgra8" | "8UC4" => PixelFormat::Bgra8,
        _ if encoding.starts_with("mono")
            || ["8UC1", "8SC1", "16UC1", "16SC1", "32FC1", "64FC1"].contains(&encoding) =>
        {
            return Err(ImageError::NoColor { encoding: encoding.to_owned() });
        }
        _ => return convert(stamp, width, height, encoding, big_endian, step, data, scratch),
    };
    let view = ImageView { stamp, width, height, step, format, data };
    view.check()?;
    Ok(view)
}

#[cfg(not(feature = "opencv"))]
#[allow(clippy::too_many_arguments)]
fn convert<'a>(
    _: Stamp,
    _: usize,
    _: usize,
    encoding: &str,
    _: bool,
    _: usize,
    _: &'a [u8],
    _: &'a mut OwnedImage,
) -> Result<ImageView<'a>, ImageError> {
    let encoding = encoding.to_owned();
    if encoding.starts_with("bayer_")
        || encoding.starts_with("yuv422")
        || encoding == "uyvy"
        || encoding == "yuyv"
    {
        Err(ImageError::NeedsOpencv { encoding })
    } else {
        Err(ImageError::UnknownEncoding { encoding })
    }
}

#[cfg(feature = "opencv")]
#[allow(clippy::too_many_arguments)]
fn convert<'a>(
    stamp: Stamp,
    width: usize,
    height: usize,
    encoding: &str,
    big_endian: bool,
    step: usize,
    data: &'a [u8],
    scratch: &'a mut OwnedImage,
) -> Result<ImageView<'a>, ImageError> {
    crate::opencv::convert(width, height, encoding, big_endian, step, data, scratch)?;
    Ok(scratch.view(stamp))
}
