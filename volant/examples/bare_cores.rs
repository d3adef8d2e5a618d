//! The cores alone, as a larger stack embeds them: no middleware, no thread, no clock. Data goes in
//! with its own stamps.
//!
//! `cargo run --release -p volant --example bare_cores -- RUN.mcap rig.yaml`, with compressed
//! images, IMU samples, camera info and climber transforms in the bag; it prints the platform's
//! pose twice a second.
#![allow(clippy::print_stdout, reason = "an example")]

use anyhow::Context;
use bag::BagReader;
use marker_tracker::{Tracker, TrackerConfig, decode_compressed};
use node_kit::convert;
use pose_fusion::{Fusion, FusionConfig};
use rig_model::{Rig, topics};
use std::path::Path;
use volant_msgs::{
    cdr,
    geometry_msgs::msg::TransformStamped,
    sensor_msgs::msg::{CameraInfo, CompressedImage, Imu},
};

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [bag, rig] = arguments.as_slice() else {
        anyhow::bail!("usage: bare_cores RUN.mcap rig.yaml")
    };
    let rig = Rig::from_yaml(&std::fs::read_to_string(rig).context(rig.clone())?)?;
    let mut tracker = Tracker::new(rig.markers.clone(), TrackerConfig::default());
    let mut fusion = Fusion::new(rig.clone(), FusionConfig::default());
    let mut printed = None;

    let mut bag = BagReader::open(Path::new(bag))?;
    while let Some(message) = bag.next_message()? {
        // Replace this by your program's source; the cores need the data in order of arrival.
        match &*message.topic.name {
            topics::absolute::CAMERA_INFO => {
                let camera = convert::camera_model(&cdr::from_bytes::<CameraInfo>(&message.data)?)?;
                tracker.handle(marker_tracker::Input::Camera(camera.clone()));
                fusion.handle(pose_fusion::Input::Camera(camera));
            }
            topics::absolute::COMPRESSED_IMAGE => {
                let image: CompressedImage = cdr::from_bytes(&message.data)?;
                let pixels = decode_compressed(&image.format, &image.data)?;
                let stamp = convert::stamp(&image.header.stamp);
                tracker.handle(marker_tracker::Input::Image(pixels.view(stamp)));
                while let Some(output) = tracker.poll() {
                    if let marker_tracker::Output::Observations(markers) = output {
                        fusion.handle(pose_fusion::Input::Markers(markers));
                    }
                }
            }
            topics::absolute::CLIMBER_TRANSFORM => {
                let climber: TransformStamped = cdr::from_bytes(&message.data)?;
                fusion.handle(pose_fusion::Input::Climber(convert::climber_sample(
                    &climber,
                    &rig.frames,
                )?));
            }
            topics::absolute::IMU => {
                let sample = convert::imu_sample(&cdr::from_bytes::<Imu>(&message.data)?);
                fusion.handle(pose_fusion::Input::Imu(sample));
            }
            _ => {}
        }
        while let Some(output) = fusion.poll() {
            if let pose_fusion::Output::Odometry(odometry) = output
                && printed.is_none_or(|before| odometry.stamp.seconds_since(before) >= 0.5)
            {
                let p = odometry.world_from_volant.translation;
                let sigma = |i| 1e3 * odometry.pose_covariance[(i, i)].sqrt();
                println!(
                    "{}  x {:8.4} y {:8.4} z {:8.4} m  ±{:.2} {:.2} {:.2} mm",
                    odometry.stamp,
                    p.x,
                    p.y,
                    p.z,
                    sigma(0),
                    sigma(1),
                    sigma(2)
                );
                printed = Some(odometry.stamp);
            }
        }
    }
    Ok(())
}
