//! SIFT with RANSAC on a textured plate.

use super::{
    About, Carrier, Estimate, Method,
    pose::{camera_matrix, solve_pnp},
};
use crate::clock::Clock;
use crate::scene::{Frame, Pinhole, Rng};
use anyhow::Result;
use opencv::{
    calib3d::{self, SolvePnPMethod},
    core::{self, Mat},
    features2d,
    prelude::*,
};

/// Cells along an edge of the texture.
pub const CELLS: usize = 64;
/// Pixels of the reference frame per cell.
const SCALE: usize = 6;

/// A texture with detail at every scale, from a seed.
pub fn texture(seed: u64) -> Vec<u8> {
    let mut rng = Rng::new(seed);
    let mut sum = vec![0.0; CELLS * CELLS];
    for (block, weight) in [(16, 0.8), (8, 1.0), (4, 1.0), (2, 0.8), (1, 0.5)] {
        let side = CELLS / block;
        let values: Vec<f64> = (0..side * side).map(|_| rng.within(-1.0, 1.0)).collect();
        for (i, s) in sum.iter_mut().enumerate() {
            *s += weight * values[(i / CELLS / block) * side + (i % CELLS) / block];
        }
    }
    sum.iter().map(|s| (125.0 + 55.0 * s).clamp(20.0, 235.0) as u8).collect()
}

/// The matcher with its reference.
pub struct Sift {
    detector: core::Ptr<features2d::SIFT>,
    reference: Mat,
    /// Places of the reference's key points on the plate, m.
    places: Vec<(f64, f64)>,
    matcher: core::Ptr<features2d::BFMatcher>,
    matrix: Mat,
}

impl Sift {
    /// For a texture of `footprint` m.
    pub fn new(camera: &Pinhole, texture: &[u8], footprint: f64) -> Result<Self> {
        let mut detector = features2d::SIFT::create_def()?;
        let side = CELLS * SCALE;
        let frame: Vec<u8> = (0..side * side)
            .map(|i| texture[(i / side / SCALE) * CELLS + (i % side) / SCALE])
            .collect();
        let image = Mat::new_rows_cols_with_bytes::<u8>(side as i32, side as i32, &frame)?;
        let (mut keys, mut reference) = (core::Vector::<core::KeyPoint>::new(), Mat::default());
        detector.detect_and_compute_def(&image, &core::no_array(), &mut keys, &mut reference)?;
        let meters = footprint / side as f64;
        let places = keys
            .iter()
            .map(|k| {
                let p = k.pt();
                (
                    (f64::from(p.x) + 0.5) * meters - footprint / 2.0,
                    footprint / 2.0 - (f64::from(p.y) + 0.5) * meters,
                )
            })
            .collect();
        Ok(Self {
            detector,
            reference,
            places,
            matcher: features2d::BFMatcher::create(core::NORM_L2, false)?,
            matrix: camera_matrix(camera)?,
        })
    }
}

impl Method for Sift {
    fn about(&self) -> About {
        About {
            name: "SIFT + RANSAC",
            carrier: Carrier::Texture,
            stages: &["features", "matching", "extrinsics"],
        }
    }

    fn estimate(&mut self, frame: &Frame) -> Result<Estimate> {
        let gray = frame.gray();
        let image =
            Mat::new_rows_cols_with_bytes::<u8>(frame.height as i32, frame.width as i32, &gray)?;
        let (mut keys, mut found) = (core::Vector::<core::KeyPoint>::new(), Mat::default());
        let start = Clock::start();
        self.detector.detect_and_compute_def(&image, &core::no_array(), &mut keys, &mut found)?;
        let features = start.elapsed();
        let start = Clock::start();
        let mut pairs = core::Vector::<core::Vector<core::DMatch>>::new();
        if keys.len() >= 2 {
            self.matcher.knn_train_match_def(&found, &self.reference, &mut pairs, 2)?;
        }
        let (mut plate, mut pixels) =
            (core::Vector::<core::Point2f>::new(), core::Vector::<core::Point2f>::new());
        for pair in pairs.iter().filter(|p| p.len() == 2) {
            let (best, second) = (pair.get(0)?, pair.get(1)?);
            if best.distance < 0.75 * second.distance {
                let (x, y) = self.places[best.train_idx as usize];
                plate.push(core::Point2f::new(x as f32, y as f32));
                pixels.push(keys.get(best.query_idx as usize)?.pt());
            }
        }
        let matching = start.elapsed();
        let start = Clock::start();
        let mut pose = None;
        if plate.len() >= 8 {
            let mut mask = Mat::default();
            calib3d::find_homography(&plate, &pixels, &mut mask, calib3d::RANSAC, 3.0)?;
            let (mut object, mut image) =
                (core::Vector::<core::Point3d>::new(), core::Vector::<core::Point2d>::new());
            for i in 0..plate.len() {
                if !mask.empty() && *mask.at::<u8>(i as i32)? != 0 {
                    let (p, q) = (plate.get(i)?, pixels.get(i)?);
                    object.push(core::Point3d::new(f64::from(p.x), f64::from(p.y), 0.0));
                    image.push(core::Point2d::new(f64::from(q.x), f64::from(q.y)));
                }
            }
            if object.len() >= 8 {
                pose = solve_pnp(
                    &self.matrix,
                    &object,
                    &image,
                    SolvePnPMethod::SOLVEPNP_ITERATIVE,
                    false,
                )?;
            }
        }
        Ok(Estimate {
            camera_from_volant: pose,
            points: Vec::new(),
            stages: vec![features, matching, start.elapsed()],
        })
    }
}
