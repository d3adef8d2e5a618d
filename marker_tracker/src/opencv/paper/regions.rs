//! Connected regions of a binary image.

use nalgebra::Vector2;
use opencv::{
    core::{self, Mat, Point, Point2f, Rect, Scalar, Vector},
    imgproc,
    prelude::*,
};

/// Smallest region, px²: a marker of 5 px of side.
const MIN_AREA: i32 = 25;
/// Number of the largest regions that are returned.
const KEEP: usize = 8;
/// Largest number of corners of a region.
const CORNERS: i32 = 8;

/// A connected region.
#[derive(Clone, Debug)]
pub(super) struct Region {
    /// Area centroid, px.
    pub centroid: Vector2<f64>,
    /// Number of pixels.
    pub area: f64,
    /// Bounding box, px.
    pub bounds: Rect,
    /// Shi–Tomasi corners of the region, px, at which the optical flow is computed.
    pub corners: Vector<Point2f>,
}

impl Region {
    /// Whether the region touches the border of a rectangle, which may hide the rest of it.
    pub fn touches(&self, within: Rect) -> bool {
        let (a, b) = (self.bounds, within);
        a.x <= b.x
            || a.y <= b.y
            || a.x + a.width >= b.x + b.width
            || a.y + a.height >= b.y + b.height
    }
}

/// The largest regions of a binary image whose first pixel is at `origin`, largest first.
pub(super) fn regions(binary: &Mat, origin: Point) -> opencv::Result<Vec<Region>> {
    let (mut labels, mut stats, mut centroids) = (Mat::default(), Mat::default(), Mat::default());
    let count = imgproc::connected_components_with_stats_def(
        binary,
        &mut labels,
        &mut stats,
        &mut centroids,
    )?;
    let mut largest = Vec::new();
    for label in 1..count {
        let area = *stats.at_2d::<i32>(label, imgproc::CC_STAT_AREA)?;
        if area >= MIN_AREA {
            largest.push((area, label));
        }
    }
    // Of equal ones, the upper one first.
    largest.sort_unstable_by_key(|&(area, label)| (-area, label));
    let mut regions = Vec::with_capacity(largest.len().min(KEEP));
    for &(area, label) in largest.iter().take(KEEP) {
        let at = |column| stats.at_2d::<i32>(label, column).copied();
        let bounds = Rect::new(
            at(imgproc::CC_STAT_LEFT)?,
            at(imgproc::CC_STAT_TOP)?,
            at(imgproc::CC_STAT_WIDTH)?,
            at(imgproc::CC_STAT_HEIGHT)?,
        );
        let center =
            Vector2::new(*centroids.at_2d::<f64>(label, 0)?, *centroids.at_2d::<f64>(label, 1)?);
        regions.push(Region {
            centroid: center + Vector2::new(f64::from(origin.x), f64::from(origin.y)),
            area: f64::from(area),
            corners: corners(&labels, label, bounds, origin)?,
            bounds: bounds + origin,
        });
    }
    Ok(regions)
}

/// Corners of one region of a label image.
fn corners(
    labels: &Mat,
    label: i32,
    bounds: Rect,
    origin: Point,
) -> opencv::Result<Vector<Point2f>> {
    /// Rim that the corner detector needs, and side of the block that it sums over: wide enough
    /// that the steps of an oblique edge are no corners, px.
    const RIM: i32 = 4;
    const BLOCK: i32 = 7;
    let around = grown(bounds, RIM, Rect::new(0, 0, labels.cols(), labels.rows()));
    let (value, mut mask) = (Scalar::all(f64::from(label)), Mat::default());
    core::in_range(&Mat::roi(labels, around)?, &value, &value, &mut mask)?;
    let mut found = Vector::<Point2f>::new();
    imgproc::good_features_to_track(
        &mask,
        &mut found,
        CORNERS,
        0.3,
        5.0,
        &core::no_array(),
        BLOCK,
        false,
        0.04,
    )?;
    let shift = Point2f::new((around.x + origin.x) as f32, (around.y + origin.y) as f32);
    Ok(found.iter().map(|p| p + shift).collect())
}

/// A rectangle with a margin on each side, within `limits`, px.
pub(super) fn grown(rect: Rect, margin: i32, limits: Rect) -> Rect {
    Rect::new(rect.x - margin, rect.y - margin, rect.width + 2 * margin, rect.height + 2 * margin)
        & limits
}
