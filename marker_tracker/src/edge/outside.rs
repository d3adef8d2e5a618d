//! The level beside an edge.

use crate::edge::{
    interior::Interior,
    rows::{Column, eight, present},
};
use wide::f32x8;

/// Gates for a row's level outside and for the pixel at the band's rim, which the edge's blur may
/// reach, in standard deviations of a pixel inside (normal distribution: 6e-5 and 2e-9), with their
/// bounds in units of the contrast. The mean of several pixels scatters less than one.
const GATE: (f64, f64, f64) = (4.0, 0.06, 0.2);
const RIM_GATE: (f64, f64, f64) = (6.0, 0.25, 0.5);

/// Lowest contrast of an edge, in units of the one that the marker's colors were adapted in. Light
/// may drop to 0.45 of its level (a deep shade); the rest is left for noise.
pub(super) const MIN_CONTRAST: f64 = 0.35;

/// Level outside along an edge: a line through the rows that agree.
pub(super) struct Outside {
    pub level: f64,
    /// Per pixel along the edge.
    pub tilt: f64,
    /// Variance of the tilt, in units of a row's.
    pub tilt_variance: f64,
    /// Gate for a row's level.
    pub gate: f32,
    /// Gate for the single pixel at the band's rim.
    pub rim_gate: f32,
    /// Number of rows that agree.
    pub rows: f64,
}

impl Outside {
    /// Fits the level to the rows' levels `outside` at the places `along` (px). `None` where the
    /// contrast to the interior is at most [`MIN_CONTRAST`] or fewer than three rows agree.
    pub fn measure(
        along: &Column,
        outside: &Column,
        count: usize,
        interior: &Interior,
    ) -> Option<Self> {
        // The median; where all agree the mean is as good.
        let mean = outside[..count].iter().sum::<f32>() / count as f32;
        let median = if outside[..count].iter().all(|o| (o - mean).abs() < 0.05) {
            mean
        } else {
            let mut levels = *outside;
            let levels = &mut levels[..count];
            levels.sort_unstable_by(f32::total_cmp);
            levels[count / 2]
        };
        let contrast = interior.level - f64::from(median);
        if contrast.is_nan() || contrast <= MIN_CONTRAST {
            return None;
        }
        let gate_of = |(gate, low, high): (f64, f64, f64)| {
            ((gate * interior.sigma).clamp(low, high) * contrast.max(0.3)) as f32
        };
        let (gate, rim_gate) = (gate_of(GATE), gate_of(RIM_GATE));
        let zero = f32x8::ZERO;
        let (mut n, mut st, mut stt, mut so, mut sto) = (zero, zero, zero, zero, zero);
        for group in (0..count).step_by(8) {
            let off = eight(outside, group) - f32x8::splat(median);
            let member = off.abs().simd_lt(f32x8::splat(gate)) & present(group, count);
            let (off, along) = (off & member, eight(along, group) & member);
            n += member & f32x8::ONE;
            st += along;
            stt += along * along;
            so += off;
            sto += along * off;
        }
        let [n, st, stt, so, sto] = [n, st, stt, so, sto].map(|v| f64::from(v.reduce_add()));
        if n < 3.0 {
            return None;
        }
        // A weak prior of a constant level keeps the outer rows from tilting it.
        let free = stt - st * st / n;
        let stt = stt + 2.0 * n * n;
        let det = stt * n - st * st;
        Some(Self {
            level: f64::from(median) + (stt * so - st * sto) / det,
            tilt: (n * sto - st * so) / det,
            tilt_variance: free * (n / det).powi(2),
            gate,
            rim_gate,
            rows: n,
        })
    }
}
