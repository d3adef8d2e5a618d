//! Which rows of the image cross an edge, and how far they are read.

use crate::{
    edge::rows::MAX_ROWS,
    quad::Quad,
    signal::{Sampler, nearest},
};
use nalgebra::Vector2;

/// Largest length of an edge near a corner that the corner's blur spoils, px.
const CORNER: f64 = 2.0;
/// Width of the band in which the level outside is measured, in units of the square's, and its
/// bounds, px. The surroundings of a square smaller than 20 px may end 4 px beside it; there the
/// band is one pixel wide.
const OUTSIDE: f64 = 0.1;
const OUTSIDE_BOUNDS: (f64, f64) = (1.0, 3.0);
/// How far beside an edge its surroundings are read at most, in units of the square's width: the
/// platform's rim may be near. Tuned; guarded by `tests/bags`.
const REACH: f64 = 0.22;
/// Largest half-width of a band, in units of the square's width: opposite bands must not meet.
const MAX_SHARE: f64 = 0.2;
/// Pixels inside of the band whose level is the row's, in changing light.
pub(super) const INNER: u32 = 3;
/// Longest band that is read, px.
pub(super) const MAX_BAND: i32 = 40;

/// A side of a predicted outline.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Side {
    /// Its middle, px.
    pub middle: Vector2<f64>,
    /// Unit vector along it.
    pub tangent: Vector2<f64>,
    /// Outward unit normal.
    pub normal: Vector2<f64>,
    /// Its length, px.
    pub length: f64,
    /// Distance of the middle from the outline's centroid along the normal, px.
    pub distance: f64,
}

impl Side {
    /// All four sides of an outline whose centroid is `center` (px).
    pub fn of(quad: &Quad, center: Vector2<f64>) -> [Self; 4] {
        std::array::from_fn(|i| {
            let (p, q) = (quad.0[i], quad.0[(i + 1) % 4]);
            let length = (q - p).norm();
            let tangent = (q - p) / length;
            let middle = (p + q) / 2.0;
            let normal = Vector2::new(tangent.y, -tangent.x);
            let distance = normal.dot(&(middle - center));
            let normal = if distance < 0.0 { -normal } else { normal };
            Self { middle, tangent, normal, length, distance: distance.abs() }
        })
    }
}

/// The rows that cross one edge.
#[derive(Clone, Copy, Debug)]
pub(super) struct RowPlan {
    pub side: Side,
    /// Pixels across the edge that are integrated.
    pub band: i32,
    /// Pixels beyond the band.
    pub beyond: i32,
    /// Bytes from one pixel to the next.
    pub hop: u32,
    /// Whether the outside comes last.
    pub outward: bool,
    /// Axis along which the edge is crossed: 0, along x on rows; 1, along y on columns.
    pub axis: usize,
    /// Cosine of the angle between that axis and the edge's normal.
    pub steep: f64,
    /// Half-width of the band across the edge, px.
    pub half_width: f64,
    /// Number of rows.
    pub possible: i32,
    /// Number of lines of the image that cross the edge, and the first of them.
    usable: i32,
    first: i32,
    /// Distance along the edge per row, px.
    pub per_row: f64,
    /// Shift of the crossing per row, px.
    shift: f64,
}

/// Where a row crosses the predicted edge.
pub(super) struct Crossing {
    /// Distance of the row from the side's middle, rows.
    pub off: f64,
    /// Coordinate along the row, px.
    pub place: f64,
}

impl RowPlan {
    /// Plans at most `rows` rows that integrate `half_width` px on either side of the edge and
    /// measure the level outside in at most `beyond` px beyond that; `None` where the side is too
    /// short or the band too long.
    pub fn new(
        sampler: &Sampler<'_>,
        side: &Side,
        half_width: f64,
        beyond: f64,
        rows: usize,
    ) -> Option<Self> {
        let Side { middle, tangent, normal, length, .. } = *side;
        if length.is_nan() || length < 4.0 {
            return None;
        }
        let k = usize::from(normal.x.abs() < normal.y.abs());
        let (steep, sign) = (normal[k].abs(), normal[k].signum());
        let width = side.distance * 2.0;
        let half_width = half_width.min(MAX_SHARE * width).max(1.0);
        let half = half_width / steep;
        let per_row = 1.0 / tangent[1 - k];
        // Walking inward shifts the place along the edge; it must not run over the neighboring
        // edge.
        let inward = -sign * half * tangent[k];
        let corner = CORNER.min(0.15 * length + 0.5);
        let (low, high) =
            (-length / 2.0 + corner + (-inward).max(0.0), length / 2.0 - corner - inward.max(0.0));
        if high <= low {
            return None;
        }
        let (a, b) = (middle[1 - k] + low / per_row, middle[1 - k] + high / per_row);
        let first = nearest(a.min(b) + 0.5);
        let usable = nearest(a.max(b) - 0.5) - first + 1;
        if usable < 3 {
            return None;
        }
        let possible = usable.min(rows.clamp(8, MAX_ROWS) as i32);
        let (least, most) = OUTSIDE_BOUNDS;
        let beyond = beyond
            .min((OUTSIDE * width).clamp(least, most))
            .min(REACH * width - half_width)
            .max(1.0);
        let beyond = if width < 20.0 { 1 } else { (beyond / steep).ceil() as i32 };
        // The same number of pixels in every row.
        let band = (2.0 * half + 0.5).ceil() as i32;
        if band > MAX_BAND {
            return None;
        }
        Some(Self {
            side: *side,
            band,
            beyond,
            hop: sampler.hop(k),
            outward: sign > 0.0,
            axis: k,
            steep,
            half_width,
            possible,
            usable,
            first,
            per_row,
            shift: tangent[k] * per_row,
        })
    }

    /// The middle line of the `i`-th of `possible` equal parts of the edge.
    #[inline(always)]
    pub fn line(&self, i: i32) -> i32 {
        self.first + (i * self.usable + self.usable / 2) / self.possible
    }

    #[inline(always)]
    pub fn crossing(&self, line: i32) -> Crossing {
        let off = f64::from(line) - self.side.middle[1 - self.axis];
        Crossing { off, place: self.side.middle[self.axis] + off * self.shift }
    }

    /// First pixel of the band on a row.
    #[inline(always)]
    pub fn band_start(&self, crossing: &Crossing) -> i32 {
        nearest(crossing.place - f64::from(self.band - 1) / 2.0)
    }

    /// Pixels of the band that lie inside of the predicted edge; the middle one of an odd number
    /// counts half.
    pub fn inner_pixels(&self) -> f32 {
        self.band as f32 / 2.0
    }

    /// Pixels before the band.
    pub fn lead(&self) -> i32 {
        if self.outward { 0 } else { self.beyond }
    }

    /// First and last pixel that are read on a row whose band begins at `from`.
    pub fn ends(&self, from: i32) -> [i32; 2] {
        let Self { band, beyond, outward, .. } = *self;
        if outward {
            [from - INNER as i32, from + band + beyond - 1]
        } else {
            [from - beyond, from + band + INNER as i32 - 1]
        }
    }

    /// Image coordinates of a place along a row.
    pub fn pixel(&self, along: i32, line: i32) -> (i32, i32) {
        if self.axis == 0 { (along, line) } else { (line, along) }
    }
}
