//! What camera and encoders say while they are broken.

use crate::{
    live::{Saying, Spoiler},
    rig::{RgbImage, random::Random},
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

/// Every picture is an even one of this size and brightness, with the little noise that no sensor is without.
pub fn even_pictures(width: u32, height: u32, value: u8) -> Spoiler {
    let mut random = Random::fork(1, "even pictures");
    let pictures = [(); 4].map(|()| {
        let data = (0..width * height * 3).map(|_| value.saturating_add(random.within(0.0, 6.0) as u8));
        RgbImage { width, height, data: data.collect() }.to_jpeg(90).unwrap_or_default()
    });
    let mut count = 0;
    images(move |m| {
        count += 1;
        one(CompressedImage { data: pictures[count % pictures.len()].clone(), ..m })
    })
}

/// Moves a header's stamp by `seconds`.
pub fn shift(header: &mut volant_msgs::std_msgs::msg::Header, seconds: f64) {
    header.stamp = convert::time(convert::stamp(&header.stamp).plus_seconds(seconds));
}
