//! `volant imu …`: what a person does with a unit and its logs.

mod live;
mod playback;

use crate::{
    log::{LogCounts, LogError, decode_to_csv, saved_configuration},
    protocol::LegacyFormat,
};
use clap::{Parser, Subcommand};
use std::{
    fs::File,
    io::{BufWriter, Read, Write},
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

/// Longest log that is read at once: a day at 400 Hz has 2 GB.
const LONGEST_LOG: u64 = 4 << 30;

pub(crate) fn read_log(path: &Path) -> Result<Vec<u8>, Failure> {
    let cannot =
        |e: std::io::Error| format!("{} cannot be read: {e}; give a file of raw bytes", path.display());
    let file = File::open(path).map_err(cannot)?;
    let length = file.metadata().map_err(cannot)?.len();
    let mut log = Vec::with_capacity(length.min(LONGEST_LOG) as usize);
    file.take(LONGEST_LOG + 1).read_to_end(&mut log).map_err(cannot)?;
    if log.len() as u64 > LONGEST_LOG {
        let gibibytes = LONGEST_LOG >> 30;
        return Err(format!(
            "{} is longer than {gibibytes} GiB; split it (any split will do)",
            path.display()
        ));
    }
    Ok(log)
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
    // Decoded twice: a log that is none leaves no empty table behind, and a table is some times as long as its log.
    let of_log = |e| match e {
        LogError::Write { source } => cannot(source),
        e => format!("{}: {e}", arguments.log.display()),
    };
    decode_to_csv(&log, format, &mut std::io::sink()).map_err(of_log)?;
    let mut file = BufWriter::new(File::create(csv).map_err(cannot)?);
    let counts = decode_to_csv(&log, format, &mut file).map_err(of_log)?;
    file.flush().map_err(cannot)?;
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
