//! `volant`: runs, records and evaluates the nodes.
//!
//! Exit status: see [`volant::command_line`].

mod bag;
mod bringup;
mod calibrate;
mod check;
mod commands;
mod evaluate;
#[cfg(feature = "nodes")]
mod foxglove;
mod markers;
#[cfg(feature = "nodes")]
mod monitor;
#[cfg(feature = "nodes")]
mod play;
#[cfg(feature = "nodes")]
mod record;
mod replay;
mod settings;
#[cfg(feature = "nodes")]
mod signals;
mod terminal;
#[cfg(feature = "nodes")]
mod up;

use clap::{Parser, Subcommand};
use std::{ffi::OsString, process::ExitCode};
use volant::command_line;

#[cfg(feature = "nodes")]
#[global_allocator]
static ALLOCATOR: node_kit::Allocator = node_kit::Allocator;

/// Pose of a platform that hangs from a ceiling crane: run the nodes, replay, record and evaluate
#[derive(Parser)]
#[command(
    version,
    arg_required_else_help = true,
    disable_help_subcommand = true,
    help_template = "{about}\n\n{usage-heading} {usage}{after-help}\n\nOptions:\n{options}",
    after_help = commands::listing()
)]
struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Subcommand)]
enum Action {
    /// Run the nodes' cores over a bag, deterministically and as fast as possible
    Replay(replay::Arguments),
    /// Compare every estimate in a bag with the ground truth
    Evaluate(evaluate::Arguments),
    /// Walk from measured lengths to an accepted rig file, step by step
    Bringup(bringup::Arguments),
    /// Make a PDF or SVG of the marker squares to print, with a drawing of where they belong
    Markers(markers::Arguments),
    /// Compare the rig and camera files with a recording, and name what is wrong
    Check(check::Arguments),
    /// Summarize or repair bags
    #[command(subcommand)]
    Bag(bag::Action),
    /// Run any of the nodes in one process
    #[cfg(feature = "nodes")]
    #[command(disable_help_flag = true)]
    Up {
        /// Nodes, --rig FILE, --ros-args …
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        words: Vec<String>,
    },
    /// Record live topics to a bag
    #[cfg(feature = "nodes")]
    Record(record::Arguments),
    /// Play a bag to live topics
    #[cfg(feature = "nodes")]
    Play(play::Arguments),
    /// Show live topics on a terminal: poses, markers, rates, delays, losses, diagnostics
    #[cfg(feature = "nodes")]
    Monitor(monitor::Arguments),
    /// Serve live topics to Foxglove over its WebSocket protocol, without ROS
    #[cfg(feature = "nodes")]
    Foxglove(foxglove::Arguments),
    /// Print completions for a shell
    Completions {
        /// The shell
        shell: clap_complete::Shell,
    },
    /// Write the manual pages of all commands
    Manual(command_line::Manual),
    #[command(external_subcommand)]
    Other(Vec<OsString>),
}

fn main() -> ExitCode {
    let arguments: Arguments = match command_line::parse() {
        Ok(arguments) => arguments,
        Err(status) => return status,
    };
    if let Err(error) = arguments.action.end_on_signals() {
        return command_line::failure("volant", &error.into());
    }
    let result = match arguments.action {
        Action::Replay(arguments) => replay::run(&arguments),
        Action::Evaluate(arguments) => evaluate::run(&arguments),
        Action::Bringup(arguments) => bringup::run(&arguments),
        Action::Markers(arguments) => markers::run(&arguments),
        Action::Check(arguments) => match check::run(&arguments) {
            Ok(true) => Ok(()),
            Ok(false) => return ExitCode::FAILURE,
            Err(error) => Err(error),
        },
        Action::Bag(action) => bag::run(&action),
        #[cfg(feature = "nodes")]
        Action::Up { words } => return up::run(words),
        #[cfg(feature = "nodes")]
        Action::Record(arguments) => record::run(&arguments),
        #[cfg(feature = "nodes")]
        Action::Play(arguments) => play::run(&arguments),
        #[cfg(feature = "nodes")]
        Action::Monitor(arguments) => monitor::run(&arguments),
        #[cfg(feature = "nodes")]
        Action::Foxglove(arguments) => foxglove::run(&arguments),
        Action::Completions { shell } => commands::completions(shell),
        Action::Manual(arguments) => commands::manual(&arguments),
        // The rest of `calibrate` is an executable of its own, which needs all of OpenCV.
        Action::Other(words) if calibrate::is_here(&words) => {
            match command_line::parse_from(words) {
                Ok(arguments) => calibrate::run(&arguments),
                Err(status) => return status,
            }
        }
        Action::Other(words) => return commands::other(&words),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => command_line::failure("volant", &error),
    }
}

impl Action {
    /// Ends the commands on SIGINT and SIGTERM that do not handle them themselves.
    fn end_on_signals(&self) -> std::io::Result<()> {
        match self {
            #[cfg(feature = "nodes")]
            Self::Up { .. } | Self::Record(_) | Self::Play(_) => Ok(()),
            #[cfg(feature = "nodes")]
            Self::Monitor(_) | Self::Foxglove(_) => Ok(()),
            Self::Other(_) => Ok(()),
            _ => node_kit::console::end_on_signals("volant", || {}),
        }
    }
}
