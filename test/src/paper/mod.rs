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

use volant::report::Table;

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
    /// Text of `NAME.csv`.
    pub csv: String,
    /// Text of `NAME.svg`.
    pub svg: String,
    /// Numbers for the report below the image.
    pub table: Option<Table>,
    /// Published values beside those found here.
    pub values: Vec<Value>,
    /// Result in words.
    pub shows: String,
    /// Where it differs from what was published, and why.
    pub published: String,
}
