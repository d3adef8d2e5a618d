//! Text reports: a table like the paper's Table II, and the version of a measured table. Charts and
//! the page are in `volant::report`.

use crate::accuracy::{AXES, Errors, UNITS};
use node_kit::files::{self, FileError};
use std::{
    path::{Path, PathBuf},
    process::Command,
};

/// Paragraph that names the version with which a table was measured, and the commit where git knows
/// it.
pub fn measured_with() -> String {
    let git = |arguments: &[&str]| {
        let mut git = Command::new("git");
        let output = git.args(["-C", env!("CARGO_MANIFEST_DIR")]).args(arguments).output().ok()?;
        let text = String::from_utf8_lossy(&output.stdout).trim().to_owned();
        output.status.success().then_some(text)
    };
    let commit = git(&["log", "-1", "--format=, commit %h of %cs"]);
    let changed = git(&["status", "--porcelain", "--untracked-files=no"]);
    let changed = changed.is_some_and(|changed| !changed.is_empty());
    let commit = commit.map(|c| if changed { c + ", with later changes" } else { c });
    let version = env!("CARGO_PKG_VERSION");
    format!("Measured with version {version}{}.\n\n", commit.unwrap_or_default())
}

/// Options of the commands that write a measured table.
#[derive(Debug, clap::Args)]
pub struct TableFile {
    /// Also write the table, as Markdown, to this file
    #[arg(long)]
    table: Option<PathBuf>,
    /// Replace an existing table
    #[arg(long)]
    overwrite: bool,
}

impl TableFile {
    /// Checks before the work that the file can be written and is none of `inputs`.
    pub fn check(&self, inputs: &[&Path]) -> Result<(), FileError> {
        let outputs: Vec<&Path> = self.table.iter().map(PathBuf::as_path).collect();
        files::check_outputs(&outputs, self.overwrite, inputs)
    }

    /// Writes the table below `head` and the version that it was measured with.
    pub fn write(&self, head: &str, table: &str) -> Result<(), FileError> {
        let Some(path) = &self.table else { return Ok(()) };
        let page = format!("{head}{}{table}", measured_with());
        files::write(path, page.as_bytes(), self.overwrite)
    }
}

/// Whether a row of a table holds, as Markdown.
pub fn verdict(failures: &[String]) -> String {
    if failures.is_empty() {
        "holds".to_owned()
    } else {
        format!("**fails**: {}", failures.join("; "))
    }
}

/// One estimate: its name, and the errors that it made.
pub type Row<'a> = (&'a str, &'a Errors);

/// Root mean square and maximum of each axis, one column per estimate.
pub fn table(rows: &[Row<'_>]) -> String {
    let mut lines = Vec::new();
    let mut line = |name: &str, cells: &dyn Fn(&Row<'_>) -> String| {
        lines.push(format!("{name:<12}{}", rows.iter().map(cells).collect::<String>()));
    };
    line("", &|(name, _)| format!("{name:>24}"));
    line("", &|_| format!("{:>14}{:>10}", "RMSE", "max"));
    for (i, (axis, unit)) in AXES.iter().zip(UNITS).enumerate() {
        let digits = if i < 3 { 2 } else { 3 };
        line(&format!("{axis} [{unit}]"), &|(_, errors)| {
            format!("{:>14.digits$}{:>10.digits$}", errors.rmse[i], errors.max[i])
        });
    }
    line("3-D [mm]", &|(_, errors)| format!("{:>14.2}{:>10}", errors.position_rmse, ""));
    line("angle [deg]", &|(_, errors)| format!("{:>14.3}{:>10}", errors.rotation_rmse, ""));
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_measured_table_names_its_version() {
        let text = measured_with();
        assert!(text.starts_with(concat!("Measured with version ", env!("CARGO_PKG_VERSION"))));
        assert!(text.ends_with(".\n\n") && text.lines().count() == 2, "{text}");
    }

    #[test]
    fn the_table_names_every_axis_and_estimate() {
        let errors =
            Errors { rmse: [1.25, 2.0, 3.0, 0.5, 0.25, 0.125], count: 1, ..Errors::default() };
        let text = table(&[("camera alone", &errors), ("fused", &errors)]);
        for part in ["camera alone", "fused", "x [mm]", "yaw [deg]", "1.25", "0.125"] {
            assert!(text.contains(part), "{part} in\n{text}");
        }
    }
}
