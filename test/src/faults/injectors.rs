//! Fault injectors for camera and encoders.

use crate::live::{FaultInjector, SensorMessage};
use node_kit::convert;
use rig_simulator::{RgbImage, random::Random};
use std::time::Duration;
use volant_msgs::sensor_msgs::msg::{CompressedImage, JointState};

fn as_it_is(message: SensorMessage) -> Vec<(Duration, SensorMessage)> {
    vec![(Duration::ZERO, message)]
}

/// Images go through `f`; the rest is as it is.
pub fn images(
    mut f: impl FnMut(CompressedImage) -> Vec<(Duration, CompressedImage)> + Send + 'static,
) -> FaultInjector {
    Box::new(move |message| match message {
        SensorMessage::Image(m) => {
            f(m).into_iter().map(|(delay, m)| (delay, SensorMessage::Image(m))).collect()
        }
        other => as_it_is(other),
    })
}

/// Encoder readings go through `f`; the rest is as it is.
pub fn joints(
    mut f: impl FnMut(JointState) -> Vec<(Duration, JointState)> + Send + 'static,
) -> FaultInjector {
    Box::new(move |message| match message {
        SensorMessage::Joints(m) => {
            f(m).into_iter().map(|(delay, m)| (delay, SensorMessage::Joints(m))).collect()
        }
        other => as_it_is(other),
    })
}

/// One message, changed.
pub fn one<M>(message: M) -> Vec<(Duration, M)> {
    vec![(Duration::ZERO, message)]
}

/// Replaces every image by a uniform one of this size and brightness, with a little sensor noise.
pub fn uniform_images(width: u32, height: u32, value: u8) -> FaultInjector {
    let mut random = Random::fork(1, "uniform images");
    let jpegs = [(); 4].map(|()| {
        let data =
            (0..width * height * 3).map(|_| value.saturating_add(random.within(0.0, 6.0) as u8));
        RgbImage { width, height, data: data.collect() }.to_jpeg(90).unwrap_or_default()
    });
    let mut count = 0;
    images(move |m| {
        count += 1;
        one(CompressedImage { data: jpegs[count % jpegs.len()].clone(), ..m })
    })
}

/// Moves a header's stamp by `seconds`.
pub fn shift(header: &mut volant_msgs::std_msgs::msg::Header, seconds: f64) {
    header.stamp = convert::time(convert::stamp(&header.stamp).plus_seconds(seconds));
}
