//! What goes to the standard error: notes of one line each, and progress on a terminal.

use indicatif::{ProgressBar, ProgressStyle};
use std::{io::Write, path::Path};

/// One line, whatever is in the text.
pub fn line(text: &str) {
    let text = text.replace(['\n', '\r'], " ");
    // Standard error may be closed; that is no reason to stop.
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// A bar over a number of bytes; drawn on a terminal only.
pub fn progress(what: &str, bytes: u64) -> ProgressBar {
    let bar = ProgressBar::new(bytes);
    let template = "{prefix} {wide_bar} {percent:>3} %  {bytes_per_sec}, {eta} left";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style);
    }
    bar.set_prefix(what.to_owned());
    bar
}

/// A file's bytes for the lines above.
pub fn mebibytes(bytes: u64) -> String {
    if bytes < 1 << 20 {
        format!("{:.1} KiB", bytes as f64 / 1024.0)
    } else {
        format!("{:.1} MiB", bytes as f64 / (1u64 << 20) as f64)
    }
}

/// The last part of a path.
pub fn name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned())
}

/// A line that changes while something goes on; drawn on a terminal only.
#[cfg(feature = "nodes")]
pub fn spinner() -> ProgressBar {
    let bar = ProgressBar::new_spinner();
    bar.enable_steady_tick(std::time::Duration::from_millis(200));
    bar
}
