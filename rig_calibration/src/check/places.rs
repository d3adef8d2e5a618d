//! Places of the markers against each other: errors too small to call one marker wrong, and large
//! enough to tilt the pose.

use super::{
    findings::{Finding, Verdict},
    select::Outcome,
};
use crate::{parameters::MARKERS, problem::layout_gauge};
use nalgebra::{DVector, SMatrix, SVector};
use rig_model::{MarkerColor, Rig};

/// Smallest displacement of one marker that is suspect, m: on a layout of the paper's size 1 mm
/// tilts the pose by up to a degree.
const TILTS: f64 = 5e-4;
/// Standard deviations by which it differs from zero.
const CERTAIN: f64 = 5.0;

/// Returns a finding where the markers are elsewhere against each other, but for a common motion
/// and size, which the file defines. `change` is the estimate's difference to the files.
pub(super) fn examine(rig: &Rig, outcome: &Outcome, change: &DVector<f64>) -> Option<Finding> {
    let gauge = layout_gauge(rig);
    let inverse = (gauge * gauge.transpose()).try_inverse()?;
    let shown = SMatrix::<f64, 12, 12>::identity() - gauge.transpose() * inverse * gauge;
    let offsets: SVector<f64, 12> = shown * change.fixed_rows::<12>(MARKERS.start);
    let covariance = shown * outcome.markers * shown;
    // Of a displacement of one coordinate alone this share is shown.
    let alone = |i: usize| offsets[i] / shown[(i, i)].max(1e-3);
    let explained = |i: usize| offsets[i] * alone(i);
    let certain = (0..12).filter(|i| {
        let deviation = covariance[(*i, *i)].max(0.0).sqrt();
        i % 3 < 2 && offsets[*i].abs() > CERTAIN * deviation && alone(*i).abs() > TILTS
    });
    let worst = certain.max_by(|a, b| explained(*a).total_cmp(&explained(*b)))?;
    let color = MarkerColor::ALL[worst / 3];
    let (axis, millimeters) = (["x", "y"][worst % 3], 1e3 * alone(worst));
    Some(Finding {
        verdict: Verdict::Suspect,
        ..Finding::wrong(
            "markers",
            format!(
                "the markers are not where the file has them: if only {color} is elsewhere, by \
                 {millimeters:+.1} mm along {axis}, which may tilt the pose"
            ),
            "run `volant calibrate rig`, or measure all markers again",
        )
    })
}
