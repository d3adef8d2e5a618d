//! Chessboard, and detection of its corners in an image.

use anyhow::{Context, Result};
use opencv::{
    calib3d,
    core::{self, Point2f, Point3f, Size, TermCriteria, Vector},
    imgproc,
    prelude::*,
};

/// Geometry of a chessboard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    /// Inner corners along a row.
    pub columns: i32,
    /// Inner corners along a column.
    pub rows: i32,
    /// Edge of a square, m.
    pub square: f64,
}

/// Parses the inner corners of a row and of a column, `COLUMNSxROWS`.
pub fn corners(text: &str) -> Result<(i32, i32), String> {
    let number =
        |s: &str| -> Option<i32> { s.trim().parse().ok().filter(|n| (3..=100).contains(n)) };
    let parsed = text.split_once(['x', 'X']);
    let parsed = parsed.and_then(|(columns, rows)| Some((number(columns)?, number(rows)?)));
    parsed.ok_or_else(|| {
        format!("`{text}` is not COLUMNSxROWS of inner corners, such as 9x6, each from 3 to 100")
    })
}

impl Board {
    /// Corners in the board's plane, m, in OpenCV's order.
    pub fn points(&self) -> Vector<Point3f> {
        (0..self.rows)
            .flat_map(|r| (0..self.columns).map(move |c| (c, r)))
            .map(|(c, r)| {
                Point3f::new(
                    (f64::from(c) * self.square) as f32,
                    (f64::from(r) * self.square) as f32,
                    0.0,
                )
            })
            .collect()
    }
}

/// Detected board in one image.
#[derive(Clone, Debug)]
pub struct View {
    /// Name of the image.
    pub name: String,
    /// Width and height, px.
    pub size: (i32, i32),
    /// The corners, px, row by row.
    pub corners: Vector<Point2f>,
}

/// Detects the board's corners with sub-pixel accuracy; `None` if the board is not fully visible.
/// `window` is the half width of the refinement window, px (OpenCV's calibration uses 11), limited
/// to the distance of neighboring corners.
///
/// # Errors
/// An error of OpenCV; no image causes one.
pub fn find(picture: &core::Mat, name: &str, board: &Board, window: i32) -> Result<Option<View>> {
    let mut gray = core::Mat::default();
    imgproc::cvt_color_def(picture, &mut gray, imgproc::COLOR_BGR2GRAY)?;
    let mut corners = Vector::<Point2f>::new();
    let flags = calib3d::CALIB_CB_ADAPTIVE_THRESH
        | calib3d::CALIB_CB_NORMALIZE_IMAGE
        | calib3d::CALIB_CB_FAST_CHECK;
    let pattern = Size::new(board.columns, board.rows);
    if !calib3d::find_chessboard_corners(&gray, pattern, &mut corners, flags)
        .with_context(|| format!("{name}: the search for the board failed"))?
    {
        return Ok(None);
    }
    let half = window.min(smallest_gap(&corners, board.columns) as i32).max(2);
    let criteria = TermCriteria::new(core::TermCriteria_COUNT + core::TermCriteria_EPS, 60, 1e-4)?;
    imgproc::corner_sub_pix(
        &gray,
        &mut corners,
        Size::new(half, half),
        Size::new(-1, -1),
        criteria,
    )?;
    Ok(Some(View { name: name.to_owned(), size: (gray.cols(), gray.rows()), corners }))
}

/// Smallest distance between neighbors of a row or column, px.
fn smallest_gap(corners: &Vector<Point2f>, columns: i32) -> f64 {
    let points: Vec<Point2f> = corners.iter().collect();
    let columns = columns as usize;
    let gap = |a: usize, b: usize| f64::from((points[a] - points[b]).norm());
    (0..points.len())
        .flat_map(|i| {
            let right = ((i + 1) % columns != 0 && i + 1 < points.len()).then(|| gap(i, i + 1));
            let below = (i + columns < points.len()).then(|| gap(i, i + columns));
            right.into_iter().chain(below)
        })
        .fold(f64::MAX, f64::min)
}
