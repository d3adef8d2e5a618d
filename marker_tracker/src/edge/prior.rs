//! What is known of an outline before it is measured.

use crate::edge::line::EdgeFit;
use nalgebra::Vector2;

/// How precisely an outline's edges are known before a measurement, and how they are measured.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Tolerance {
    /// Half-width of the band across the edges that is integrated, px.
    pub half_width: f64,
    /// Standard deviation of an edge's distance from the predicted shape, px.
    pub edge: f64,
    /// Standard deviation of the predicted place, px; decides which of two contradicting edges is
    /// right.
    pub place: f64,
    /// Standard deviation of an edge's direction, rad.
    pub slope: f64,
    /// Recent gradient of the signal inside, 1/px, where it is known.
    pub gradient: Option<Vector2<f64>>,
    /// Maximum number of rows of an edge that are used.
    pub rows: usize,
}

/// Knowledge of an outline beside its predicted place.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ShapePrior {
    pub tolerance: Tolerance,
    /// Distance of the marker's edges outside of the nominal square, px (paper cut too large,
    /// blooming): first and third edge, second and fourth edge.
    pub edge_bias: [f64; 2],
    /// Variance of a mean of neighboring pixels of a row over that of as many independent ones.
    pub correlation: f64,
    /// Factor on an edge's variance for what its rows do not show.
    pub inflation: f64,
    /// Recent levels inside and beside each edge.
    pub levels: Option<Levels>,
    /// How the light on the outline is treated.
    pub light: Light,
}

/// How the light on an outline is treated.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Light {
    /// One light on the whole marker: the most precise.
    #[default]
    Even,
    /// Each row is normalized to the levels at its own ends, and left out where the light changes
    /// along it: for covers, and shadows that leave enough rows.
    ByRow {
        /// Brightness of the surroundings over that of the marker.
        brightness: f32,
    },
    /// The signal is divided by the light on each pixel: for shadows whose edge lies along the
    /// marker's. A gray cover looks like the surroundings then.
    ByPixel,
}

/// Signal levels inside of a whole square and beside each of its edges.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Levels {
    inside: f64,
    beside: [f64; 4],
}

impl Levels {
    /// Change of the level beside an edge, in units of the contrast, from which on something else
    /// lies there. Tuned on scenes with poles and hands before the markers.
    pub const FOREIGN: f64 = 0.15;
    /// Standard deviation, px, of such an edge's place in addition to its rows': the edge may be
    /// that thing's, or a gap too narrow to be resolved (uniform over 1 px: 0.29).
    pub const FOREIGN_SIGMA: f64 = 0.3;

    /// Levels of a whole outline; `None` where an edge was not measured.
    pub fn of(inside: f64, edges: &[Option<EdgeFit>; 4]) -> Option<Self> {
        let mut beside = [0.0; 4];
        for (level, edge) in beside.iter_mut().zip(edges) {
            *level = edge.as_ref()?.outside;
        }
        Some(Self { inside, beside })
    }

    /// Light that the level inside shows, in units of that of the levels; 1 where these are too
    /// small to measure it.
    pub fn light(&self, inside: f64) -> f64 {
        if self.inside.abs() > 0.3 { inside / self.inside } else { 1.0 }
    }

    /// Moves the levels by the share `gain` towards other ones.
    pub fn adapt(&mut self, other: &Self, gain: f64) {
        self.inside += gain * (other.inside - self.inside);
        for (level, now) in self.beside.iter_mut().zip(other.beside) {
            *level += gain * (now - *level);
        }
    }

    /// Marks the edges beside which something else lies now, and widens their covariance. Where
    /// that is so at most edges, or the level inside differs, the light has changed instead.
    pub fn mark_foreign(&self, edges: &mut [Option<EdgeFit>; 4], inside: f64) {
        // Light multiplies both levels.
        let light = self.light(inside);
        if !(0.8..1.25).contains(&light) {
            return;
        }
        // In units of the contrast; 0 where an edge was not measured.
        let change: [f64; 4] = std::array::from_fn(|i| {
            let beside = self.beside[i] * light;
            edges[i].map_or(0.0, |e| (e.outside - beside) / (self.inside * light - beside).abs())
        });
        // A change beside all edges is the light's color; a thing changes some of them.
        let mut sorted = change;
        sorted.sort_unstable_by(f64::total_cmp);
        let common = (sorted[1] + sorted[2]) / 2.0;
        let foreign =
            change.map(|c| c.abs() > Self::FOREIGN && (c - common).abs() > Self::FOREIGN / 2.0);
        if foreign.iter().filter(|f| **f).count() > 2 {
            return;
        }
        for (edge, _) in edges.iter_mut().zip(foreign).filter(|(_, f)| *f) {
            if let Some(e) = edge {
                e.foreign = true;
                e.widen(Self::FOREIGN_SIGMA);
            }
        }
    }
}
