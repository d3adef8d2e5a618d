//! `volant calibrate`: see the library.

use clap::{Parser, Subcommand};
use std::process::ExitCode;
use volant_calibrate::{
    camera::command::{self as camera, CameraArguments},
    rig::command::{self as rig, RigArguments},
};

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
    /// Mountings and marker places from a recording of free motion.
    Rig(RigArguments),
}

fn main() -> ExitCode {
    let done = match Arguments::parse().command {
        Command::Camera(arguments) => camera::run(&arguments),
        Command::Rig(arguments) => rig::run(&arguments),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("volant calibrate: {error:#}");
            ExitCode::FAILURE
        }
    }
}
