//! Estimates the camera from views of a board, with standard deviations.

use super::board::{Board, View};
use anyhow::{Context, Result, ensure};
use clap::ValueEnum;
use opencv::{
    calib3d,
    core::{self, Mat, Point2f, Point3f, Size, TermCriteria, Vector},
    prelude::*,
};
use rig_model::{CameraModel, Distortion, median};

/// Lens model by its coefficients, with its name in camera_info.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub enum LensModel {
    /// k1, k2, p1, p2, k3.
    PlumbBob,
    /// k1, k2, p1, p2, k3, k4, k5, k6.
    RationalPolynomial,
}

/// A calibrated camera.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The camera.
    pub model: CameraModel,
    /// Standard deviations of fx, fy, cx, cy, px.
    pub intrinsic_deviations: [f64; 4],
    /// Standard deviations of the distortion's coefficients, in their order.
    pub distortion_deviations: Vec<f64>,
    /// Mean reprojection error: root of the mean squared distance, px.
    pub mean_error: f64,
    /// Name, reprojection error (RMS, px) and tilt of the board against the image plane (rad) of
    /// every used view.
    pub views: Vec<(String, f64, f64)>,
    /// Names and errors of the rejected views.
    pub rejected: Vec<(String, f64)>,
}

/// Calibrates by Zhang's method and bundle adjustment. Views with an error above `reject` times the
/// median are rejected, and the rest is solved again.
///
/// # Errors
/// Fewer than four views, views of different sizes, or views that do not determine the camera
/// (boards that are all parallel to the image plane).
pub fn calibrate(
    board: &Board,
    views: &[View],
    lens: LensModel,
    reject: f64,
) -> Result<Calibration> {
    ensure!(
        views.len() >= 4,
        "the board is visible in {} images, but at least four are required; take more, tilted in \
         different \
         directions",
        views.len()
    );
    for view in views {
        ensure!(
            view.size == views[0].size,
            "{} is {}x{}, but {} is {}x{}; calibrate one resolution at a time",
            view.name,
            view.size.0,
            view.size.1,
            views[0].name,
            views[0].size.0,
            views[0].size.1
        );
    }
    let mut used: Vec<&View> = views.iter().collect();
    let mut rejected = Vec::new();
    loop {
        let solution = solve(board, &used, lens)?;
        let errors = solution.views.iter().map(|v| v.1).collect();
        let limit = reject * median(errors).unwrap_or_default();
        let worst = solution.views.iter().enumerate().max_by(|a, b| a.1.1.total_cmp(&b.1.1));
        match worst {
            Some((index, (name, error, _))) if *error > limit && used.len() > 8 => {
                rejected.push((name.clone(), *error));
                used.remove(index);
            }
            _ => {
                ensure_determined(&solution)?;
                return Ok(Calibration { rejected, ..solution });
            }
        }
    }
}

fn ensure_determined(solution: &Calibration) -> Result<()> {
    let focal = solution.model.focal_lengths();
    let tilt = solution.views.iter().map(|v| v.2).fold(0.0, f64::max);
    let share = solution.intrinsic_deviations[0].max(solution.intrinsic_deviations[1]) / focal.x;
    ensure!(
        tilt > 10f64.to_radians() && share < 0.05,
        "the views do not determine the focal length (largest tilt {:.0} deg, standard deviation \
         {:.1} % of fx); take \
         boards that are tilted by 20 to 45 deg in different directions",
        tilt.to_degrees(),
        100.0 * share
    );
    Ok(())
}

fn solve(board: &Board, views: &[&View], lens: LensModel) -> Result<Calibration> {
    let object: Vector<Vector<Point3f>> = views.iter().map(|_| board.points()).collect();
    let image: Vector<Vector<Point2f>> = views.iter().map(|v| v.corners.clone()).collect();
    let (width, height) = views[0].size;
    let (flags, count) = match lens {
        LensModel::PlumbBob => (0, 5),
        LensModel::RationalPolynomial => (calib3d::CALIB_RATIONAL_MODEL, 8),
    };
    let mut matrix = Mat::eye(3, 3, core::CV_64F)?.to_mat()?;
    let (mut d, mut rvecs, mut tvecs) =
        (Mat::default(), Vector::<Mat>::new(), Vector::<Mat>::new());
    let (mut intrinsic, mut extrinsic, mut per_view) =
        (Mat::default(), Mat::default(), Mat::default());
    let criteria =
        TermCriteria::new(core::TermCriteria_COUNT + core::TermCriteria_EPS, 100, 1e-10)?;
    let mean_error = calib3d::calibrate_camera_extended(
        &object,
        &image,
        Size::new(width, height),
        &mut matrix,
        &mut d,
        &mut rvecs,
        &mut tvecs,
        &mut intrinsic,
        &mut extrinsic,
        &mut per_view,
        flags,
        criteria,
    )
    .context(
        "the views do not determine the camera; take more boards, tilted in different directions",
    )?;
    let at = |m: &Mat, i: i32| -> Result<f64> { Ok(*m.at::<f64>(i)?) };
    let m = |r, c| -> Result<f64> { Ok(*matrix.at_2d::<f64>(r, c)?) };
    let pinhole = [m(0, 0)?, m(1, 1)?, m(0, 2)?, m(1, 2)?];
    let mut coefficients = [0.0; 8];
    for (i, c) in coefficients.iter_mut().enumerate().take(count) {
        *c = at(&d, i as i32)?;
    }
    let [k1, k2, p1, p2, k3, ..] = coefficients;
    let distortion = match lens {
        LensModel::PlumbBob => Distortion::PlumbBob([k1, k2, p1, p2, k3]),
        LensModel::RationalPolynomial => Distortion::RationalPolynomial(coefficients),
    };
    let model = CameraModel::new(width as u32, height as u32, pinhole, distortion)
        .context("the calibration is invalid; take more boards, tilted in different directions")?;
    let mut intrinsic_deviations = [0.0; 4];
    for (i, deviation) in intrinsic_deviations.iter_mut().enumerate() {
        *deviation = at(&intrinsic, i as i32)?;
    }
    let distortion_deviations =
        (0..count).map(|i| at(&intrinsic, 4 + i as i32)).collect::<Result<_>>()?;
    let mut table = Vec::with_capacity(views.len());
    for (i, view) in views.iter().enumerate() {
        let mut rotation = Mat::default();
        calib3d::rodrigues_def(&rvecs.get(i)?, &mut rotation)?;
        let tilt = rotation.at_2d::<f64>(2, 2)?.abs().min(1.0).acos();
        table.push((view.name.clone(), at(&per_view, i as i32)?, tilt));
    }
    Ok(Calibration {
        model,
        intrinsic_deviations,
        distortion_deviations,
        mean_error,
        views: table,
        rejected: Vec::new(),
    })
}
