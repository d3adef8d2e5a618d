//! Optical flow (paper, II-C, first criterion): after Lucas and Kanade, on the binary images at the
//! markers and on the gray image at points over the frame; and what the flow says of a region.

use super::regions::{Region, grown};
use nalgebra::Vector2;
use opencv::{
    core::{Mat, Point2f, Rect, Size, TermCriteria, TermCriteria_Type, Vector},
    prelude::*,
    video,
};

/// Levels of the image pyramid above the image itself.
const LEVELS: i32 = 3;
/// Side of the window that is matched (paper, eq. 1), px of the binary and of the halved gray
/// image.
const BINARY_WINDOW: i32 = 21;
const GRAY_WINDOW: i32 = 15;
/// Smallest eigenvalue of a window's gradient matrix, as OpenCV scales it: a binary image has no
/// noise; on the gray one it exceeds that of noise with a standard deviation of one gray value.
const BINARY_EIGENVALUE: f64 = 1e-4;
const GRAY_EIGENVALUE: f64 = 3e-4;
/// Longest displacement between two images that is followed, px.
const REACH: i32 = 64;
/// Points over the frame: columns, rows, and the least number of them that must be matched.
const COLUMNS: i32 = 10;
const ROWS: i32 = 8;
const MIN_POINTS: usize = 10;
/// Distance from which two flows are distinct, px: several times the flow's error, which is 0.1 px
/// at a marker and 0.3 px for the frame.
const DISTINCT: f64 = 1.0;
/// Largest distance between a region's flow, which is followed from its corners back to the
/// previous image, and the marker's, which is followed from there, px.
const AGREES: f64 = 2.0;
/// Largest distance of a flow from the frame's over that from a marker's where it is the frame's:
/// the platform's rotation moves its markers differently.
const NEARER: f64 = 0.5;

/// Displacements of those points that are found again in the image `to`, px.
fn lucas_kanade(
    from: &Mat,
    to: &Mat,
    points: &Vector<Point2f>,
    window: i32,
    eigenvalue: f64,
) -> opencv::Result<Vec<Vector2<f64>>> {
    if points.is_empty() {
        return Ok(Vec::new());
    }
    let mut found = Vector::<Point2f>::new();
    let (mut status, mut error) = (Vector::<u8>::new(), Vector::<f32>::new());
    let both = TermCriteria_Type::COUNT as i32 | TermCriteria_Type::EPS as i32;
    video::calc_optical_flow_pyr_lk(
        from,
        to,
        points,
        &mut found,
        &mut status,
        &mut error,
        Size::new(window, window),
        LEVELS,
        TermCriteria::new(both, 20, 0.03)?,
        0,
        eigenvalue,
    )?;
    let matched = points.iter().zip(&found).zip(&status).filter(|(_, status)| *status == 1);
    Ok(matched
        .map(|((a, b), _)| Vector2::new(f64::from(b.x - a.x), f64::from(b.y - a.y)))
        .collect())
}

/// Displacement (px) of a region of the binary image `from` to the image `to`: the median of its
/// corners'. `None` unless three corners, and more than half of them, agree with it.
pub(super) fn region_flow(
    from: &Mat,
    to: &Mat,
    region: &Region,
) -> opencv::Result<Option<Vector2<f64>>> {
    let around = grown(region.bounds, REACH, Rect::new(0, 0, from.cols(), from.rows()));
    let shift = Point2f::new(around.x as f32, around.y as f32);
    let points = region.corners.iter().map(|p| p - shift).collect();
    let (a, b) = (Mat::roi(from, around)?.try_clone()?, Mat::roi(to, around)?.try_clone()?);
    let flows = lucas_kanade(&a, &b, &points, BINARY_WINDOW, BINARY_EIGENVALUE)?;
    let Some([median, _]) = median_and_spread(&flows) else { return Ok(None) };
    let agree = flows.iter().filter(|f| (*f - median).norm() < 2.0 * DISTINCT).count();
    Ok((agree >= 3 && 2 * agree > region.corners.len()).then_some(median))
}

/// Median of the displacements, per axis, and half of the range of their middle half.
fn median_and_spread(flows: &[Vector2<f64>]) -> Option<[Vector2<f64>; 2]> {
    if flows.is_empty() {
        return None;
    }
    let axis = |i: usize| {
        let mut values: Vec<f64> = flows.iter().map(|f| f[i]).collect();
        values.sort_unstable_by(f64::total_cmp);
        let at = |part: usize| values[(values.len() - 1) * part / 4];
        [at(2), 0.5 * (at(3) - at(1))]
    };
    let [[x, dx], [y, dy]] = [axis(0), axis(1)];
    Some([Vector2::new(x, y), Vector2::new(dx, dy)])
}

/// Mean flow of the frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct FrameFlow {
    /// Displacement, px. The median stands for the mean, which a few mismatched points would move.
    pub mean: Vector2<f64>,
    /// Half of the range of the middle half of the points' displacements, px.
    pub spread: f64,
}

impl FrameFlow {
    /// Of points spread evenly over the halved gray images, without those on the markers (boxes
    /// in the whole image, px). `None` where too few are matched.
    pub fn between(from: &Mat, to: &Mat, markers: &[Rect]) -> opencv::Result<Option<Self>> {
        let (width, height) = (from.cols(), from.rows());
        let place = |i: i32, count: i32, size: i32| (2 * i + 1) * size / (2 * count);
        let is_free = |x: i32, y: i32| {
            let inside = |b: &Rect| {
                (b.x..b.x + b.width).contains(&(2 * x)) && (b.y..b.y + b.height).contains(&(2 * y))
            };
            !markers.iter().any(inside)
        };
        let points: Vector<Point2f> = (0..ROWS * COLUMNS)
            .map(|i| (place(i % COLUMNS, COLUMNS, width), place(i / COLUMNS, ROWS, height)))
            .filter(|&(x, y)| is_free(x, y))
            .map(|(x, y)| Point2f::new(x as f32, y as f32))
            .collect();
        let flows = lucas_kanade(from, to, &points, GRAY_WINDOW, GRAY_EIGENVALUE)?;
        Ok(median_and_spread(&flows)
            .filter(|_| flows.len() >= MIN_POINTS)
            .map(|[mean, spread]| Self { mean: 2.0 * mean, spread: 2.0 * spread.norm() }))
    }

    /// Whether a flow differs from the frame's.
    fn differs(&self, flow: Vector2<f64>) -> bool {
        (flow - self.mean).norm() > DISTINCT.max(self.spread)
    }
}

/// The motions that a region's flow is compared with.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Motions {
    /// Of the frame.
    frame: Option<FrameFlow>,
    /// Of the marker that differs most from the frame, px; `None` where none does.
    distinct: Option<Vector2<f64>>,
    /// Mean of the markers, px.
    pub mean: Vector2<f64>,
}

impl Motions {
    /// From the flow of the frame and those of the markers that were visible in the previous image
    /// (px).
    pub fn new(frame: Option<FrameFlow>, markers: &[Vector2<f64>]) -> Self {
        let off = |flow: &Vector2<f64>| frame.map_or(0.0, |f| (flow - f.mean).norm());
        let farthest = markers.iter().copied().max_by(|a, b| off(a).total_cmp(&off(b)));
        Self {
            frame,
            distinct: farthest.filter(|flow| frame.is_some_and(|f| f.differs(*flow))),
            mean: markers.iter().sum::<Vector2<f64>>() / markers.len().max(1) as f64,
        }
    }

    /// Whether a flow (px) differs from the frame's.
    pub fn is_distinct(&self, flow: Vector2<f64>) -> bool {
        self.frame.is_some_and(|frame| frame.differs(flow))
    }

    /// Whether a region that moves by `flow` can be the marker whose flow is `own`, px. Where that
    /// is unknown, the region must not move with the frame. What is not known excludes nothing.
    pub fn admit(&self, flow: Option<Vector2<f64>>, own: Option<Vector2<f64>>) -> bool {
        match (flow, own) {
            (None, _) => true,
            (Some(flow), Some(own)) => (flow - own).norm() <= AGREES,
            (Some(flow), None) => !self.is_with_frame(flow),
        }
    }

    /// Whether a region that moves by `flow` (px) moves with the frame, which moves itself or from
    /// which a marker differs. Otherwise all flows are the same and say nothing.
    pub fn is_with_frame(&self, flow: Vector2<f64>) -> bool {
        let Some(frame) = self.frame.filter(|f| !f.differs(flow)) else { return false };
        match self.distinct {
            Some(marker) => (flow - frame.mean).norm() < NEARER * (flow - marker).norm(),
            None => frame.differs(Vector2::zeros()),
        }
    }
}
