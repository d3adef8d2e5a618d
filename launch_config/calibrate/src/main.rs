//! `volant calibrate`: see the library.

use clap::{Parser, Subcommand};
use std::process::ExitCode;
use volant_calibrate::camera::command::{self as camera, CameraArguments};

/// What must be measured once: the camera, the markers' colours, the rig.
#[derive(Parser)]
#[command(name = "volant calibrate", bin_name = "volant calibrate", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// The camera from pictures of a chessboard.
    Camera(CameraArguments),
}

fn main() -> ExitCode {
    let done = match Arguments::parse().command {
        Command::Camera(arguments) => camera::run(&arguments),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("volant calibrate: {error:#}");
            ExitCode::FAILURE
        }
    }
}
