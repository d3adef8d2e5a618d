//! What camera and encoders say while they are broken.

use crate::{
    live::{Saying, Spoiler},
    rig::RgbImage,
};
use node_kit::convert;
use std::time::Duration;
use volant_msgs::sensor_msgs::msg::{CompressedImage, JointState};

fn as_it_is(saying: Saying) -> Vec<(Duration, Saying)> {
    vec![(Duration::ZERO, saying)]
}

/// Pictures go through `f`; the rest is as it is.
pub fn images(
    mut f: impl FnMut(CompressedImage) -> Vec<(Duration, CompressedImage)> + Send + 'static,
) -> Spoiler {
    Box::new(move |saying| match saying {
        Saying::Image(m) => f(m).into_iter().map(|(delay, m)| (delay, Saying::Image(m))).collect(),
        other => as_it_is(other),
    })
}

/// Encoder readings go through `f`; the rest is as it is.
pub fn joints(mut f: impl FnMut(JointState) -> Vec<(Duration, JointState)> + Send + 'static) -> Spoiler {
    Box::new(move |saying| match saying {
        Saying::Joints(m) => f(m).into_iter().map(|(delay, m)| (delay, Saying::Joints(m))).collect(),
        other => as_it_is(other),
    })
}

/// One message, changed.
pub fn one<M>(message: M) -> Vec<(Duration, M)> {
    vec![(Duration::ZERO, message)]
}

/// An even picture of this size and brightness.
pub fn even_picture(width: u32, height: u32, value: u8) -> Vec<u8> {
    let image = RgbImage { width, height, data: vec![value; (width * height * 3) as usize] };
    image.to_jpeg(90).unwrap_or_default()
}

/// Moves a header's stamp by `seconds`.
pub fn shift(header: &mut volant_msgs::std_msgs::msg::Header, seconds: f64) {
    header.stamp = convert::time(convert::stamp(&header.stamp).plus_seconds(seconds));
}
