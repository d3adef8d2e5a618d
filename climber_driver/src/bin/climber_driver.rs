//! Executable of the node `climber_driver`.

use std::process::ExitCode;

#[cfg(feature = "node")]
#[global_allocator]
static ALLOCATOR: node_kit::Allocator = node_kit::Allocator;

#[cfg(feature = "node")]
fn main() -> ExitCode {
    node_kit::node::run_node::<climber_driver::node::ClimberNode>()
}

// Instead of `required-features`: colcon installs no executable that has them.
#[cfg(not(feature = "node"))]
fn main() -> ExitCode {
    eprintln!(
        "climber_driver: built without the feature `node`; build it with the default features"
    );
    ExitCode::FAILURE
}
