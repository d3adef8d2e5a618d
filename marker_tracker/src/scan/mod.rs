//! Search for patches of the markers' colors.

mod blob;
mod palette;
mod scanner;
mod tint;

pub(crate) use blob::Blob;
pub(crate) use palette::Palette;
pub(crate) use scanner::{CELL, Scanner};
pub(crate) use tint::ScanConfig;
