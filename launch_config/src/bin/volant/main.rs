//! `volant`: one command for what is done with the nodes and their recordings.
//!
//! Exit status: 0 done; 1 the work failed, with one line on standard error; 2 the command line was wrong.
#![allow(clippy::print_stdout)]

mod bag;
mod colors;
mod evaluate;
#[cfg(feature = "nodes")]
mod foxglove;
#[cfg(feature = "nodes")]
mod monitor;
#[cfg(feature = "nodes")]
mod play;
#[cfg(feature = "nodes")]
mod record;
mod replay;
mod say;
mod settings;
#[cfg(feature = "nodes")]
mod signals;
#[cfg(feature = "nodes")]
mod up;

use clap::{Parser, Subcommand};
use std::{
    ffi::OsString,
    path::PathBuf,
    process::{Command, ExitCode},
};

#[cfg(feature = "nodes")]
#[global_allocator]
static ALLOCATOR: node_kit::Allocator = node_kit::Allocator;

/// Where a platform hanging from a ceiling crane is: replay, evaluate, record, play and run its nodes.
#[derive(Parser)]
#[command(version, arg_required_else_help = true)]
struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Subcommand)]
enum Action {
    /// Runs the nodes' own code over a bag, deterministically and as fast as it can
    Replay(replay::Arguments),
    /// The error of every estimate in a bag against the truth
    Evaluate(evaluate::Arguments),
    /// What is in a bag, and how to mend one
    #[command(subcommand)]
    Bag(bag::Action),
    /// Runs any set of the nodes in one process
    #[cfg(feature = "nodes")]
    #[command(disable_help_flag = true)]
    Up {
        /// Nodes, --rig FILE, --ros-args …
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        words: Vec<OsString>,
    },
    /// Live topics into a bag
    #[cfg(feature = "nodes")]
    Record(record::Arguments),
    /// A bag onto live topics
    #[cfg(feature = "nodes")]
    Play(play::Arguments),
    /// Live topics on a terminal: poses, markers, rates, delays, losses, diagnostics
    #[cfg(feature = "nodes")]
    Monitor(monitor::Arguments),
    /// Live topics for Foxglove, without ROS: a server of its WebSocket protocol
    #[cfg(feature = "nodes")]
    Foxglove(foxglove::Arguments),
    #[command(external_subcommand)]
    Other(Vec<OsString>),
}

fn main() -> ExitCode {
    let result = match Arguments::parse().action {
        Action::Replay(arguments) => replay::run(&arguments),
        Action::Evaluate(arguments) => evaluate::run(&arguments),
        Action::Bag(action) => bag::run(&action),
        #[cfg(feature = "nodes")]
        Action::Up { words } => return up::run(&words),
        #[cfg(feature = "nodes")]
        Action::Record(arguments) => record::run(&arguments),
        #[cfg(feature = "nodes")]
        Action::Play(arguments) => play::run(&arguments),
        // The rest of `calibrate` is an executable of its own, which needs all of OpenCV.
        Action::Other(words) if is_colors(&words) => colors::run(&colors::Arguments::parse_from(&words[1..])),
        #[cfg(feature = "nodes")]
        Action::Monitor(arguments) => monitor::run(&arguments),
        #[cfg(feature = "nodes")]
        Action::Foxglove(arguments) => foxglove::run(&arguments),
        Action::Other(words) => return other(&words),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say::line(&format!("volant: {}", told(&error)));
            ExitCode::FAILURE
        }
    }
}

/// What went wrong, and why; what an error said of its cause is not said again.
fn told(error: &anyhow::Error) -> String {
    error.chain().fold(String::new(), |text, cause| match (cause.to_string(), text.is_empty()) {
        (cause, true) => cause,
        (cause, false) if text.contains(&cause) => text,
        (cause, false) => format!("{text}: {cause}"),
    })
}

fn is_colors(words: &[OsString]) -> bool {
    words.len() >= 2 && words[0] == "calibrate" && words[1] == "colors"
}

/// What `volant-rig` does, on the simulated rig and with the real nodes: it comes with the whole project, not with this package.
const SIMULATED: [&str; 7] = ["demo", "faults", "hosts", "reproduce", "rigs", "robustness", "soak"];

/// `volant X` may be an executable `volant-X` beside this one, or on the path; some are one executable, `volant-rig`.
fn other(words: &[OsString]) -> ExitCode {
    let Some((name, rest)) = words.split_first() else {
        return ExitCode::from(2);
    };
    let (name, rest) = match name.to_str() {
        Some(n) if SIMULATED.contains(&n) => ("volant-rig".to_owned(), words),
        _ => (format!("volant-{}", name.to_string_lossy()), rest),
    };
    let beside: Option<PathBuf> =
        std::env::current_exe().ok().and_then(|own| Some(own.parent()?.join(&name))).filter(|p| p.is_file());
    match Command::new(beside.unwrap_or_else(|| PathBuf::from(&name))).args(rest).status() {
        Ok(status) => ExitCode::from(status.code().and_then(|c| u8::try_from(c).ok()).unwrap_or(1)),
        Err(_) => {
            say::line(&format!(
                "volant: there is no command `{}` (no {name} beside this program either); see volant --help",
                words[0].to_string_lossy()
            ));
            ExitCode::from(2)
        }
    }
}
