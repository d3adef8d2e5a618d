//! The paper's experiments on the simulated bench, by the nodes' own cores.
//!
//! [`offline`] runs the cores over a scenario's images and samples, in order of arrival; [`curves`]
//! makes Fig. 13 and Table II, [`stationary`] Fig. 9, [`stages`] the images of Figs. 4 and 5,
//! [`occlusion`] those of Fig. 6; [`peers`] draws what `volant-peers` measured beside the peers:
//! Figs. 2, 7, 11, 12 and Table I. [`report`] makes the page that shows them.

mod bars;
pub mod curves;
pub mod occlusion;
pub mod offline;
pub mod peers;
pub mod report;
pub mod stages;
pub mod stationary;

use anyhow::{Context, Result};
use std::path::{Path, PathBuf};
use volant::report::{Axis, Color, Series, Shape, Table};

/// What can be made, in the order of the paper.
pub const NAMES: [&str; 11] = [
    "fig-2", "fig-4", "fig-5", "fig-6", "fig-7", "fig-9", "table-1", "fig-11", "fig-12", "fig-13",
    "table-2",
];

/// A quantity as published and as found here.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Value {
    /// Which, with its unit.
    pub what: String,
    /// As published; `–` where nothing is.
    pub published: String,
    pub here: String,
}

impl Value {
    /// Creates a row of the report.
    pub fn new(what: &str, published: &str, here: impl Into<String>) -> Self {
        Self { what: what.to_owned(), published: published.to_owned(), here: here.into() }
    }
}

/// A table or figure that was made.
#[derive(Clone, Debug)]
pub struct Made {
    /// As in the contract: `table-2`, `fig-13`, …
    pub name: &'static str,
    pub title: &'static str,
    pub csv: PathBuf,
    pub svg: PathBuf,
    /// Numbers for the report below the image.
    pub table: Option<Table>,
    /// Published values beside those found here.
    pub values: Vec<Value>,
    /// Result in words.
    pub shows: String,
    /// Where it differs from what was published, and why.
    pub published: String,
}

fn axis(name: impl Into<String>, range: [f64; 2], log: bool) -> Axis {
    Axis { name: name.into(), range, log }
}

/// A series without whiskers.
fn series(
    name: impl Into<String>,
    color: Color,
    shape: Shape,
    points: impl IntoIterator<Item = (f64, f64)>,
) -> Series {
    let points = points.into_iter().collect();
    Series { name: name.into(), color, shape, points, spread: Vec::new() }
}

fn table<const N: usize>(head: [&str; N], rows: impl IntoIterator<Item = [String; N]>) -> Table {
    let mut table = Table { head: head.map(str::to_owned).to_vec(), rows: Vec::new() };
    rows.into_iter().for_each(|row| table.push(row.to_vec()));
    table
}

/// Writes a file in a folder and returns its path; names it where that fails.
pub(crate) fn write(folder: &Path, name: &str, text: &str) -> Result<PathBuf> {
    let path = folder.join(name);
    std::fs::write(&path, text).with_context(|| path.display().to_string())?;
    Ok(path)
}

/// Reads a file, and names it where that fails.
pub(crate) fn read(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).with_context(|| path.display().to_string())
}
