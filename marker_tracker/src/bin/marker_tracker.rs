//! The marker tracker's node: images in, `climber/markers` out.

use std::process::ExitCode;

fn main() -> ExitCode {
    node_kit::run_node::<marker_tracker::node::MarkerTrackerNode>()
}
