//! What a recorded bag has for the tracker.

#![allow(clippy::unwrap_used, clippy::panic)] // clippy does not recognize helpers of tests

use bag::BagReader;
use node_kit::convert;
use rig_model::{CameraModel, Rig, Stamp, topics::absolute as topics};
use std::path::Path;
use volant_msgs::{
    cdr,
    sensor_msgs::msg::{CameraInfo, CompressedImage},
};

/// A message of the camera.
pub enum Recorded {
    Camera(CameraModel),
    Image { stamp: Stamp, format: String, data: Vec<u8> },
}

/// The rig file of a bag's folder, and the camera's messages in the order of the bag.
pub fn read(folder: &Path) -> (Rig, Vec<Recorded>) {
    let rig = Rig::from_yaml(&std::fs::read_to_string(folder.join("rig.yaml")).unwrap()).unwrap();
    let mut bag = BagReader::open(&folder.join("in.mcap")).unwrap();
    let mut messages = Vec::new();
    while let Some(message) = bag.next_message().unwrap() {
        match message.topic.name.as_str() {
            topics::CAMERA_INFO => {
                let info = cdr::from_bytes::<CameraInfo>(&message.data).unwrap();
                messages.push(Recorded::Camera(convert::camera_model(&info).unwrap()));
            }
            topics::COMPRESSED_IMAGE => {
                let image = cdr::from_bytes::<CompressedImage>(&message.data).unwrap();
                let stamp = convert::stamp(&image.header.stamp);
                let CompressedImage { format, data, .. } = image;
                messages.push(Recorded::Image { stamp, format, data: data.to_vec() });
            }
            _ => {}
        }
    }
    (rig, messages)
}
