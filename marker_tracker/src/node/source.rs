//! What a camera device or a video file gives, and the messages that it becomes.

use node_kit::convert;
use rig_model::Stamp;
use std::sync::Arc;
use volant_msgs::sensor_msgs::msg::{CompressedImage, Image};

/// One frame of a device or a file.
#[derive(Debug)]
pub struct Frame {
    pub(crate) stamp: Stamp,
    /// The driver's number of it.
    pub(crate) sequence: Option<u32>,
    /// ROS's name of the pixels; `None` for a JPEG.
    pub(crate) encoding: Option<&'static str>,
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) step: u32,
    pub(crate) data: Vec<u8>,
}

/// The message of a frame.
pub(crate) enum Picture {
    Raw(Arc<Image>),
    Compressed(Arc<CompressedImage>),
}

impl Frame {
    pub(crate) fn into_message(self, frame_id: &str) -> Picture {
        let header = convert::header(frame_id, self.stamp);
        match self.encoding {
            Some(encoding) => Picture::Raw(Arc::new(Image {
                header,
                height: self.height,
                width: self.width,
                encoding: encoding.to_owned(),
                is_bigendian: 0,
                step: self.step,
                data: self.data,
            })),
            None => Picture::Compressed(Arc::new(CompressedImage {
                header,
                format: "jpeg".to_owned(),
                data: self.data,
            })),
        }
    }
}
