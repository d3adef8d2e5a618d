//! Measurement of one straight edge of a square, below the pixel.

mod interior;
mod line;
mod measure;
mod outside;
mod prior;
mod row_plan;
mod rows;

pub(crate) use interior::Interior;
pub(crate) use line::{EdgeFit, LAGS};
pub(crate) use measure::{SHADE, fit_edge};
pub(crate) use prior::{Levels, Light, ShapePrior, Tolerance};
pub(crate) use row_plan::Side;
pub(crate) use rows::{MAX_ROWS, Rows, eight};
