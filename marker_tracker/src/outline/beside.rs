//! Edges that a thing beside the marker (a border of the paper on one side, tape, the platform's
//! rim) may have moved. A border all around moves all four alike and the centroid not at all.

use crate::edge::{EdgeFit, Levels, SHADE};

type Edges = [Option<EdgeFit>; 4];

/// Difference of the shades of a square's edges that noise and JPEG leave, px.
const NOISE: f64 = 0.06;
/// Standard deviation of an edge's place in units of what its shade has beyond the other edges':
/// in even light, and where each pixel is divided by its light, which a thing of another color
/// falsifies. Tuned on rendered borders and tapes on one and two sides.
const EVEN: f64 = 1.5;
const BY_PIXEL: f64 = 0.7;

/// Shade that all four edges have in common, px: that of a border of the paper; 0 where an edge was
/// not measured.
pub(super) fn border(edges: &Edges) -> f64 {
    edges.iter().map(|e| e.map_or(0.0, |e| e.shade)).fold(f64::INFINITY, f64::min)
}

/// Widens the covariance of the edges in even light.
pub(super) fn widen(edges: &mut Edges) {
    let border = border(edges);
    for edge in edges.iter_mut().flatten() {
        let excess = (edge.shade - border - NOISE).max(0.0);
        edge.widen(EVEN * excess);
    }
}

/// Marks the edges of which the shade is not a shadow's, and widens their covariance, where each
/// pixel is divided by its light: beside them lies another surface than beside the others, or the
/// light is the same on both sides of a shade. Thin shadows are marked, too: they look alike.
///
/// `inside`: level of the marker; `half_width`: of the band, px.
pub(super) fn mark_moved(edges: &mut Edges, inside: f64, half_width: f64) {
    let mut levels = [f64::INFINITY; 4];
    let mut count = 0;
    for edge in edges.iter().flatten() {
        levels[count] = edge.outside;
        count += 1;
    }
    if count == 0 {
        return;
    }
    levels.sort_unstable_by(f64::total_cmp);
    let usual = (levels[(count - 1) / 2] + levels[count / 2]) / 2.0;
    let border = border(edges);
    for edge in edges.iter_mut().flatten() {
        let excess = edge.shade - border;
        // A shadow's edge at the band's rim.
        let shadow = (edge.light_outside - 1.0).abs() * half_width;
        let other = (edge.outside - usual).abs() > Levels::FOREIGN * (inside - usual).abs();
        if other || excess > SHADE + shadow {
            edge.moved = true;
            let place = if edge.foreign { 0.0 } else { Levels::FOREIGN_SIGMA };
            edge.widen(place.hypot(BY_PIXEL * excess));
        }
    }
}
