//! How the filter is set: every number that is not on the rig file, with its unit.

use serde::{Deserialize, Serialize};

/// Which estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Model {
    /// The error-state filter on the markers' pixels.
    #[default]
    Tight,
    /// The published loosely coupled extended Kalman filter.
    Paper,
}

/// Everything that can be set.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FusionConfig {
    /// Which estimator.
    pub model: Model,
}
