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

use std::path::{Path, PathBuf};
use volant::report::{ChartError, Table};

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
    /// As found here.
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
    /// Title.
    pub title: &'static str,
    /// The numbers.
    pub csv: PathBuf,
    /// The image.
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

/// Why an experiment could not be made.
#[derive(Debug, thiserror::Error)]
pub enum PaperError {
    /// A file.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// Error of the system call.
        source: std::io::Error,
    },
    /// The simulated rig.
    #[error(transparent)]
    Scenario(#[from] crate::live::scenario::ScenarioError),
    /// The camera's images.
    #[error("an image: {0}")]
    Image(String),
    /// The drawing.
    #[error("a drawing: {0}")]
    Drawing(#[from] ChartError),
    /// A table of `volant-peers` that is not as it should be.
    #[error("{}: {what}; rebuild volant-peers with `make reproduce`, so that the versions \
             match", path.display())]
    Table {
        /// Which.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// A filter without output.
    #[error("the model {model} gave no pose; its warnings: {warnings}")]
    NoPose {
        /// Which.
        model: &'static str,
        /// Its name.
        warnings: String,
    },
}

/// Writes a file in a folder and returns its path; names it where that fails.
///
/// # Errors
/// Writing failed.
pub(crate) fn write(folder: &Path, name: &str, text: &str) -> Result<PathBuf, PaperError> {
    let path = folder.join(name);
    match std::fs::write(&path, text) {
        Ok(()) => Ok(path),
        Err(source) => Err(PaperError::Io { path, source }),
    }
}

/// Reads a file, and names it where that fails.
///
/// # Errors
/// Reading failed.
pub(crate) fn read(path: &Path) -> Result<String, PaperError> {
    std::fs::read_to_string(path).map_err(|source| PaperError::Io { path: path.to_owned(), source })
}
