//! Executable of the command `volant imu`.

use std::process::ExitCode;

#[cfg(feature = "cli")]
fn main() -> ExitCode {
    imu_driver::tool::main()
}

// Instead of `required-features`: colcon installs no executable that has them.
#[cfg(not(feature = "cli"))]
fn main() -> ExitCode {
    eprintln!("volant-imu: built without the feature `cli`; build it with the default features");
    ExitCode::FAILURE
}
