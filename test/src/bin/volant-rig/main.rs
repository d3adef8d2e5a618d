//! `volant-rig`: what is done with the simulated rig and the real nodes: `volant checks`, `demo`,
//! `faults`, `hosts`, `robustness`, `simulate`, `sites`, `soak` and `reproduce`. One executable for
//! all, so that their common code is built and linked once.
//!
//! Exit status: [`EXIT_STATUS`].

mod checks;
mod demo;
mod faults;
mod hosts;
mod reproduce;
mod robustness;
mod simulate;
mod sites;
mod soak;

use anyhow::Result;
use clap::{CommandFactory, Parser, Subcommand};
use node_kit::console::{EXIT_STATUS, end_on_signals};
use std::process::ExitCode;
use volant::command_line;
use volant_test::{live::processes, run_folder};

/// The simulated rig with the real nodes.
#[derive(Parser)]
#[command(name = "volant", bin_name = "volant", version, after_help = EXIT_STATUS)]
struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Subcommand)]
enum Action {
    Checks(checks::Arguments),
    Demo(demo::Arguments),
    Faults(faults::Arguments),
    Hosts(hosts::Arguments),
    Reproduce(reproduce::Arguments),
    Robustness(robustness::Arguments),
    Simulate(simulate::Arguments),
    Sites(sites::Arguments),
    Soak(soak::Arguments),
    /// Writes the manual pages of these commands; `volant manual` calls it.
    #[command(hide = true)]
    Manual(command_line::Manual),
}

impl Action {
    /// Its name, and whether all that it asserts held.
    fn run(&self) -> (&'static str, Result<bool>) {
        match self {
            Self::Checks(a) => ("checks", checks::run(a)),
            Self::Demo(a) => ("demo", demo::run(a).map(|()| true)),
            Self::Faults(a) => ("faults", faults::run(a)),
            Self::Hosts(a) => ("hosts", hosts::run(a)),
            Self::Reproduce(a) => ("reproduce", reproduce::run(a).map(|()| true)),
            Self::Robustness(a) => ("robustness", robustness::run(a)),
            Self::Simulate(a) => ("simulate", simulate::run(a).map(|()| true)),
            Self::Sites(a) => ("sites", sites::run(a).map(|()| true)),
            Self::Soak(a) => ("soak", soak::run(a)),
            Self::Manual(a) => {
                let written = a.write(Arguments::command(), false);
                ("manual", written.map(|()| true).map_err(Into::into))
            }
        }
    }
}

fn main() -> ExitCode {
    let arguments: Arguments = match command_line::parse() {
        Ok(arguments) => arguments,
        Err(status) => return status,
    };
    let end = || {
        processes::end_all();
        run_folder::write_lists();
    };
    if let Err(error) = end_on_signals("volant", end) {
        return command_line::failure("volant", &error.into());
    }
    match arguments.action.run() {
        (_, Ok(true)) => ExitCode::SUCCESS,
        (_, Ok(false)) => ExitCode::FAILURE,
        (name, Err(error)) => command_line::failure(&format!("volant {name}"), &error),
    }
}
