//! ArUco as OpenCV has it, the 36h11 dictionary, corners refined to sub-pixels.

use super::{
    About, Carrier, Estimate, Method,
    april::{TAG, tag_corners, tag_pose},
    pose::camera_matrix,
};
use crate::clock::Clock;
use crate::scene::{Frame, Pinhole};
use anyhow::Result;
use nalgebra::Vector2;
use opencv::{
    aruco,
    core::{self, Mat},
    prelude::*,
};

pub struct Aruco {
    dictionary: core::Ptr<aruco::Dictionary>,
    parameters: core::Ptr<aruco::DetectorParameters>,
    matrix: Mat,
    object: core::Vector<core::Point3d>,
}

impl Aruco {
    /// For a tag of `footprint` m with its border.
    pub fn new(camera: &Pinhole, footprint: f64) -> Result<Self> {
        let mut parameters = aruco::DetectorParameters::create()?;
        parameters
            .set_corner_refinement_method(aruco::CornerRefineMethod::CORNER_REFINE_SUBPIX as i32);
        Ok(Self {
            dictionary: aruco::get_predefined_dictionary(
                aruco::PREDEFINED_DICTIONARY_NAME::DICT_APRILTAG_36h11,
            )?,
            parameters,
            matrix: camera_matrix(camera)?,
            object: tag_corners(footprint),
        })
    }
}

impl Method for Aruco {
    fn about(&self) -> About {
        About {
            name: "ArUco 36h11, sub-pixel corners",
            carrier: Carrier::Tag,
            stages: &["detection", "extrinsics"],
        }
    }

    fn estimate(&mut self, frame: &Frame) -> Result<Estimate> {
        let gray = frame.gray();
        let image =
            Mat::new_rows_cols_with_bytes::<u8>(frame.height as i32, frame.width as i32, &gray)?;
        let mut corners = core::Vector::<core::Vector<core::Point2f>>::new();
        let (mut ids, mut rejected) =
            (core::Vector::<i32>::new(), core::Vector::<core::Vector<core::Point2f>>::new());
        let start = Clock::start();
        aruco::detect_markers(
            &image,
            &self.dictionary,
            &mut corners,
            &mut ids,
            &self.parameters,
            &mut rejected,
        )?;
        let detected = start.elapsed();
        let Some(index) = ids.iter().position(|id| id == TAG) else {
            return Ok(Estimate { stages: vec![detected], ..Estimate::default() });
        };
        let corners: Vec<Vector2<f64>> = corners
            .get(index)?
            .iter()
            .map(|p| Vector2::new(f64::from(p.x), f64::from(p.y)))
            .collect();
        // OpenCV's dictionary has the same codes turned by half a turn.
        let corners = [corners[2], corners[3], corners[0], corners[1]];
        tag_pose(&self.matrix, &self.object, corners, detected)
    }
}
