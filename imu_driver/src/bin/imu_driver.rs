//! The inertial unit's node: bytes of a serial port in, `volant/imu/data` out.

use std::process::ExitCode;

fn main() -> ExitCode {
    node_kit::node::run_node::<imu_driver::node::ImuNode>()
}
