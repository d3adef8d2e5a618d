//! The paper's experiments on the simulated bench, by the nodes' own cores.
//!
//! [`offline`] runs the cores over a scenario's film and samples, in order of arrival; [`curves`] makes Fig. 13 and
//! Table II, [`rest`] Fig. 9, [`report`] the page that shows them.

pub mod curves;
pub mod offline;
pub mod report;
pub mod rest;

use std::path::PathBuf;

/// A table or figure that was made.
#[derive(Clone, Debug)]
pub struct Made {
    /// As in the contract: `table-2`, `fig-13`, …
    pub name: &'static str,
    /// What it is.
    pub title: &'static str,
    /// The numbers.
    pub csv: PathBuf,
    /// The picture; tables have none.
    pub svg: Option<PathBuf>,
    /// What it shows, and where it differs from the published one and why.
    pub words: String,
}

/// Why an experiment could not be made.
#[derive(Debug, thiserror::Error)]
pub enum PaperError {
    /// A file.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The simulated rig.
    #[error(transparent)]
    Scenario(#[from] crate::live::scenario::ScenarioError),
    /// The camera's pictures.
    #[error("a picture: {0}")]
    Picture(String),
    /// The drawing.
    #[error("{0}")]
    Drawing(String),
    /// A filter said nothing.
    #[error("the model {model} gave no pose; its warnings: {warnings}")]
    NoPose {
        /// Which.
        model: &'static str,
        /// What it said.
        warnings: String,
    },
}

/// Writes a file, and names it where that fails.
///
/// # Errors
/// What the system says.
pub(crate) fn write(path: &std::path::Path, text: &str) -> Result<(), PaperError> {
    std::fs::write(path, text).map_err(|source| PaperError::Io { path: path.to_owned(), source })
}
