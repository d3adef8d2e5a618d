//! What the executables share: parsing with an exit status, and reporting errors.
//!
//! Exit status: see [`EXIT_STATUS`].

use clap::{Command, Parser, builder::Resettable, error::ErrorKind};
use node_kit::{
    NodeName,
    console::{EXIT_STATUS, OutputError, survive_file_size_limit},
    errln,
    files::{self, FileError},
    names::NameError,
    out,
};
use std::{
    ffi::OsString, io::Write, ops::RangeInclusive, path::PathBuf, process::ExitCode, time::Duration,
};
use thiserror::Error;

/// Parses the command line of the process, which from now on reports writes beyond a limit of file
/// sizes.
///
/// # Errors
/// The exit status of a wrong command line (reported on standard error), or of `--help` and
/// `--version` (0, or that of [`OutputError::report`] where writing them fails).
pub fn parse<P: Parser>() -> Result<P, ExitCode> {
    // Without it such a write ends the process, as before.
    let _ = survive_file_size_limit();
    parse_from(std::env::args_os())
}

/// Parses a command line that starts with the program's name; see [`parse`].
///
/// # Errors
/// As [`parse`].
pub fn parse_from<P: Parser>(words: impl IntoIterator<Item = OsString>) -> Result<P, ExitCode> {
    P::try_parse_from(words).map_err(|error| match error.kind() {
        ErrorKind::DisplayHelp | ErrorKind::DisplayVersion => {
            match error.print().map_err(OutputError::from).and_then(|()| out!("")) {
                Ok(()) => ExitCode::SUCCESS,
                Err(error) => error.report("volant"),
            }
        }
        _ => {
            // Fails where standard error is closed: the status is all that is left.
            let _ = error.print();
            ExitCode::from(2)
        }
    })
}

/// Returns a parser of numbers within a range, for arguments.
pub fn number(
    range: RangeInclusive<f64>,
) -> impl Fn(&str) -> Result<f64, String> + Clone + Send + Sync + 'static {
    move |text| {
        let number = text.parse().ok().filter(|x| range.contains(x));
        number.ok_or_else(|| format!("must be a number from {} to {}", range.start(), range.end()))
    }
}

/// Returns a parser of times within a range, s, for arguments.
pub fn seconds(
    range: RangeInclusive<f64>,
) -> impl Fn(&str) -> Result<Duration, String> + Clone + Send + Sync + 'static {
    let number = number(range);
    move |text| {
        let time = Duration::try_from_secs_f64(number(text)?);
        time.map_err(|error| error.to_string())
    }
}

/// Parses a namespace, with slashes around it or without; empty or `/`: none.
///
/// # Errors
/// It is not a name of ROS 2.
pub fn namespace(text: &str) -> Result<String, NameError> {
    let namespace = text.trim_matches('/');
    NodeName::new(namespace, "volant").map(|_| namespace.to_owned())
}

/// Parses a topic; a relative name is one of the namespace `/`.
///
/// # Errors
/// It is not a name of ROS 2.
pub fn topic(text: &str) -> Result<String, NameError> {
    NodeName::new("/", "volant")?.expand(text)
}

/// Joins the words of a command line, quoted for a shell.
pub fn quoted(words: &[String]) -> String {
    // No argument contains a NUL byte.
    shlex::try_join(words.iter().map(String::as_str)).unwrap_or_else(|_| words.join(" "))
}

/// Options of a command that are valid alone and not together.
#[derive(Debug, Error)]
#[error("{0}")]
pub struct UsageError(pub String);

/// Reports why `program` failed, in one line on standard error, and returns its exit status.
pub fn failure(program: &str, error: &anyhow::Error) -> ExitCode {
    if let Some(output) = error.downcast_ref::<OutputError>() {
        return output.report(program);
    }
    errln!("{program}: {}", one_line(&causes(error)));
    if error.is::<UsageError>() { ExitCode::from(2) } else { ExitCode::FAILURE }
}

/// Replaces line breaks by spaces.
pub fn one_line(text: &str) -> String {
    text.replace(['\n', '\r'], " ")
}

/// The error and its causes, without those whose text the error repeats.
fn causes(error: &anyhow::Error) -> String {
    error.chain().fold(String::new(), |text, cause| match (cause.to_string(), text.is_empty()) {
        (cause, true) => cause,
        (cause, false) if text.contains(&cause) => text,
        (cause, false) => format!("{text}: {cause}"),
    })
}

/// Options of the commands that write manual pages.
#[derive(Debug, clap::Args)]
pub struct Manual {
    /// Folder for the pages, such as ~/.local/share/man/man1
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Replace existing pages
    #[arg(long)]
    pub overwrite: bool,
}

impl Manual {
    /// Writes the page of `command`, if `itself`, and those of its visible subcommands:
    /// `volant.1`, `volant-replay.1`.
    ///
    /// # Errors
    /// A page exists, or is not writable.
    pub fn write(&self, command: Command, itself: bool) -> Result<(), FileError> {
        std::fs::create_dir_all(&self.out)
            .map_err(|error| FileError::Io { path: self.out.clone(), error })?;
        let mut command = command.disable_help_subcommand(true);
        command.build();
        self.pages(&command, "volant", itself)
    }

    fn pages(&self, command: &Command, name: &str, itself: bool) -> Result<(), FileError> {
        let path = self.out.join(format!("{name}.1"));
        if itself {
            let status = EXIT_STATUS.split_once('\n').map_or("", |(_, rows)| rows);
            let mut page = vec![];
            clap_mangen::Man::new(command.clone().after_help(Resettable::Reset))
                .render(&mut page)
                .and_then(|()| write!(page, ".SH \"EXIT STATUS\"\n.nf\n{status}\n.fi\n"))
                .map_err(|error| FileError::Io { path: path.clone(), error })?;
            files::write(&path, &page, self.overwrite)?;
        }
        command
            .get_subcommands()
            .filter(|c| !c.is_hide_set())
            .try_for_each(|c| self.pages(c, &format!("{name}-{}", c.get_name()), true))
    }
}
