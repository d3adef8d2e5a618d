//! The fusion's node: markers, IMU samples and the climber's transform in, the platform's pose
//! out.

use std::process::ExitCode;

#[cfg(feature = "node")]
#[global_allocator]
static ALLOCATOR: node_kit::Allocator = node_kit::Allocator;

#[cfg(feature = "node")]
fn main() -> ExitCode {
    node_kit::node::run_node::<pose_fusion::node::FusionNode>()
}

// Instead of `required-features`: colcon installs no executable that has them.
#[cfg(not(feature = "node"))]
fn main() -> ExitCode {
    eprintln!(
        "pose_fusion: built without its feature `node`, it can do nothing; build it with the \
         default features"
    );
    ExitCode::FAILURE
}
