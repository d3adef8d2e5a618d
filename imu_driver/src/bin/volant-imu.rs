//! `volant imu …`.

#[cfg(feature = "cli")]
use clap::Parser;
use std::process::ExitCode;

#[cfg(feature = "cli")]
fn main() -> ExitCode {
    imu_driver::tool::run(imu_driver::tool::Arguments::parse())
}

// Instead of `required-features`: colcon installs no executable that has them.
#[cfg(not(feature = "cli"))]
fn main() -> ExitCode {
    eprintln!(
        "volant-imu: built without its feature `cli`, it can do nothing; build it with the default features"
    );
    ExitCode::FAILURE
}
