//! Measurement of one straight edge of a square, below the pixel.

mod columns;
mod edge_fit;
mod interior;
mod levels;
mod line;
mod measure;
mod outside;
mod prior;
mod row_plan;
mod rows;
mod side;

pub(crate) use columns::{MAX_ROWS, eight};
pub(crate) use edge_fit::{EdgeFit, LAGS};
pub(crate) use interior::Interior;
pub(crate) use levels::Levels;
pub(crate) use measure::{SHADE, fit_edge};
pub(crate) use prior::{Light, ShapePrior, Tolerance};
pub(crate) use rows::Rows;
pub(crate) use side::Side;
