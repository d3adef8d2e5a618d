//! `volant calibrate`: see the library.

use clap::{Parser, Subcommand};
use std::process::ExitCode;
use volant::command_line;
use volant_calibrate::camera::command::{self as camera, CameraArguments};

/// Calibrate the camera; `colors`, `rig`, `climber` and `imu` are part of `volant`
#[derive(Parser)]
#[command(name = "volant calibrate", bin_name = "volant calibrate", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Calibrate the camera from images of a chessboard
    Camera(CameraArguments),
}

fn main() -> ExitCode {
    let arguments: Arguments = match command_line::parse() {
        Ok(arguments) => arguments,
        Err(status) => return status,
    };
    let done = match arguments.command {
        Command::Camera(arguments) => camera::run(&arguments),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => command_line::failure("volant calibrate", &error),
    }
}
