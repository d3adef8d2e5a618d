//! The rig from a recording: where the camera sits on the climber, how the inertial unit sits on the platform, and where the
//! markers are, refined together by bundle adjustment with uncertainties.
//!
//! The platform swings freely, so images alone say nothing about the rig: what ties it together is gravity and the
//! inertial unit between the images, and the encoders. What a recording's motion does not determine keeps its value
//! and is named.

mod arrow;
pub mod command;
mod estimate;
mod inertial;
mod problem;
mod recording;

pub use estimate::{Estimate, Row, refine_rig};
pub use recording::{Recording, Shot};

use anyhow::{Context, Result};
use rig_model::{MarkerColor, Rig};
use std::path::Path;

/// The markers are found anew until their places move by less than this, m: a tenth of what a good recording tells.
const SETTLED: f64 = 3e-5;
const ROUNDS: usize = 4;

/// Refines a rig by a bag.
///
/// How the tracker sees a square rests a little on where the rig file puts the markers, so the images are looked at again with the
/// refined places until these no longer change. The rig file stays what the estimate is tied to where the motion tells nothing.
///
/// # Errors
/// As [`Recording::read`] and [`refine_rig`].
pub fn refine_from_bag(bag: &Path, rig: &Rig) -> Result<Estimate> {
    let mut seen_with = rig.clone();
    let mut round = 1;
    loop {
        let recording = Recording::read(bag, &seen_with)?;
        let estimate = refine_rig(&recording, rig).with_context(|| format!("{}", bag.display()))?;
        let centres = [&estimate.rig, &seen_with].map(|r| &r.markers.centres);
        let moved =
            MarkerColor::ALL.map(|c| (centres[0][c] - centres[1][c]).norm()).into_iter().fold(0.0, f64::max);
        if moved < SETTLED || round == ROUNDS {
            return Ok(estimate);
        }
        seen_with.markers = estimate.rig.markers.clone();
        round += 1;
    }
}
