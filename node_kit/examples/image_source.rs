//! Publishes raw images like a camera, 640×480 at 30 Hz, and logs each second the longest duration
//! of a publication and how many publications were blocked.

use node_kit::{Level, NodeContext, NodeError, NodeShell, Publisher, QosPreset, run_node};
use rustix::time::{ClockId, clock_gettime};
use std::{
    process::ExitCode,
    time::{Duration, Instant},
};
use volant_msgs::sensor_msgs::msg::Image;

/// Blocked time from which a publication counts as held up.
const HELD_UP: Duration = Duration::from_millis(1);

/// The current time, and the time that this thread was not blocked: it ran, or was ready to run.
#[allow(clippy::disallowed_methods, reason = "it measures its own duration")]
fn spent() -> (Instant, Duration) {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    let processor =
        Duration::new(now.tv_sec.unsigned_abs(), u32::try_from(now.tv_nsec).unwrap_or(0));
    // Fields: nanoseconds running (as of the last tick), nanoseconds ready to run, time slices.
    let schedule = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let ready = schedule.split_whitespace().nth(1).and_then(|ns| ns.parse().ok()).unwrap_or(0);
    (Instant::now(), processor + Duration::from_nanos(ready))
}

struct Source {
    images: Publisher<Image>,
    longest: Duration,
    published: u32,
    held_up: u32,
}

impl NodeShell for Source {
    const NAME: &'static str = "image_source";
    const ABOUT: &'static str = "publishes grey images";
    type Parameters = ();
    type Input = ();

    fn start(context: &mut NodeContext<()>, (): ()) -> Result<Self, NodeError> {
        context.timer(Duration::from_secs(1) / 30, || ());
        let images = context.advertise("image", QosPreset::Image)?;
        Ok(Self { images, longest: Duration::ZERO, published: 0, held_up: 0 })
    }

    fn handle(&mut self, _: &mut NodeContext<()>, (): ()) {
        let image = Image {
            height: 480,
            width: 640,
            step: 1920,
            encoding: "rgb8".into(),
            data: vec![128; 480 * 1920],
            ..Image::default()
        };
        let before = spent();
        self.images.publish(image);
        let after = spent();
        let took = after.0 - before.0;
        self.longest = self.longest.max(took);
        self.published += 1;
        self.held_up += u32::from(took.saturating_sub(after.1 - before.1) > HELD_UP);
    }

    fn tick(&mut self, context: &mut NodeContext<()>) {
        let (micros, subscribers, refused) =
            (self.longest.as_micros(), self.images.subscribers(), self.images.refused());
        let (published, held_up) = (self.published, self.held_up);
        let line = format!(
            "longest_us={micros} published={published} held_up={held_up} \
             subscribers={subscribers} refused={refused}"
        );
        context.log(Level::Info, line);
        self.longest = Duration::ZERO;
    }
}

fn main() -> ExitCode {
    run_node::<Source>()
}
