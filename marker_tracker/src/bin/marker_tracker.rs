//! The marker tracker node: images in, `climber/markers` out.

use std::process::ExitCode;

#[cfg(feature = "node")]
#[global_allocator]
static ALLOCATOR: node_kit::Allocator = node_kit::Allocator;

#[cfg(feature = "node")]
fn main() -> ExitCode {
    node_kit::run_node::<marker_tracker::node::MarkerTrackerNode>()
}

// Instead of `required-features`: colcon does not install executables with those.
#[cfg(not(feature = "node"))]
fn main() -> ExitCode {
    eprintln!(
        "marker_tracker: built without the feature `node`; build it with the default features"
    );
    ExitCode::FAILURE
}
