//! `volant`: runs, records and evaluates the nodes.
//!
//! Exit status: see [`volant::command_line`].

mod bag;
mod bringup;
mod calibrate;
mod check;
mod commands;
mod evaluate;
mod foxglove;
mod markers;
mod monitor;
mod play;
mod record;
mod replay;
mod settings;
mod signals;
mod terminal;
mod up;

use clap::{Parser, Subcommand};
use std::{ffi::OsString, process::ExitCode};
use volant::{command_line, live::play::PlayOptions};

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
    #[command(disable_help_flag = true)]
    Up {
        /// Nodes, --rig FILE, --ros-args …
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        words: Vec<String>,
    },
    /// Record live topics to a bag
    Record(record::Arguments),
    /// Play a bag to live topics
    Play(PlayOptions),
    /// Show live topics on a terminal: poses, markers, rates, delays, losses, diagnostics
    Monitor(monitor::Arguments),
    /// Serve live topics to Foxglove over its WebSocket protocol, without ROS
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
        Action::Up { words } => return up::run(words),
        Action::Record(arguments) => record::run(&arguments),
        Action::Play(options) => play::run(&options),
        Action::Monitor(arguments) => monitor::run(&arguments),
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
            Self::Up { .. }
            | Self::Record(_)
            | Self::Play(_)
            | Self::Monitor(_)
            | Self::Foxglove(_)
            | Self::Other(_) => Ok(()),
            _ => node_kit::console::end_on_signals("volant", || {}),
        }
    }
}
