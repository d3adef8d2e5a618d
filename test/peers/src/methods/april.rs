//! AprilTag 3 (Debian's libapriltag), tag36h11, one thread.

use super::{
    About, Carrier, Estimate, Method,
    pose::{camera_matrix, point2, solve_pnp},
};
use crate::clock::Clock;
use crate::scene::{Frame, Pinhole};
use anyhow::{Result, ensure};
use nalgebra::Vector2;
use opencv::{calib3d::SolvePnPMethod, core};
use std::{ffi::c_void, time::Duration};

unsafe extern "C" {
    fn shim_apriltag_new(decimate: f32) -> *mut c_void;
    fn shim_apriltag_detect(
        handle: *mut c_void,
        gray: *mut u8,
        width: i32,
        height: i32,
        stride: i32,
        id: i32,
        corners: *mut f64,
    ) -> i32;
    fn shim_apriltag_frame(id: i32, cells: *mut u8) -> i32;
    fn shim_apriltag_free(handle: *mut c_void);
}

/// Number of the tag on the plate.
pub const TAG: i32 = 7;

/// The tag with its white border: 10×10 cells, dark 30, light 225, from the top left.
pub fn tag_frame() -> Result<Vec<u8>> {
    let mut cells = vec![0u8; 100];
    // SAFETY: the function fills exactly 100 bytes.
    let ok = unsafe { shim_apriltag_frame(TAG, cells.as_mut_ptr()) };
    ensure!(ok == 1, "libapriltag draws tag36h11 in another size than 10x10; use AprilTag 3");
    Ok(cells.into_iter().map(|c| if c > 127 { 225 } else { 30 }).collect())
}

/// The detector at one decimation.
pub struct AprilTag {
    handle: *mut c_void,
    name: &'static str,
    matrix: core::Mat,
    object: core::Vector<core::Point3d>,
}

impl AprilTag {
    /// For a tag of `footprint` m with its border (10 cells, of which the black square takes 8).
    pub fn new(camera: &Pinhole, decimate: u8, footprint: f64) -> Result<Self> {
        // SAFETY: no arguments that could be wrong; the handle is freed in drop.
        let handle = unsafe { shim_apriltag_new(f32::from(decimate)) };
        ensure!(!handle.is_null(), "AprilTag's detector could not be made: out of memory");
        let name = if decimate == 1 { "AprilTag 3, decimate 1" } else { "AprilTag 3, decimate 2" };
        Ok(Self { handle, name, matrix: camera_matrix(camera)?, object: tag_corners(footprint) })
    }
}

/// Corners of the black square, m: top left, top right, bottom right, bottom left.
pub fn tag_corners(footprint: f64) -> core::Vector<core::Point3d> {
    let half = 0.4 * footprint;
    [(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)]
        .iter()
        .map(|(x, y)| core::Point3d::new(x * half, y * half, 0.0))
        .collect()
}

/// Pose of a tag from the corners of its black square, px, which took the time `detected` to find.
pub fn tag_pose(
    matrix: &core::Mat,
    object: &core::Vector<core::Point3d>,
    corners: [Vector2<f64>; 4],
    detected: Duration,
) -> Result<Estimate> {
    let image: core::Vector<core::Point2d> = corners.iter().map(point2).collect();
    let start = Clock::start();
    let pose = solve_pnp(matrix, object, &image, SolvePnPMethod::SOLVEPNP_IPPE, true)?;
    Ok(Estimate {
        camera_from_volant: pose,
        points: corners.into_iter().enumerate().collect(),
        stages: vec![detected, start.elapsed()],
    })
}

impl Drop for AprilTag {
    fn drop(&mut self) {
        // SAFETY: made by shim_apriltag_new, freed once.
        unsafe { shim_apriltag_free(self.handle) };
    }
}

impl Method for AprilTag {
    fn about(&self) -> About {
        About { name: self.name, carrier: Carrier::Tag, stages: &["detection", "extrinsics"] }
    }

    fn estimate(&mut self, frame: &Frame) -> Result<Estimate> {
        let mut gray = frame.gray();
        let mut raw = [0.0; 8];
        let (width, height) = (frame.width as i32, frame.height as i32);
        let start = Clock::start();
        // SAFETY: `gray` holds width·height bytes, `raw` eight numbers.
        let hit = unsafe {
            shim_apriltag_detect(
                self.handle,
                gray.as_mut_ptr(),
                width,
                height,
                width,
                TAG,
                raw.as_mut_ptr(),
            )
        };
        let detected = start.elapsed();
        if hit == 0 {
            return Ok(Estimate { stages: vec![detected], ..Estimate::default() });
        }
        // AprilTag's pixel (0, 0) is the corner of the top left pixel, ours its center. Its third
        // corner is our first.
        let corner = |i: usize| Vector2::new(raw[2 * i] - 0.5, raw[2 * i + 1] - 0.5);
        let corners = [corner(3), corner(2), corner(1), corner(0)];
        tag_pose(&self.matrix, &self.object, corners, detected)
    }
}
