//! Errors of estimated poses against the truth: RMSE, maximum and NEES.

mod statistics;
mod truth;

pub use statistics::{Nees, PoseError, Score, Spread, SpreadSum, inverse};
pub use truth::{Truth, TruthSample};
