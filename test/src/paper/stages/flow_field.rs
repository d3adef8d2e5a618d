//! Optical flow of a whole image on a grid, by OpenCV.

use crate::paper::stages::rgb_of;
use anyhow::{Context, Result};
use marker_tracker::OwnedImage;
use nalgebra::Vector2;
use opencv::{
    core::{Mat, Point2f, Size, TermCriteria, Vec3b, Vector},
    imgproc, video,
};

/// Distance of the grid's points, px.
const GRID: usize = 32;
/// Smallest eigenvalue of the gradient matrix per pixel (gray levels of 0 to 1 squared): below it a
/// window has too little texture for a flow.
const TEXTURE: f64 = 2e-3;
/// Largest mean difference of a window to its match, gray levels of 255.
const MISMATCH: f32 = 12.0;

/// Returns place and displacement (px) of the grid's points from one image to the next, by
/// Lucas–Kanade in pyramids, where there is texture.
pub(super) fn between(earlier: &OwnedImage, later: &OwnedImage) -> Result<Vec<[Vector2<f64>; 2]>> {
    flow(earlier, later).context("the optical flow of an image")
}

fn flow(earlier: &OwnedImage, later: &OwnedImage) -> opencv::Result<Vec<[Vector2<f64>; 2]>> {
    let half = GRID / 2;
    let from: Vector<Point2f> = (half..later.height)
        .step_by(GRID)
        .flat_map(|y| (half..later.width).step_by(GRID).map(move |x| (x, y)))
        .map(|(x, y)| Point2f::new(x as f32, y as f32))
        .collect();
    let mut to = Vector::<Point2f>::new();
    let (mut status, mut error) = (Vector::<u8>::new(), Vector::<f32>::new());
    // From the later image to the earlier one, so that the arrows end at the grid's points.
    video::calc_optical_flow_pyr_lk(
        &gray(later)?,
        &gray(earlier)?,
        &from,
        &mut to,
        &mut status,
        &mut error,
        Size::new(21, 21),
        3,
        TermCriteria::new(3, 30, 0.01)?,
        0,
        TEXTURE,
    )?;
    let vector = |p: Point2f| Vector2::new(f64::from(p.x), f64::from(p.y));
    Ok(from
        .iter()
        .zip(to.iter())
        .zip(status.iter().zip(error.iter()))
        .filter(|(_, (status, error))| *status == 1 && *error < MISMATCH)
        .map(|((at, was), _)| [vector(at), vector(at) - vector(was)])
        .collect())
}

fn gray(image: &OwnedImage) -> opencv::Result<Mat> {
    let rgb = rgb_of(image);
    let rows =
        Mat::new_rows_cols_with_bytes::<Vec3b>(image.height as i32, image.width as i32, &rgb)?;
    let mut gray = Mat::default();
    imgproc::cvt_color_def(&rows, &mut gray, imgproc::COLOR_RGB2GRAY)?;
    Ok(gray)
}
