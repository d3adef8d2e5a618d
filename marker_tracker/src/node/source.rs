//! Frames of a camera device or a video file.

use super::{Arrival, MarkerTrackerNode};
use node_kit::{Level, NodeContext, convert};
use rig_model::Stamp;
use std::sync::Arc;
use volant_msgs::sensor_msgs::msg::{CompressedImage, Image};

/// One frame of a device or a file.
#[derive(Debug)]
pub struct Frame {
    pub(crate) stamp: Stamp,
    /// Number of the frame, as the driver counts.
    pub(crate) sequence: u32,
    /// Encoding as in `sensor_msgs/Image`; `None` for a JPEG.
    pub(crate) encoding: Option<&'static str>,
    pub(crate) width: u32,
    pub(crate) height: u32,
    pub(crate) step: u32,
    pub(crate) data: Vec<u8>,
}

impl MarkerTrackerNode {
    /// Publishes and processes a frame.
    pub(super) fn frame(&mut self, context: &mut NodeContext<Arrival>, frame: Frame) {
        let Some(out) = &mut self.republished else { return };
        if let Some(before) = out.sequence {
            let now = frame.sequence;
            let skipped = now.wrapping_sub(before).wrapping_sub(1);
            // A number that goes back belongs to a reopened camera.
            if skipped > 0 && skipped < 1000 {
                context.log_throttled(
                    Level::Warn,
                    "lost",
                    format!(
                        "{skipped} images before number {now} are missing: the source lost them, \
                         or the node is too slow for its rate and dropped them"
                    ),
                );
            }
        }
        out.sequence = Some(frame.sequence);
        let frame_id = &self.rig.frames.camera;
        if let Some(camera) = &self.camera {
            out.info.publish(convert::camera_message(frame_id, frame.stamp, camera));
        }
        let header = convert::header(frame_id, frame.stamp);
        if let Some(encoding) = frame.encoding {
            let message = Arc::new(Image {
                header,
                height: frame.height,
                width: frame.width,
                encoding: encoding.to_owned(),
                is_bigendian: 0,
                step: frame.step,
                data: frame.data,
            });
            out.raw.publish_shared(Arc::clone(&message));
            self.raw(context, &message);
        } else {
            let format = "jpeg".to_owned();
            let message = Arc::new(CompressedImage { header, format, data: frame.data });
            out.compressed.publish_shared(Arc::clone(&message));
            self.compressed(context, &message);
        }
    }
}
