//! `volant-rig`: what is done with the simulated rig and the real nodes: `volant demo`, `faults`, `hosts`, `rigs`, `robustness`,
//! `soak` and `reproduce`. One executable for all, so that their common code is built and linked once.
//!
//! Exit status: 0 it was done, and all that was asserted held; 1 it failed or did not hold; 2 the command line was wrong.

#![allow(clippy::print_stdout, reason = "what it prints is its work")]

mod demo;
mod faults;
mod hosts;
mod reproduce;
mod rigs;
mod robustness;
mod soak;

use anyhow::Result;
use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// The simulated rig with the real nodes.
#[derive(Parser)]
#[command(name = "volant", bin_name = "volant", version)]
struct Arguments {
    #[command(subcommand)]
    action: Action,
}

#[derive(Subcommand)]
enum Action {
    Demo(demo::Arguments),
    Faults(faults::Arguments),
    Hosts(hosts::Arguments),
    Reproduce(reproduce::Arguments),
    Rigs(rigs::Arguments),
    Robustness(robustness::Arguments),
    Soak(soak::Arguments),
}

impl Action {
    /// Its name, and whether all that it asserts held.
    fn run(&self) -> (&'static str, Result<bool>) {
        match self {
            Self::Demo(a) => ("demo", demo::run(a).map(|()| true)),
            Self::Faults(a) => ("faults", faults::run(a)),
            Self::Hosts(a) => ("hosts", hosts::run(a)),
            Self::Reproduce(a) => ("reproduce", reproduce::run(a).map(|()| true)),
            Self::Rigs(a) => ("rigs", rigs::run(a).map(|()| true)),
            Self::Robustness(a) => ("robustness", robustness::run(a)),
            Self::Soak(a) => ("soak", soak::run(a)),
        }
    }
}

fn main() -> ExitCode {
    match Arguments::parse().action.run() {
        (_, Ok(true)) => ExitCode::SUCCESS,
        (_, Ok(false)) => ExitCode::FAILURE,
        (name, Err(error)) => {
            eprintln!("volant {name}: {error:#}");
            ExitCode::FAILURE
        }
    }
}
