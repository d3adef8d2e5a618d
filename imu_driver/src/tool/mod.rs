//! `volant imu …`: what a person does with a unit and its logs.

mod live;
mod playback;

use crate::{
    log::{LogCounts, decode_to_csv, saved_configuration},
    protocol::LegacyFormat,
};
use clap::{Parser, Subcommand};
use std::{
    fs::File,
    io::{BufWriter, Write},
    path::{Path, PathBuf},
    process::ExitCode,
};

/// Finds, shows, sets, logs and decodes Xsens inertial units.
#[derive(Debug, Parser)]
#[command(name = "volant imu", bin_name = "volant imu", version)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Look for units on the serial ports of this machine
    Find(live::Find),
    /// Show a unit's identity and configuration
    Info(live::Line),
    /// Set a unit's rate, outputs and baud rate (they go into its flash)
    Configure(live::Configure),
    /// Record a unit's raw bytes, its configuration first
    Log(live::Log),
    /// Play a log back through the driver and show what it makes of it
    Playback(playback::Playback),
    /// Decode a log to a table
    Decode(Decode),
}

#[derive(Debug, clap::Args)]
struct Decode {
    /// Raw bytes recorded from a unit
    log: PathBuf,
    /// The unit's Configuration, where the log holds none (legacy MTData cannot be read without)
    #[arg(long)]
    config: Option<PathBuf>,
    /// The table to write: one row per data message
    #[arg(long)]
    csv: PathBuf,
}

/// One line that names the thing and the remedy.
pub(crate) type Failure = String;

/// Does what the command line says; the exit status.
pub fn run(arguments: Arguments) -> ExitCode {
    let done = match arguments.command {
        Command::Find(find) => live::find(&find),
        Command::Info(line) => live::info(&line),
        Command::Configure(configure) => live::configure(&configure),
        Command::Log(log) => live::log(&log),
        Command::Playback(playback) => playback::playback(&playback),
        Command::Decode(decode) => run_decode(&decode),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("volant imu: {failure}");
            ExitCode::FAILURE
        }
    }
}

pub(crate) fn read_log(path: &Path) -> Result<Vec<u8>, Failure> {
    std::fs::read(path)
        .map_err(|e| format!("{} cannot be read: {e}; give a file of raw bytes", path.display()))
}

pub(crate) fn read_configuration(path: Option<&Path>) -> Result<Option<LegacyFormat>, Failure> {
    let Some(path) = path else {
        return Ok(None);
    };
    saved_configuration(&read_log(path)?).map_err(|e| format!("{}: {e}", path.display()))
}

fn run_decode(arguments: &Decode) -> Result<(), Failure> {
    let log = read_log(&arguments.log)?;
    let format = read_configuration(arguments.config.as_deref())?;
    let csv = &arguments.csv;
    let cannot = |e: std::io::Error| format!("{} cannot be written: {e}; give another --csv", csv.display());
    // Decoded first: a log that is none leaves no empty table behind.
    let mut table = Vec::new();
    let counts =
        decode_to_csv(&log, format, &mut table).map_err(|e| format!("{}: {e}", arguments.log.display()))?;
    let mut file = BufWriter::new(File::create(csv).map_err(cannot)?);
    file.write_all(&table).and_then(|()| file.flush()).map_err(cannot)?;
    say_counts(&counts);
    Ok(())
}

fn say_counts(counts: &LogCounts) {
    if counts.unreadable > 0 {
        eprintln!("{} data messages do not fit the format and are left out", counts.unreadable);
    }
    let others = counts.parser.frames - counts.rows - counts.unreadable;
    if others > 0 {
        eprintln!("{others} frames are no data messages (acknowledgements, configuration)");
    }
    eprintln!(
        "{} frames, {} bad checksums, {} skipped bytes",
        counts.parser.frames, counts.parser.bad_checksums, counts.parser.skipped_bytes
    );
}
