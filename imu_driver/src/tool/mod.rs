//! Command `volant imu`.

mod live;

use crate::log::{LogCounts, LogError, decode_to_csv, saved_configuration};
use clap::{Parser, Subcommand, error::ErrorKind};
use node_kit::{
    console::{self, EXIT_STATUS, OutputError},
    errln,
    files::{FileError, OutputFile, check_output},
    out,
};
use std::{
    fs::File,
    io::{BufWriter, Read},
    path::{Path, PathBuf},
    process::ExitCode,
};
use thiserror::Error;

/// Find, inspect, configure and log Xsens IMUs; decode logs.
#[derive(Debug, Parser)]
#[command(name = "volant imu", bin_name = "volant imu", version, after_help = EXIT_STATUS)]
pub struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Search the serial ports of this computer for IMUs
    Find(live::Find),
    /// Show identity and configuration of an IMU
    Info(live::Line),
    /// Set rate, outputs and baud rate of an IMU (stored in its flash)
    Configure(live::Configure),
    /// Record the raw bytes of an IMU, its configuration first
    Log(live::Log),
    /// Decode a log to CSV
    Decode(Decode),
}

#[derive(Debug, clap::Args)]
struct Decode {
    /// Raw bytes recorded from an IMU
    log: PathBuf,
    /// Configuration of the IMU, required for legacy MTData if the log contains none
    #[arg(long)]
    config: Option<PathBuf>,
    /// CSV to write: one row per data message
    #[arg(long)]
    csv: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
}

/// Parses a time in seconds: clap accepts NaN and negative numbers.
fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds.is_finite() && seconds >= 0.0 => Ok(seconds),
        _ => Err("give a time in seconds, such as 10".to_owned()),
    }
}

/// Why a command failed.
#[derive(Debug, Error)]
enum Failure {
    /// Message of one line: file or device, and remedy.
    #[error("{0}")]
    Work(String),
    /// A file that is not written.
    #[error(transparent)]
    File(#[from] FileError),
    /// Standard output is closed or full.
    #[error(transparent)]
    Output(#[from] OutputError),
}

impl From<String> for Failure {
    fn from(message: String) -> Self {
        Self::Work(message)
    }
}

const NAME: &str = "volant imu";

/// Runs the command of the process's command line and returns the exit status.
pub fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            // Fails where standard output or error is closed.
            let printed = error.print().map_err(OutputError::from).and_then(|()| out!(""));
            return match (error.kind(), printed) {
                (ErrorKind::DisplayHelp | ErrorKind::DisplayVersion, Ok(())) => ExitCode::SUCCESS,
                (ErrorKind::DisplayHelp | ErrorKind::DisplayVersion, Err(e)) => e.report(NAME),
                _ => ExitCode::from(2),
            };
        }
    };
    // A log without a duration is ended by a signal, and is complete then.
    if !matches!(arguments.command, Command::Log(_))
        && let Err(error) = console::end_on_signals(NAME, || {})
    {
        errln!("{NAME}: {error}");
        return ExitCode::FAILURE;
    }
    let done = match arguments.command {
        Command::Find(find) => live::find(&find),
        Command::Info(line) => live::info(&line),
        Command::Configure(configure) => live::configure(&configure),
        Command::Log(log) => live::log(&log),
        Command::Decode(decode) => run_decode(&decode),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure::Output(error)) => error.report(NAME),
        Err(failure) => {
            errln!("{NAME}: {failure}");
            ExitCode::FAILURE
        }
    }
}

/// Largest log, bytes: a day at 400 Hz has 2 GB.
const LONGEST_LOG: u64 = 4 << 30;

fn read_log(path: &Path) -> Result<Vec<u8>, Failure> {
    let cannot = |e: std::io::Error| {
        Failure::from(format!("{} cannot be read: {e}; give a log of raw bytes", path.display()))
    };
    let file = File::open(path).map_err(cannot)?;
    let length = file.metadata().map_err(cannot)?.len();
    let mut log = Vec::with_capacity(length.min(LONGEST_LOG) as usize);
    file.take(LONGEST_LOG + 1).read_to_end(&mut log).map_err(cannot)?;
    if log.len() as u64 > LONGEST_LOG {
        let gibibytes = LONGEST_LOG >> 30;
        let path = path.display();
        return Err(format!("{path} is larger than {gibibytes} GiB; split it (at any byte)").into());
    }
    Ok(log)
}

fn run_decode(arguments: &Decode) -> Result<(), Failure> {
    let (csv, config) = (&arguments.csv, arguments.config.as_deref());
    let inputs: Vec<&Path> = std::iter::once(arguments.log.as_path()).chain(config).collect();
    check_output(csv, arguments.overwrite, &inputs)?;
    let log = read_log(&arguments.log)?;
    let format = match config {
        Some(path) => {
            saved_configuration(&read_log(path)?).map_err(|e| format!("{}: {e}", path.display()))?
        }
        None => None,
    };
    // The CSV is too large to keep in memory; of an invalid log none is left.
    let mut file = BufWriter::new(OutputFile::create(csv, arguments.overwrite)?);
    let cannot = |error| FileError::Io { path: csv.clone(), error };
    let counts = decode_to_csv(&log, format, &mut file).map_err(|e| match e {
        LogError::Write(source) => Failure::from(cannot(source)),
        e => format!("{}: {e}", arguments.log.display()).into(),
    })?;
    file.into_inner().map_err(|e| cannot(e.into_error()))?.commit()?;
    print_counts(&counts);
    Ok(())
}

fn print_counts(counts: &LogCounts) {
    if counts.unreadable > 0 {
        errln!("{} data messages do not fit the format and are omitted", counts.unreadable);
    }
    let others = counts.parser.frames - counts.rows - counts.unreadable;
    if others > 0 {
        errln!("{others} frames are not data messages (acknowledgements, configuration)");
    }
    errln!(
        "{} frames, {} bad checksums, {} skipped bytes",
        counts.parser.frames,
        counts.parser.bad_checksums,
        counts.parser.skipped_bytes
    );
}
