//! What a recorder has to take: images at 30 Hz (640×480 rgb8, 0.92 MB) and IMU samples at
//! 400 Hz, each numbered in its frame id. A large image keeps its thread for longer than a sample
//! may wait, so each is a process, as on a rig.
//!
//! `cargo run --release -p volant --example camera_and_unit -- --samples false`, and `--
//! --images false`

use node_kit::{
    Level, NodeContext, NodeError, NodeShell, Publisher, QosPreset, convert, parameters, run_node,
};
use std::{process::ExitCode, time::Duration};
use volant_msgs::sensor_msgs::msg::{Image, Imu};

parameters! {
    /// Parameters of the example.
    pub struct Parameters {
        /// Publish images.
        images: bool = true;
        /// Publish IMU samples.
        samples: bool = true;
    }
}

enum Input {
    Image,
    Sample,
}

struct Source {
    images: Publisher<Image>,
    samples: Publisher<Imu>,
    counts: [u64; 2],
}

impl NodeShell for Source {
    const NAME: &'static str = "camera_and_unit";
    const ABOUT: &'static str = "publishes images at 30 Hz and IMU samples at 400 Hz";
    type Parameters = Parameters;
    type Input = Input;

    fn start(context: &mut NodeContext<Input>, parameters: Parameters) -> Result<Self, NodeError> {
        if parameters.images {
            context.timer(Duration::from_secs(1) / 30, || Input::Image);
        }
        if parameters.samples {
            context.timer(Duration::from_micros(2500), || Input::Sample);
        }
        Ok(Self {
            images: context.advertise("image_raw", QosPreset::Image)?,
            samples: context.advertise("imu", QosPreset::Sensor)?,
            counts: [0; 2],
        })
    }

    fn handle(&mut self, context: &mut NodeContext<Input>, input: Input) {
        let [images, samples] = &mut self.counts;
        match input {
            Input::Image => {
                let header = convert::header(&images.to_string(), context.now());
                self.images.publish(Image {
                    header,
                    height: 480,
                    width: 640,
                    step: 1920,
                    encoding: "rgb8".into(),
                    data: vec![128; 480 * 1920],
                    ..Image::default()
                });
                *images += 1;
            }
            Input::Sample => {
                let header = convert::header(&samples.to_string(), context.now());
                self.samples.publish(Imu { header, ..Imu::default() });
                *samples += 1;
            }
        }
    }

    fn tick(&mut self, context: &mut NodeContext<Input>) {
        context.log(Level::Debug, format!("{:?} images and samples", self.counts));
    }
}

fn main() -> ExitCode {
    run_node::<Source>()
}
