//! Raw images as a camera sends them, 640×480 at 30 Hz, and each second the longest that a publication took.

use node_kit::{Kit, Level, NodeError, NodeShell, Publisher, QosPreset, run_node};
use std::{
    process::ExitCode,
    time::{Duration, Instant},
};
use volant_msgs::sensor_msgs::msg::Image;

/// A publication that takes longer waits for something.
const HELD_UP: Duration = Duration::from_millis(20);

struct Source {
    images: Publisher<Image>,
    longest: Duration,
    held_up: u32,
}

impl NodeShell for Source {
    const NAME: &'static str = "image_source";
    const ABOUT: &'static str = "publishes grey images";
    type Parameters = ();
    type Input = ();

    fn start(kit: &mut Kit<()>, (): ()) -> Result<Self, NodeError> {
        kit.timer(Duration::from_secs(1) / 30, || ());
        Ok(Self { images: kit.advertise("image", QosPreset::Image)?, longest: Duration::ZERO, held_up: 0 })
    }

    #[allow(clippy::disallowed_methods, reason = "it measures its own duration")]
    fn handle(&mut self, _: &mut Kit<()>, (): ()) {
        let image = Image {
            height: 480,
            width: 640,
            step: 1920,
            encoding: "rgb8".into(),
            data: vec![128; 480 * 1920],
            ..Image::default()
        };
        let before = Instant::now();
        self.images.publish(image);
        let took = before.elapsed();
        self.longest = self.longest.max(took);
        self.held_up += u32::from(took > HELD_UP);
    }

    fn tick(&mut self, kit: &mut Kit<()>) {
        let (micros, subscribers, refused) =
            (self.longest.as_micros(), self.images.subscribers(), self.images.refused());
        let held_up = self.held_up;
        let line =
            format!("longest_us={micros} held_up={held_up} subscribers={subscribers} refused={refused}");
        kit.log(Level::Info, line);
        self.longest = Duration::ZERO;
    }
}

fn main() -> ExitCode {
    run_node::<Source>()
}
