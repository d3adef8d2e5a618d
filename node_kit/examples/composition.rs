//! Embedding: a larger program runs nodes beside its own work, here two rigs in two namespaces in
//! one process. Messages within the process are shared as `Arc`s; `ros2 topic list` shows them too.
//!
//! A bare core needs none of this: `let mut tracker = marker_tracker::Tracker::new(layout, config);
//! tracker.handle(input); while let Some(output) = tracker.poll() { … }`.

use node_kit::{
    Level, NodeContext, NodeError, NodeShell, Process, Publisher, QosPreset, RosArguments,
};
use std::{sync::Arc, time::Duration};
use volant_msgs::geometry_msgs::msg::PointStamped;

struct Talker(Publisher<PointStamped>);

impl NodeShell for Talker {
    const NAME: &'static str = "talker";
    type Parameters = ();
    type Input = ();

    fn start(context: &mut NodeContext<()>, (): ()) -> Result<Self, NodeError> {
        context.timer(Duration::from_millis(500), || ());
        Ok(Self(context.advertise("point", QosPreset::State)?))
    }

    fn handle(&mut self, _: &mut NodeContext<()>, (): ()) {
        self.0.publish(PointStamped::default());
    }
}

struct Listener;

impl NodeShell for Listener {
    const NAME: &'static str = "listener";
    type Parameters = ();
    type Input = Arc<PointStamped>;

    fn start(context: &mut NodeContext<Arc<PointStamped>>, (): ()) -> Result<Self, NodeError> {
        context.subscribe("point", QosPreset::State, Some)?;
        Ok(Self)
    }

    fn handle(&mut self, context: &mut NodeContext<Arc<PointStamped>>, _: Arc<PointStamped>) {
        context.log(Level::Info, "a point");
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
