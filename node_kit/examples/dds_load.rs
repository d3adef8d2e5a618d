//! Publishes or receives messages like a rig's, for a comparison of their cost with another DDS
//! (`tests/dds_cost.rs`).

use node_kit::{
    Level, NodeContext, NodeError, NodeShell, Publisher, QosPreset, parameters, run_node,
};
use std::{process::ExitCode, sync::Arc, time::Duration};
use volant_msgs::sensor_msgs::msg::CompressedImage;

#[global_allocator]
static ALLOCATOR: node_kit::Allocator = node_kit::Allocator;

parameters! {
    /// Parameters of the example.
    pub struct Parameters {
        /// Publish; otherwise receive.
        source: bool = false;
        /// Per topic: rate, Hz; size, bytes; 1 if reliable, 0 if best effort.
        topics: Vec<f64> = &[];
    }
}

enum Input {
    Due(usize),
    Received,
}

struct Load {
    publishers: Vec<(Publisher<CompressedImage>, usize)>,
    received: u64,
}

impl NodeShell for Load {
    const NAME: &'static str = "dds_load";
    const ABOUT: &'static str = "publishes or receives messages like a rig's";
    type Parameters = Parameters;
    type Input = Input;

    fn start(context: &mut NodeContext<Input>, parameters: Parameters) -> Result<Self, NodeError> {
        let mut publishers = vec![];
        for (i, topic) in parameters.topics.chunks_exact(3).enumerate() {
            let preset = if topic[2] > 0.0 { QosPreset::State } else { QosPreset::Sensor };
            let name = format!("load{i}");
            if parameters.source {
                publishers.push((context.advertise(&name, preset)?, topic[1] as usize));
                context.timer(Duration::from_secs_f64(1.0 / topic[0]), move || Input::Due(i));
            } else {
                let receive = |_: Arc<CompressedImage>| Some(Input::Received);
                context.subscribe(&name, preset, receive)?;
            }
        }
        Ok(Self { publishers, received: 0 })
    }

    fn handle(&mut self, _: &mut NodeContext<Input>, input: Input) {
        match input {
            Input::Due(i) => {
                let (publisher, size) = &self.publishers[i];
                let data = vec![0; *size];
                publisher.publish(CompressedImage { data, ..CompressedImage::default() });
            }
            Input::Received => self.received += 1,
        }
    }

    fn tick(&mut self, context: &mut NodeContext<Input>) {
        context.log(Level::Info, format!("received={} ", self.received));
    }
}

fn main() -> ExitCode {
    run_node::<Load>()
}
