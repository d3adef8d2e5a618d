//! `volant imu …`.

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    imu_driver::tool::run(imu_driver::tool::Arguments::parse())
}
