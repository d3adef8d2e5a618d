//! `volant calibrate camera`: calibration of the camera.
//! Images yield a standard `camera_info` file, with uncertainties. Images that do not determine
//! the result are rejected, with what is missing.

mod camera;
mod images;

use camera::command::CameraArguments;
use clap::{Parser, Subcommand};
use std::process::ExitCode;
use volant::command_line;

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
    let Command::Camera(arguments) = arguments.command;
    match camera::command::run(&arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => command_line::failure("volant calibrate", &error),
    }
}
