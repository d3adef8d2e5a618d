//! Standard output and error of command line programs.
//!
//! `println!` and `eprintln!` panic where the reader has gone or the disk is full.
//! [`outln!`](crate::outln) returns an error, and [`errln!`](crate::errln) ignores it.

use std::{
    fmt,
    io::{self, Write},
    process::ExitCode,
};
use thiserror::Error;

/// Why standard output cannot be written.
#[derive(Debug, Error)]
pub enum OutputError {
    /// The reader has gone, as in `volant evaluate … | head -1`.
    #[error("standard output was closed by its reader")]
    Closed,
    /// Any other reason, such as a full disk.
    #[error("standard output: {0}; check the space where it is redirected to")]
    Failed(io::Error),
}

impl From<io::Error> for OutputError {
    fn from(error: io::Error) -> Self {
        match error.kind() {
            io::ErrorKind::BrokenPipe => Self::Closed,
            _ => Self::Failed(error),
        }
    }
}

/// Exit status of the commands, for `--help` and the manual.
pub const EXIT_STATUS: &str = "\
Exit status:
  0    done; all that the command checks holds
  1    the work failed, with one line on standard error; or what the command checks does not hold
  2    the command line is wrong
  129  the terminal was closed (SIGHUP); existing files are unchanged
  130  interrupted by SIGINT (ctrl-c); existing files are unchanged
  141  the reader of standard output has gone
  143  ended by SIGTERM; existing files are unchanged
Nodes, record, play, monitor, foxglove and imu log run until one of these signals (play: or the end
of the bag) and end with 0. `calibrate climber --live` uses what it recorded until then.";

/// Exit status of a program whose reader has gone: what a shell reports for SIGPIPE (128 + 13).
const READER_GONE: u8 = 141;

impl OutputError {
    /// Reports the error of `program` on standard error, and returns the exit status: 1, or 141
    /// without a message where the reader has gone.
    pub fn report(&self, program: &str) -> ExitCode {
        match self {
            Self::Closed => ExitCode::from(READER_GONE),
            Self::Failed(_) => {
                crate::errln!("{program}: {self}");
                ExitCode::FAILURE
            }
        }
    }
}

/// Writes text to standard output and flushes it; see [`out!`](crate::out).
///
/// # Errors
/// The reader has gone, or the text cannot be written.
pub fn write_out(text: fmt::Arguments<'_>) -> Result<(), OutputError> {
    let mut out = io::stdout().lock();
    Ok(out.write_fmt(text).and_then(|()| out.flush())?)
}

/// Writes a line to standard error; see [`errln!`](crate::errln).
pub fn write_error_line(text: fmt::Arguments<'_>) {
    // Nobody can be informed where standard error is closed or full.
    let _ = writeln!(io::stderr(), "{text}");
}

/// Returns the signals that end a program: SIGINT, SIGTERM, and SIGHUP (the terminal was closed)
/// unless it was started to ignore that one, as `nohup` does.
#[cfg(feature = "signals")]
pub fn stop_signals() -> Vec<i32> {
    use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let ignored = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    let mut signals = vec![SIGINT, SIGTERM];
    if ignored & 1 << (SIGHUP - 1) == 0 {
        signals.push(SIGHUP);
    }
    signals
}

/// Ends the process on [`stop_signals`] with the status that a shell reports for the signal (130,
/// 143, 129). Incomplete outputs are removed and named on standard error; `first` is called before.
///
/// # Errors
/// The system does not deliver the signals.
#[cfg(feature = "signals")]
#[allow(clippy::disallowed_methods, reason = "the work of the other threads is given up")]
pub fn end_on_signals(
    program: &'static str,
    first: impl FnOnce() + Send + 'static,
) -> io::Result<()> {
    let mut signals = signal_hook::iterator::Signals::new(stop_signals())?;
    std::thread::spawn(move || {
        let Some(signal) = signals.forever().next() else { return };
        first();
        let outputs = crate::files::discard_all();
        if outputs.is_empty() {
            crate::errln!("{program}: interrupted");
        }
        for path in outputs {
            let left = if path.exists() { "is the former one" } else { "was not written" };
            crate::errln!("{program}: interrupted; {} {left}", path.display());
        }
        std::process::exit(128 + signal);
    });
    Ok(())
}

/// Keeps SIGXFSZ from ending the process: a write beyond the limit of a file's size (`ulimit -f`)
/// fails instead, and its error names the file.
///
/// # Errors
/// The system does not deliver the signal.
#[cfg(feature = "signals")]
pub fn survive_file_size_limit() -> io::Result<()> {
    let unused = std::sync::Arc::default();
    signal_hook::flag::register(signal_hook::consts::SIGXFSZ, unused).map(drop)
}

/// Flag that [`stop_signals`] set.
///
/// # Errors
/// The system does not deliver the signals.
#[cfg(feature = "signals")]
pub fn stop_flag() -> io::Result<std::sync::Arc<std::sync::atomic::AtomicBool>> {
    let flag = std::sync::Arc::default();
    for signal in stop_signals() {
        signal_hook::flag::register(signal, std::sync::Arc::clone(&flag))?;
    }
    Ok(flag)
}

/// `print!` that returns an [`OutputError`] instead of panicking.
#[macro_export]
macro_rules! out {
    ($($text:tt)*) => { $crate::console::write_out(::std::format_args!($($text)*)) };
}

/// `println!` that returns an [`OutputError`] instead of panicking.
#[macro_export]
macro_rules! outln {
    () => { $crate::out!("\n") };
    ($format:literal $($rest:tt)*) => {
        $crate::out!("{}\n", ::std::format_args!($format $($rest)*))
    };
}

/// `eprintln!` that ignores a standard error that is closed or full.
#[macro_export]
macro_rules! errln {
    ($($text:tt)*) => { $crate::console::write_error_line(::std::format_args!($($text)*)) };
}
