//! Fault injectors for camera and encoders.

use crate::live::FaultInjector;
use node_kit::convert;
use rig_simulator::{RgbImage, random::Random};
use std::time::Duration;
use volant_msgs::sensor_msgs::msg::{CompressedImage, JointState};

/// Messages that replace one message, each with a delay.
type Replaced<M> = Vec<(Duration, M)>;

/// Replaces images by others; `replace` gets the number of the image, from 1 on.
pub fn images_as(
    mut replace: impl FnMut(u64, CompressedImage) -> Replaced<CompressedImage> + Send + 'static,
) -> FaultInjector {
    let mut number = 0;
    FaultInjector::Images(Box::new(move |m| {
        number += 1;
        replace(number, m)
    }))
}

/// Replaces encoder readings by others; `replace` gets the number of the reading, from 1 on.
pub fn joints_as(
    mut replace: impl FnMut(u64, JointState) -> Replaced<JointState> + Send + 'static,
) -> FaultInjector {
    let mut number = 0;
    FaultInjector::Joints(Box::new(move |m| {
        number += 1;
        replace(number, m)
    }))
}

pub fn images(mut change: impl FnMut(&mut CompressedImage) + Send + 'static) -> FaultInjector {
    images_as(move |_, mut m| {
        change(&mut m);
        vec![(Duration::ZERO, m)]
    })
}

pub fn joints(mut change: impl FnMut(&mut JointState) + Send + 'static) -> FaultInjector {
    joints_as(move |_, mut m| {
        change(&mut m);
        vec![(Duration::ZERO, m)]
    })
}

/// Replaces every image by a uniform one of this size and brightness, with a little sensor noise.
pub fn uniform_images(width: u32, height: u32, value: u8) -> FaultInjector {
    let mut random = Random::fork(1, "uniform images");
    let jpegs = [(); 4].map(|()| {
        let data =
            (0..width * height * 3).map(|_| value.saturating_add(random.within(0.0, 6.0) as u8));
        RgbImage { width, height, data: data.collect() }.to_jpeg(90).unwrap_or_default()
    });
    let mut following = jpegs.into_iter().cycle();
    images(move |m| m.data = following.next().unwrap_or_default())
}

/// Moves a header's stamp by `seconds`.
pub fn shift(header: &mut volant_msgs::std_msgs::msg::Header, seconds: f64) {
    header.stamp = convert::time(convert::stamp(&header.stamp).plus_seconds(seconds));
}
