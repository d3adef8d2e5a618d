//! The fusion's node: markers, inertial samples and the climber's transform in, the platform's pose out.

use std::process::ExitCode;

fn main() -> ExitCode {
    node_kit::node::run_node::<pose_fusion::node::FusionNode>()
}
