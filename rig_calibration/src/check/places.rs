//! Places of the markers against each other: errors too small to call one marker wrong, and large
//! enough to tilt the pose.

use super::{Corrected, findings::Finding, findings::Verdict, select::Outcome};
use crate::{parameters::MARKERS, problem::layout_gauge};
use nalgebra::{DVector, SMatrix, SVector};
use rig_model::MarkerColor;

/// Error of a marker against the others that tilts the pose, m: of markers 0.15 m from their center
/// by up to half a degree.
const TILTS: f64 = 3e-4;
/// Standard deviations by which it differs from zero.
const CERTAIN: f64 = 5.0;

/// Adds a finding where the markers are elsewhere against each other, but for a common motion and
/// size, which the file defines. `change` is the estimate's difference to the files. What explains
/// a recording otherwise is mended first.
pub(super) fn examine(state: &mut Corrected, outcome: &Outcome, change: &DVector<f64>) {
    if !outcome.explanations.is_empty() || !state.findings.is_empty() {
        return;
    }
    let gauge = layout_gauge(&state.rig);
    let Some(inverse) = (gauge * gauge.transpose()).try_inverse() else { return };
    let others = SMatrix::<f64, 12, 12>::identity() - gauge.transpose() * inverse * gauge;
    let offsets: SVector<f64, 12> = others * change.fixed_rows::<12>(MARKERS.start);
    let covariance = others * outcome.markers * others;
    let axes = (0..12).filter(|i| i % 3 < 2);
    let certain = axes
        .filter(|i| offsets[*i].abs() > TILTS.max(CERTAIN * covariance[(*i, *i)].max(0.0).sqrt()));
    let Some(worst) = certain.max_by(|a, b| offsets[*a].abs().total_cmp(&offsets[*b].abs())) else {
        return;
    };
    let color = MarkerColor::ALL[worst / 3];
    let axis = ["x", "y"][worst % 3];
    state.findings.push(Finding {
        verdict: Verdict::Suspect,
        ..Finding::wrong(
            "markers",
            format!(
                "the markers are not quite where the file has them: against the others {color} by \
                 {:+.1} mm along {axis}, which tilts the pose",
                1e3 * offsets[worst]
            ),
            "run `volant calibrate rig`, or measure all markers again",
        )
    });
}
