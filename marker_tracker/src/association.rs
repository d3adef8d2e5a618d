//! Association of patches with markers: sets of four (or, where one is hidden, three) patches that
//! can be an image of the layout, best first. Colored things on the floor do not stand so.

use crate::{
    geometry::{Geometry, PoseObservation},
    scan::Patch,
};
use nalgebra::{Isometry3, Matrix2, Vector3};
use rig_model::{MarkerColor, PerColor, planar_pose::closed_form};

/// A set of patches that can be an image of the layout.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hypothesis {
    pub camera_from_volant: Isometry3<f64>,
    pub patches: PerColor<Option<Patch>>,
    /// Lower is better: reprojection error over the squares' side, and disagreement of the areas.
    pub score: f64,
}

/// Limits of the geometric check; an assumed camera admits larger ones.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Strictness {
    /// RMS reprojection error in units of the square's side.
    pub reprojection: f64,
    /// Factor by which an area may differ.
    pub area: f64,
}

/// Maximum number of hypotheses that are returned, half of which are expected to be used.
const KEEP: usize = 8;
/// Maximum number of patches per color, and of sets of four and of three (of each three colors)
/// whose pose is estimated: they bound the cost of a search. Tuned on cluttered scenes;
/// `make bench` bounds the time.
const PER_COLOR: usize = 24;
const FOURS: usize = 32;
const THREES: usize = 32;

/// Inserts an item into a list by rank, lowest first, of which the first `most` are kept; of equal
/// ones the earlier comes first.
fn insert_ranked<T>(ranked: &mut Vec<(f64, T)>, most: usize, rank: f64, item: T) {
    let at = ranked.partition_point(|(other, _)| *other <= rank);
    if at < most {
        ranked.truncate(most - 1);
        ranked.insert(at, (rank, item));
    }
}

/// All hypotheses of four patches worth a closer look, best first, into `found` (cleared before).
/// `by_threes`: of each three in turn, where a marker is hidden.
pub(crate) fn hypotheses(
    geometry: Geometry<'_>,
    patches: &[Patch],
    strictness: Strictness,
    by_threes: bool,
    found: &mut Vec<Hypothesis>,
) {
    found.clear();
    let layout = geometry.layout;
    let mut search = Search { geometry, patches, strictness, found };
    // The most colourful and most square patches first; of wood and cardboard there may be
    // hundreds. Three alone must be whole.
    let mut of: PerColor<Vec<(f64, usize)>> = PerColor::default();
    for (i, patch) in patches.iter().enumerate() {
        let fill = patch.fill();
        let fills = if by_threes { 0.8..1.2 } else { 0.55..1.35 };
        if !fills.contains(&fill) || patch.elongation() >= 5.0 || (by_threes && patch.cut) {
            continue;
        }
        let merit = f64::from(patch.saturation()) * (-2.0 * fill.ln().abs()).exp();
        insert_ranked(&mut of[patch.color], PER_COLOR, -merit, i);
    }
    let mut fours: Vec<(f64, [usize; 4])> = Vec::new();
    for first in 0..(if by_threes { 4 } else { 1 }) {
        let [a, b, c, d] = std::array::from_fn(|i| MarkerColor::ALL[(first + i) % 4]);
        let mut threes = THREES;
        let (pa, pb, pc, pd) =
            (layout.centers[a], layout.centers[b], layout.centers[c], layout.centers[d]);
        let (u, v) = ((pb - pa).xy(), (pc - pa).xy());
        let twist = u.perp(&v);
        let side2 = layout.side * layout.side;
        if twist.abs() < side2 * 0.5 {
            continue;
        }
        // The platform is seen from in front and the image's y points down, so orientation is
        // reversed.
        let expected = -twist / side2;
        // Place of d in the affine frame of the other three.
        let w = (pd - pa).xy();
        let (s, t) = (w.perp(&v) / twist, u.perp(&w) / twist);
        let reach = u.norm().max(v.norm()) / layout.side;
        for &(_, ia) in &of[a] {
            for &(_, ib) in &of[b] {
                let (ba, bb) = (&patches[ia], &patches[ib]);
                let side = (ba.area * bb.area).sqrt().sqrt();
                let limit = 2.6 * side * reach + 10.0;
                if (ba.centroid - bb.centroid).norm() > limit || !like_areas(ba.area, bb.area) {
                    continue;
                }
                for &(_, ic) in &of[c] {
                    let bc = &patches[ic];
                    if !like_areas(ba.area, bc.area) || !like_areas(bb.area, bc.area) {
                        continue;
                    }
                    let (iu, iv) = (bb.centroid - ba.centroid, bc.centroid - ba.centroid);
                    let area = (ba.area * bb.area * bc.area).cbrt();
                    let ratio = iu.perp(&iv) / area / expected;
                    if !(0.55..2.2).contains(&ratio) {
                        continue;
                    }
                    if !by_threes {
                        let guess = ba.centroid + iu * s + iv * t;
                        for &(_, id) in &of[d] {
                            let bd = &patches[id];
                            let off = (bd.centroid - guess).norm();
                            if off >= 0.35 * reach * side + 3.0 || !like_areas(area, bd.area) {
                                continue;
                            }
                            // What stands like a parallelogram, is of one size and colourful comes
                            // first.
                            let uneven: f64 =
                                [ba, bb, bc, bd].iter().map(|b| (b.area / area).ln().abs()).sum();
                            let colorful: f64 =
                                [ba, bb, bc, bd].iter().map(|b| f64::from(b.saturation())).sum();
                            let rank = off / (reach * side) + 0.2 * uneven - 0.2 * colorful;
                            insert_ranked(&mut fours, FOURS, rank, [ia, ib, ic, id]);
                        }
                    }
                    if by_threes && threes > 0 {
                        threes -= 1;
                        search.claim([ia, ib, ic], [a, b, c]);
                    }
                }
            }
        }
    }
    for (_, indices) in fours {
        search.claim(indices, MarkerColor::ALL);
    }
    found.sort_unstable_by(|a, b| a.score.total_cmp(&b.score));
    found.truncate(KEEP * 2);
}

/// Areas of two markers in one image differ by perspective and by what covers them.
fn like_areas(a: f64, b: f64) -> bool {
    let r = a / b;
    (0.38..2.6).contains(&r)
}

/// A search for hypotheses.
struct Search<'a> {
    geometry: Geometry<'a>,
    patches: &'a [Patch],
    strictness: Strictness,
    found: &'a mut Vec<Hypothesis>,
}

impl Search<'_> {
    /// Adds the hypothesis that four patches are the markers, or those of three patches, with which
    /// both of their poses are possible.
    fn claim<const N: usize>(&mut self, indices: [usize; N], colors: [MarkerColor; N]) {
        let Geometry { layout, camera } = self.geometry;
        let is_three = N == 3;
        let (mut chosen, mut pixels) = (PerColor([None; 4]), PerColor([None; 4]));
        for (i, color) in indices.into_iter().zip(colors) {
            chosen[color] = Some(self.patches[i]);
            pixels[color] = Some((self.patches[i].centroid, Matrix2::identity()));
        }
        let Some(mut starts) = closed_form(layout, camera, &pixels) else { return };
        let observations: [PoseObservation; N] = std::array::from_fn(|k| PoseObservation {
            color: colors[k],
            pixel: self.patches[indices[k]].centroid,
            sigma: 1.0,
            outline: None,
        });
        let error = |pose: &Isometry3<f64>| {
            let off = |o: &PoseObservation| {
                let predicted = layout.projected_centroid(o.color, camera, pose);
                predicted.map_or(f64::INFINITY, |p| (p.pixel - o.pixel).norm_squared())
            };
            observations.iter().map(off).sum::<f64>()
        };
        starts.sort_unstable_by(|a, b| error(a).total_cmp(&error(b)));
        let is_in_front = |pose: &&Isometry3<f64>| {
            (pose.rotation * Vector3::z()).dot(&pose.translation.vector) < 0.0
        };
        // Three observations are explained by many poses, so they come after every four, and their
        // areas must be right.
        let (strictness, handicap, count) = if is_three {
            let area = self.strictness.area.min(1.45);
            (Strictness { area, ..self.strictness }, 1.0, 2)
        } else {
            (self.strictness, 0.0, 1)
        };
        for start in starts.iter().filter(is_in_front).take(count) {
            self.score(&observations, start, chosen, strictness, handicap);
        }
    }

    /// Refines a pose and adds its hypothesis where place and size of its patches are right.
    fn score(
        &mut self,
        observations: &[PoseObservation],
        start: &Isometry3<f64>,
        chosen: PerColor<Option<Patch>>,
        strictness: Strictness,
        handicap: f64,
    ) {
        let Geometry { layout, camera } = self.geometry;
        let refined = self.geometry.refine(observations, start, None, 15);
        let Some((pose, rms, _)) = refined else { return };
        // Beyond 78° a square is a line.
        let up = pose.rotation * Vector3::z();
        if -up.dot(&pose.translation.vector.normalize()) < 0.2 {
            return;
        }
        let mut disagreement = 0.0;
        let mut side = 0.0;
        for (color, patch) in chosen.iter() {
            let Some(patch) = patch else { continue };
            let Some(predicted) = layout.projected_centroid(color, camera, &pose) else { return };
            // The scan loses a rim of blurred pixels, and covers cost area, so less is forgiven
            // sooner than more.
            let ratio = patch.area / predicted.area;
            let side_here = predicted.area.sqrt();
            let rim = ((side_here - 2.0) / side_here).max(0.3).powi(2);
            let off = (ratio / rim.sqrt()).ln();
            if off > strictness.area.ln() || -off > 2.2 * strictness.area.ln() {
                return;
            }
            disagreement += off.abs();
            side += side_here / observations.len() as f64;
        }
        if rms > strictness.reprojection * side + 1.0 {
            return;
        }
        let score = handicap + rms / side + 0.1 * disagreement;
        if self.found.len() >= 4 * KEEP {
            self.found.sort_unstable_by(|a, b| a.score.total_cmp(&b.score));
            self.found.truncate(2 * KEEP);
        }
        self.found.push(Hypothesis { camera_from_volant: pose, patches: chosen, score });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Point3, Vector2};
    use rig_model::{CameraModel, Distortion, MarkerLayout};

    #[test]
    fn three_whole_patches_are_found_beside_many_cut_ones() {
        let corners = [(0.15, 0.15), (-0.15, 0.15), (-0.15, -0.15), (0.15, -0.15)];
        let centers = PerColor(corners.map(|(x, y)| Point3::new(x, y, 0.0)));
        let layout = MarkerLayout { side: 0.076, centers };
        let lens = Distortion::PlumbBob([0.0; 5]);
        let camera = CameraModel::new(640, 480, [600.0, 600.0, 319.5, 239.5], lens).unwrap();
        // At a distance of 1.2 m, seen from in front.
        let patch = |color: MarkerColor, shift: f64, cut: bool| {
            let center = layout.centers[color];
            let centroid = Vector2::new(319.5 + 500.0 * center.x + shift, 239.5 - 500.0 * center.y);
            let (area, spread) = (38.0 * 38.0, Matrix2::identity() * (38.0 * 38.0 / 12.0));
            let rgb = if cut { [200.0, 0.0, 0.0] } else { [200.0, 50.0, 50.0] };
            Patch { color, centroid, area, spread, rgb, cut }
        };
        let seen = [MarkerColor::Red, MarkerColor::Green, MarkerColor::Blue];
        let mut patches: Vec<Patch> = seen.into_iter().map(|c| patch(c, 0.0, false)).collect();
        for k in 1..6 {
            patches.extend(seen.into_iter().map(|c| patch(c, f64::from(k), true)));
        }
        let (geometry, mut found) = (Geometry { layout: &layout, camera: &camera }, Vec::new());
        let strictness = Strictness { reprojection: 0.08, area: 1.8 };
        hypotheses(geometry, &patches, strictness, true, &mut found);
        let whole = PerColor([Some(patches[0]), Some(patches[1]), Some(patches[2]), None]);
        assert!(found.iter().any(|h| h.patches == whole), "{found:?}");
    }
}
