//! Robustness: recordings that differ from their rig file in one thing, or in two.

pub mod perturbation;
pub mod recording;
pub mod score;
pub mod table;
