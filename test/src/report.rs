//! Text reports: a table like the paper's Table II, and the version of a measured table. Charts and
//! the page are in `volant::report`.

use crate::accuracy::{AXES, Errors, UNITS};
use anyhow::Result;
use node_kit::{
    files::{self, FileError},
    outln,
};
use std::{
    path::{Path, PathBuf},
    process::Command,
};
use volant::report::Table;

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

    /// Writes the table like [`Self::write`], and prints it.
    pub fn publish(&self, head: &str, table: &str) -> Result<()> {
        self.write(head, table)?;
        outln!("{table}")?;
        Ok(())
    }
}

/// Result of a live run: figures for the table, a remark for the terminal, and what does not hold.
pub struct Measured {
    pub cells: Vec<String>,
    pub remark: String,
    pub failures: Vec<String>,
}

/// Table of live runs: name, figures and verdict of each.
pub struct LiveTable {
    head: &'static str,
    rows: Vec<Vec<String>>,
    /// Number of rows that hold.
    held: usize,
}

impl LiveTable {
    /// `head` as in [`Table::new`].
    pub fn new(head: &'static str) -> Self {
        Self { head, rows: vec![], held: 0 }
    }

    /// Adds a run and returns its verdict for the terminal. An error means that the run has neither
    /// passed nor failed.
    pub fn add(&mut self, name: &str, result: Result<impl Into<Measured>>) -> String {
        let mut row = vec![name.to_owned()];
        let (verdict, line) = match result.map(Into::into) {
            Err(reason) => {
                row.resize(self.head.matches(" | ").count(), "–".to_owned());
                (format!("**skipped**: {reason}"), format!("SKIPPED: {reason}"))
            }
            Ok(Measured { cells, remark, failures }) => {
                row.extend(cells);
                let reasons = failures.join("; ");
                self.held += usize::from(failures.is_empty());
                match failures.is_empty() {
                    true => ("holds".to_owned(), format!("holds{remark}")),
                    false => (format!("**fails**: {reasons}"), format!("FAILS{remark}: {reasons}")),
                }
            }
        };
        row.push(verdict);
        self.rows.push(row);
        line
    }

    /// Prints the table, and writes it below `head`; returns whether all rows hold.
    pub fn finish(self, file: &TableFile, head: &str) -> Result<bool> {
        let rows = self.rows.len();
        file.publish(head, &Table::new(self.head, self.rows).to_markdown())?;
        outln!("{} of {rows} rows hold", self.held)?;
        Ok(self.held == rows)
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
    fn a_row_of_live_runs_holds_fails_or_is_skipped() {
        let mut table = LiveTable::new("fault | error | verdict");
        let run = |failures: &[&str]| Measured {
            cells: vec!["1 mm".to_owned()],
            remark: " (1 mm)".to_owned(),
            failures: failures.iter().map(|f| (*f).to_owned()).collect(),
        };
        assert_eq!(table.add("a", Ok(run(&[]))), "holds (1 mm)");
        assert_eq!(table.add("b", Ok(run(&["x", "y"]))), "FAILS (1 mm): x; y");
        assert_eq!(table.add("c", Err::<Measured, _>(anyhow::anyhow!("z"))), "SKIPPED: z");
        let rows = [["a", "1 mm", "holds"], ["b", "1 mm", "**fails**: x; y"]];
        assert!(table.held == 1 && table.rows[..2] == rows);
        assert_eq!(table.rows[2], ["c", "–", "**skipped**: z"]);
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
