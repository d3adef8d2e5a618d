//! Consistency check: whether outlines can be the markers of one platform.

use crate::{
    geometry::{PoseObservation, PosePrior},
    outline::QuadFit,
    tracking::{
        camera::View,
        marker::MarkerTrack,
        platform::{MarkerGeometry, PlatformModel},
    },
};
use nalgebra::Isometry3;
use rig_model::{MarkerColor, PerColor};

/// Measured outlines.
pub(super) type Fits = PerColor<Option<QuadFit>>;

/// Number of standard deviations by which a width or a direction may exceed its tolerance: for a
/// normal distribution 6e-5 (two-sided), so that noise alone rejects no marker in hours of images.
const GATE: f64 = 4.0;

/// The same for the reprojection error of three or four centroids: 2.5 σ of the least certain
/// centroid, plus what the adapted layout leaves. Tuned; guarded by `tests/bags`.
const REPROJECTION: (f64, f64) = (0.08, 2.5);

/// How evenly paper is cut by hand: largest deviation of an edge's bias from that of the other
/// markers, px, and in units of the side (0.8 mm of 76 mm).
const UNEVEN: (f64, f64) = (0.25, 0.01);

/// Tolerances of a square's shape in the pose of `count` markers: of the width between opposite
/// edges, px, and of an edge's direction relative to the others, rad. `side`: of the square, px.
///
/// How well the shape is known: of the paper itself and of the pose that it is seen from. Tuned:
/// whole markers are detected (`tests/bags`), cut ones are not.
fn shape_tolerance(known_camera: bool, known_shape: bool, count: usize, side: f64) -> (f64, f64) {
    match (known_camera, known_shape, count) {
        (true, true, 4) => (0.1 + 0.004 * side, 0.01),
        (true, true, 3) => (0.2 + 0.008 * side, 0.015),
        (true, true, _) => (0.5 + 0.03 * side, 0.06),
        (true, false, 3..) => (2.0 * (UNEVEN.0 + UNEVEN.1 * side), 0.08),
        (true, false, _) => (1.0 + 0.05 * side, 0.08),
        (false, ..) => (1.5 + 0.15 * side, 0.15),
    }
}

/// How far an outline is off the shape that a pose, determined by `count` markers, gives it, in
/// units of its tolerance: the widths between opposite edges and the directions of the measured
/// edges. Whatever hides an edge, or continues it in its color, shows in them. A marker whose shape
/// is not known has the `typical_bias` of the others.
pub(super) fn misfit(
    platform: &PlatformModel,
    color: MarkerColor,
    fit: &QuadFit,
    view: &View<'_>,
    count: usize,
    typical_bias: f64,
) -> f64 {
    let Some(expected) = platform.outline(color, view) else { return f64::INFINITY };
    let geometry = &platform.markers[color];
    let side = fit.area.sqrt();
    let (width, slope) = shape_tolerance(view.is_known, geometry.is_shape_known(), count, side);
    let edge_bias = if geometry.is_shape_known() { geometry.edge_bias } else { [typical_bias; 2] };
    // While the layout is still adapting, so is the shape.
    let misplacement = platform.largest_misplacement();
    let width = width + 1.5 * misplacement;
    let slope = slope + 1.5 * misplacement / side.max(10.0);
    let mut worst = 0.0f64;
    for (k, (measured, predicted)) in fit.quad.widths().iter().zip(expected.widths()).enumerate() {
        // Width k is the distance between the edges k and k + 2.
        let (Some(a), Some(b)) = (fit.edges[k], fit.edges[k + 2]) else { continue };
        let sigma = (a.covariance[(0, 0)] + b.covariance[(0, 0)]).sqrt();
        let off = (measured - predicted - 2.0 * edge_bias[k]).abs();
        worst = worst.max(off / (width + GATE * sigma));
    }
    let turns = expected.turns_to(&fit.quad);
    let seen = || turns.iter().zip(&fit.edges).filter_map(|(turn, e)| Some((turn, e.as_ref()?)));
    let mean = seen().map(|(turn, _)| turn).sum::<f64>() / seen().count().max(1) as f64;
    for (turn, e) in seen() {
        let sigma = e.covariance[(1, 1)].sqrt();
        worst = worst.max((turn - mean).abs() / (slope + GATE * sigma));
    }
    worst
}

/// Returns by how much the edges of whole outlines lie outside of their prediction, px (median):
/// the markers share paper, scissors and blooming. 0 where the shapes of all are known.
pub(super) fn typical_bias(platform: &PlatformModel, whole: &Fits, view: &View<'_>) -> f64 {
    if platform.markers.0.iter().all(MarkerGeometry::is_shape_known) {
        return 0.0;
    }
    let mut biases = [0.0; 8];
    let mut count = 0;
    for (color, fit) in whole.iter() {
        let (Some(fit), Some(expected)) = (fit, platform.outline(color, view)) else { continue };
        for (measured, predicted) in fit.quad.widths().iter().zip(expected.widths()) {
            biases[count] = (measured - predicted) / 2.0;
            count += 1;
        }
    }
    let biases = &mut biases[..count];
    biases.sort_unstable_by(f64::total_cmp);
    biases.get(count / 2).copied().unwrap_or_default()
}

/// Checks whole outlines against one pose.
pub(super) struct Consistency<'a> {
    pub platform: &'a PlatformModel,
    /// With their last motion.
    pub tracks: &'a PerColor<MarkerTrack>,
}

impl Consistency<'_> {
    /// The pose (`camera_from_volant`) that the whole outlines determine; those that contradict the
    /// others are removed from `whole`. `start`: with the predicted pose.
    ///
    /// Four centroids over-determine the pose by two, and each square has the widths that the pose
    /// gives it: what does not fit is no marker, or has an edge hidden behind something straight.
    /// Returned with the pose: the one marker that was removed although it has the square's shape
    /// in the pose of the three others.
    pub fn pose(
        &self,
        start: &View<'_>,
        whole: &mut Fits,
    ) -> (Isometry3<f64>, Option<MarkerColor>) {
        let prior =
            PosePrior { camera_from_volant: start.pose, position_sigma: 0.1, rotation_sigma: 0.1 };
        let mut removed: Option<(MarkerColor, QuadFit)> = None;
        loop {
            let count = whole.0.iter().flatten().count();
            if count == 0 {
                return (start.pose, None);
            }
            let mut observations = [PoseObservation::NONE; 4];
            for ((color, fit), slot) in
                whole.iter().filter_map(|(c, f)| Some((c, f.as_ref()?))).zip(&mut observations)
            {
                *slot = self.platform.observation(color, fit, count < 4);
            }
            let observations = &observations[..count];
            let geometry = self.platform.geometry(start.camera);
            let refined = geometry.refine(observations, &start.pose, Some(&prior), 8);
            let Some((pose, rms, _)) = refined else { return (start.pose, None) };
            if count < 2 {
                return (pose, None);
            }
            let view = View { pose, ..*start };
            let typical = typical_bias(self.platform, whole, &view);
            let (mut worst, mut culprit) = (0.0, None);
            for (color, fit) in whole.iter() {
                let Some(fit) = fit else { continue };
                let off = misfit(self.platform, color, fit, &view, count, typical);
                if off > worst {
                    (worst, culprit) = (off, Some(color));
                }
            }
            if worst < 1.0 {
                if count == 2 || rms <= self.reprojection_tolerance(start.is_known, whole) {
                    let is_square = |(color, fit): &(MarkerColor, QuadFit)| {
                        misfit(self.platform, *color, fit, &view, count, typical) < 1.0
                    };
                    let displaced = removed.filter(|_| count == 3).filter(is_square);
                    return (pose, displaced.map(|(color, _)| color));
                }
                culprit = self.strangest(whole);
            }
            let Some(culprit) = self.newcomer(whole).or(culprit) else { return (pose, None) };
            removed = whole[culprit].take().map(|fit| (culprit, fit));
        }
    }

    /// Largest RMS reprojection error of consistent centroids, px: the error of the layout until it
    /// has been adapted, then that of the measurements.
    fn reprojection_tolerance(&self, known_camera: bool, whole: &Fits) -> f64 {
        let placed = self.platform.markers.0.iter().all(|m| m.is_placed());
        match (known_camera, placed) {
            (true, true) => {
                let variance = |f: &QuadFit| f.covariance.trace() / 2.0;
                let sigma = whole.0.iter().flatten().map(variance).fold(0.0, f64::max).sqrt();
                let (base, gate) = REPROJECTION;
                base + gate * sigma + 2.0 * self.platform.largest_misplacement()
            }
            // 2 % of a marker's side is 1.5 mm: how well a layout is measured by hand.
            (true, false) => {
                let side = whole.0.iter().flatten().map(|f| f.area.sqrt()).fold(0.0, f64::max);
                0.5 + 0.02 * side
            }
            (false, _) => 3.0,
        }
    }

    /// The only marker without a place in the last image, where two or three others have one: they
    /// were followed, and what contradicts them is another thing or a part of it.
    fn newcomer(&self, whole: &Fits) -> Option<MarkerColor> {
        let seen = |c: MarkerColor| self.tracks[c].centroid.is_some();
        let found = || MarkerColor::ALL.into_iter().filter(|c| whole[*c].is_some());
        let followed = found().filter(|c| seen(*c)).count();
        let mut new = found().filter(|c| !seen(*c));
        new.next().filter(|_| followed >= 2 && new.next().is_none())
    }

    /// The marker whose displacement since the last image differs most from the others' (median of
    /// the distances).
    fn strangest(&self, whole: &Fits) -> Option<MarkerColor> {
        let moved = PerColor::from_fn(|c| {
            let track = &self.tracks[c];
            whole[c].and_then(|f| Some(f.centroid - track.centroid? - track.flow))
        });
        let strangeness = |c: MarkerColor| {
            let own = moved[c]?;
            let mut distances = [f64::INFINITY; 4];
            let mut k = 0;
            for (_, other) in moved.iter().filter(|(o, _)| *o != c) {
                if let Some(v) = other {
                    distances[k] = (v - own).norm();
                    k += 1;
                }
            }
            distances[..k].sort_unstable_by(f64::total_cmp);
            distances[..k].get(k / 2).copied()
        };
        MarkerColor::ALL
            .into_iter()
            .filter_map(|c| Some((c, strangeness(c)?)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(c, _)| c)
    }
}
