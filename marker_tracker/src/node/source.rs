//! Frames of a camera device or a video file, and their messages.

use node_kit::convert;
use rig_model::Stamp;
use std::sync::Arc;
use volant_msgs::sensor_msgs::msg::{CompressedImage, Image};

/// One frame of a device or a file.
#[derive(Debug)]
pub struct Frame {
    pub(crate) stamp: Stamp,
    /// The driver's sequence number.
    pub(crate) sequence: Option<u32>,
    /// Encoding as in `sensor_msgs/Image`; `None` for a JPEG.
    pub(crate) encoding: Option<&'static str>,
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) step: u32,
    pub(crate) data: Vec<u8>,
}

/// The message of a frame.
pub(crate) enum ImageMessage {
    Raw(Arc<Image>),
    Compressed(Arc<CompressedImage>),
}

impl Frame {
    /// Turns the frame into a message in the frame `frame_id`.
    pub(crate) fn into_message(self, frame_id: &str) -> ImageMessage {
        let header = convert::header(frame_id, self.stamp);
        match self.encoding {
            Some(encoding) => ImageMessage::Raw(Arc::new(Image {
                header,
                height: self.height,
                width: self.width,
                encoding: encoding.to_owned(),
                is_bigendian: 0,
                step: self.step,
                data: self.data,
            })),
            None => ImageMessage::Compressed(Arc::new(CompressedImage {
                header,
                format: "jpeg".to_owned(),
                data: self.data,
            })),
        }
    }
}
