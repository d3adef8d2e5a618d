//! Figs. 2 and 7: the pose from all corners of a chessboard, from four of them, and from four
//! markers, over the viewing angle.

use crate::{
    bench,
    measure::{Record, mean_and_deviation},
    methods::{Carrier, Estimate, Method, Ours, Recipe, camera_matrix, point2, point3, solve_pnp},
    progress::Progress,
    report::{Csv, number},
    scene::{Pinhole, Rng},
    stage::{FOOTPRINT, Stage},
    sweep::{Condition, motion},
};
use anyhow::Result;
use nalgebra::{Isometry3, Point3, Vector2};
use opencv::{
    calib3d::{self, SolvePnPMethod},
    core::{self, Mat, Point2f, Size, TermCriteria, Vector},
    imgproc,
};
use std::path::Path;

/// Cells along an edge of the plate: 9×7 squares with a white rim.
pub const CELLS: usize = 11;
/// Inner corners: 8×6, the paper's 48.
const CORNERS: (usize, usize) = (8, 6);

/// The plate, row by row from the top left: dark 30, light 225, as the tag's.
pub fn board() -> Vec<u8> {
    (0..CELLS * CELLS)
        .map(|i| {
            let (column, row) = (i % CELLS, i / CELLS);
            let square = (1..=9).contains(&column) && (2..=8).contains(&row);
            if square && (column + row) % 2 == 1 { 30 } else { 225 }
        })
        .collect()
}

/// The inner corners on the plate, m, row by row from the top left.
fn corners() -> Vec<Point3<f64>> {
    let cell = FOOTPRINT / CELLS as f64;
    (0..CORNERS.1)
        .flat_map(|row| (0..CORNERS.0).map(move |column| (column, row)))
        .map(|(column, row)| {
            Point3::new(
                -FOOTPRINT / 2.0 + (column + 2) as f64 * cell,
                FOOTPRINT / 2.0 - (row + 3) as f64 * cell,
                0.0,
            )
        })
        .collect()
}

/// The outermost four.
const OUTER: [usize; 4] =
    [0, CORNERS.0 - 1, CORNERS.0 * CORNERS.1 - 1, CORNERS.0 * (CORNERS.1 - 1)];

/// The corners in a frame, px; `None` where the board is not found.
fn find(gray: &[u8], camera: &Pinhole) -> Result<Option<Vec<Vector2<f64>>>> {
    let image =
        Mat::new_rows_cols_with_bytes::<u8>(camera.height as i32, camera.width as i32, gray)?;
    let mut found = Vector::<Point2f>::new();
    let flags = calib3d::CALIB_CB_ADAPTIVE_THRESH | calib3d::CALIB_CB_NORMALIZE_IMAGE;
    let size = Size::new(CORNERS.0 as i32, CORNERS.1 as i32);
    if !calib3d::find_chessboard_corners(&image, size, &mut found, flags)? {
        return Ok(None);
    }
    // As wide as the squares allow: a window that reaches the next corner is pulled to it.
    let points: Vec<Point2f> = found.iter().collect();
    let gap = points.windows(2).map(|p| f64::from((p[0] - p[1]).norm())).fold(f64::MAX, f64::min);
    let half = ((0.4 * gap) as i32).clamp(2, 5);
    let criteria = TermCriteria::new(core::TermCriteria_COUNT + core::TermCriteria_EPS, 40, 1e-3)?;
    imgproc::corner_sub_pix(
        &image,
        &mut found,
        Size::new(half, half),
        Size::new(-1, -1),
        criteria,
    )?;
    Ok(Some(found.iter().map(|p| Vector2::new(f64::from(p.x), f64::from(p.y))).collect()))
}

/// Homography, then least squares of the reprojection (OpenCV's extrinsics), from some of the
/// corners.
fn extrinsics(
    matrix: &Mat,
    plate: &[Point3<f64>],
    pixels: &[Vector2<f64>],
    which: &[usize],
) -> Result<Option<Isometry3<f64>>> {
    let object: Vector<core::Point3d> = which.iter().map(|i| point3(&plate[*i])).collect();
    let image: Vector<core::Point2d> = which.iter().map(|i| point2(&pixels[*i])).collect();
    solve_pnp(matrix, &object, &image, SolvePnPMethod::SOLVEPNP_ITERATIVE, false)
}

const NAMES: [&str; 4] =
    ["all 48 corners", "four corners", "four markers, the paper's recipe", "four markers, default"];

/// `fig-2.csv` (corners) and `fig-7.csv` (corners and markers).
pub fn run(folder: &Path, per_condition: usize, seed: u64, progress: &Progress) -> Result<()> {
    let camera = Pinhole::BENCH;
    let mut stage = Stage::new(camera, seed)?;
    let layout = bench::layout(&stage)?;
    let matrix = camera_matrix(&camera)?;
    let plate = corners();
    let mut recipe = Recipe::new(&camera, &layout)?;
    let mut ours = Ours::new(&camera, layout);
    let mut rng = Rng::new(seed ^ 0xb0a2d);
    let header = "angle_deg,method,images,found,mean_mm,std_mm,mean_deg,std_deg";
    let (mut fig_2, mut fig_7) = (Csv::new(header), Csv::new(header));
    let (mut turned, mut seen, mut shot) = (0usize, 0usize, 0usize);
    println!(
        "mean error in mm and deg over the viewing angle; found in % of {per_condition} images"
    );
    println!("{:<10} {}", "angle deg", NAMES.map(|n| format!("{n:>34}")).join(""));
    for step in 0..=12 {
        progress.report(f64::from(step) / 13.0);
        let tilt_deg = 5.0 * f64::from(step);
        let condition = Condition { sweep: "angle_deg", value: tilt_deg, range: 1.0, tilt_deg };
        let mut records = vec![Record::default(); NAMES.len()];
        for _ in 0..2 {
            recipe.forget();
            ours.forget();
            for pose in motion(&camera, &condition, per_condition.div_ceil(2), &mut rng) {
                shot += 1;
                let board = stage.shoot(Carrier::Board, &pose, shot);
                let mut estimates = vec![Estimate::default(), Estimate::default()];
                if let Some(found) = find(&board.gray(), &camera)? {
                    // A chessboard is symmetric under half a turn: the truth resolves its
                    // orientation.
                    let reversed: Vec<_> = found.iter().rev().copied().collect();
                    let first = camera.project(&(pose * plate[0]));
                    let upside_down = (reversed[0] - first).norm() < (found[0] - first).norm();
                    let pixels = if upside_down { reversed } else { found };
                    seen += 1;
                    turned += usize::from(upside_down);
                    let all: Vec<usize> = (0..plate.len()).collect();
                    for (estimate, which) in estimates.iter_mut().zip([&all[..], &OUTER[..]]) {
                        estimate.camera_from_volant = extrinsics(&matrix, &plate, &pixels, which)?;
                    }
                }
                let markers = stage.shoot(Carrier::Markers, &pose, shot);
                estimates.push(recipe.estimate(&markers)?);
                estimates.push(ours.estimate(&markers)?);
                for (record, estimate) in records.iter_mut().zip(&estimates) {
                    record.add(estimate, &pose, &[]);
                }
            }
        }
        let mut line = format!("{tilt_deg:<10}");
        for (index, (name, record)) in NAMES.iter().zip(&records).enumerate() {
            let found = record.millimetres.len();
            let mut cells = vec![
                number(tilt_deg, 0),
                (*name).into(),
                record.images.to_string(),
                found.to_string(),
            ];
            cells.extend(record.error_cells());
            if index < 2 {
                fig_2.row(cells.clone());
            }
            fig_7.row(cells);
            let (mm, deg) =
                (mean_and_deviation(&record.millimetres).0, mean_and_deviation(&record.degrees).0);
            let share = 100.0 * found as f64 / record.images as f64;
            let shown = format!("{} mm {} deg {share:.0} %", number(mm, 2), number(deg, 3));
            line += &format!("{shown:>34}");
        }
        println!("{line}");
    }
    println!("the board was upside down in {turned} of {seen} images");
    progress.report(1.0);
    fig_2.write(&folder.join("fig-2.csv"))?;
    fig_7.write(&folder.join("fig-7.csv"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_corners_are_where_dark_and_light_meet() {
        let board = board();
        let cell = FOOTPRINT / CELLS as f64;
        let at = |x: f64, y: f64| {
            let (column, row) = ((x + FOOTPRINT / 2.0) / cell, (FOOTPRINT / 2.0 - y) / cell);
            board[row as usize * CELLS + column as usize]
        };
        assert_eq!(corners().len(), 48);
        for p in corners() {
            let d = 0.3 * cell;
            let around = [(-d, d), (d, d), (d, -d), (-d, -d)].map(|(x, y)| at(p.x + x, p.y + y));
            assert!(
                around[0] == around[2] && around[1] == around[3] && around[0] != around[1],
                "{p} {around:?}"
            );
        }
        let middle = corners().iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / 48.0;
        assert!(middle.norm() < 1e-12);
    }

    #[test]
    fn the_pose_of_a_rendered_board_is_recovered() {
        let camera = Pinhole::BENCH;
        let mut stage = Stage::new(camera, 1).unwrap();
        let pose = crate::trajectory::pose(&camera, camera.center(), 1.0, 0.4, 0.7, 0.3);
        let frame = stage.shoot(Carrier::Board, &pose, 1);
        let found = find(&frame.gray(), &camera).unwrap().unwrap();
        let all: Vec<usize> = (0..48).collect();
        let matrix = camera_matrix(&camera).unwrap();
        let upright = (found[0] - camera.project(&(pose * corners()[0]))).norm() < 3.0;
        let pixels: Vec<_> = if upright { found } else { found.into_iter().rev().collect() };
        for (which, limit) in [(&all[..], 1.5), (&OUTER[..], 5.0)] {
            let detected = extrinsics(&matrix, &corners(), &pixels, which).unwrap().unwrap();
            let off = (detected.translation.vector - pose.translation.vector).norm() * 1e3;
            assert!(off < limit, "{off} mm from {} corners", which.len());
        }
    }
}
