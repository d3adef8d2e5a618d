//! Embedding: a larger program runs nodes of this kit beside its own work, two rigs under two namespaces, all in one
//! process. Inside of a rig the messages are handed over as `Arc`s; `ros2 topic list` shows them all the same.
//!
//! A bare core needs none of this: `let mut tracker = marker_tracker::Tracker::new(layout, config);
//! tracker.handle(input); while let Some(output) = tracker.poll() { … }`.

use node_kit::{Kit, Level, NodeError, NodeShell, Process, Publisher, QosPreset, RosArguments};
use std::{sync::Arc, time::Duration};
use volant_msgs::geometry_msgs::msg::PointStamped;

struct Talker(Publisher<PointStamped>);

impl NodeShell for Talker {
    const NAME: &'static str = "talker";
    type Parameters = ();
    type Input = ();

    fn start(kit: &mut Kit<()>, (): ()) -> Result<Self, NodeError> {
        kit.timer(Duration::from_millis(500), || ());
        Ok(Self(kit.advertise("point", QosPreset::State)?))
    }

    fn handle(&mut self, _: &mut Kit<()>, (): ()) {
        self.0.publish(PointStamped::default());
    }
}

struct Listener;

impl NodeShell for Listener {
    const NAME: &'static str = "listener";
    type Parameters = ();
    type Input = Arc<PointStamped>;

    fn start(kit: &mut Kit<Arc<PointStamped>>, (): ()) -> Result<Self, NodeError> {
        kit.subscribe("point", QosPreset::State, Some)?;
        Ok(Self)
    }

    fn handle(&mut self, kit: &mut Kit<Arc<PointStamped>>, _: Arc<PointStamped>) {
        kit.log(Level::Info, "a point");
    }
}

fn main() -> Result<(), NodeError> {
    let mut process = Process::from_environment()?;
    for namespace in ["/rig1", "/rig2"] {
        let mut arguments = RosArguments::default();
        arguments.remap("__ns", namespace);
        process.start::<Listener>(&arguments)?;
        process.start::<Talker>(&arguments)?;
    }
    // The program's own work goes here; `process.stopper()` ends the nodes from any thread.
    process.stop_on_signals()?;
    process.wait()
}
