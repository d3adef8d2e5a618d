//! Standard error: messages of one line each, and progress bars on a terminal.

use anyhow::anyhow;
use indicatif::{ProgressBar, ProgressStyle};
use node_kit::errln;
use std::fmt::Display;
use volant::command_line::one_line;

/// Prints a message as one line.
pub fn line(text: &str) {
    errln!("{}", one_line(text));
}

/// Prints a message of `volant` as one line.
pub fn warn(text: impl Display) {
    line(&format!("volant: {text}"));
}

/// Prints what a recording lacks beside a result, each sentence once; an error names it in its own
/// line.
pub fn with_losses<T>(result: anyhow::Result<T>, losses: &[String]) -> anyhow::Result<T> {
    let mut distinct: Vec<&str> = vec![];
    for loss in losses {
        if !distinct.contains(&loss.as_str()) {
            distinct.push(loss);
        }
    }
    match result {
        Err(error) if !distinct.is_empty() => Err(anyhow!("{error:#}; {}", distinct.join("; "))),
        result => {
            distinct.iter().for_each(warn);
            result
        }
    }
}

/// Progress bar over a number of bytes; drawn on a terminal only.
pub fn progress(what: &str, bytes: u64) -> ProgressBar {
    let bar = ProgressBar::new(bytes);
    let template = "{prefix} {wide_bar} {percent:>3} %  {bytes_per_sec}, {eta} left";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar.set_prefix(what.to_owned());
    bar
}

/// Formats a number of bytes.
pub fn mebibytes(bytes: u64) -> String {
    if bytes < 1 << 20 {
        format!("{:.1} KiB", bytes as f64 / 1024.0)
    } else {
        format!("{:.1} MiB", bytes as f64 / (1u64 << 20) as f64)
    }
}

/// Status line; drawn on a terminal only.
pub fn spinner() -> ProgressBar {
    let bar = ProgressBar::new_spinner();
    bar.enable_steady_tick(std::time::Duration::from_millis(200));
    bar
}
