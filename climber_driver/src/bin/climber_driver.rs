//! The climber's node: encoder readings in, `climber/transform` and tf out.

use std::process::ExitCode;

fn main() -> ExitCode {
    node_kit::node::run_node::<climber_driver::node::ClimberNode>()
}
