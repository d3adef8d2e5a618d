//! The camera model for the size of the images.

use crate::image::ImageView;
use nalgebra::Isometry3;
use rig_model::{CameraModel, Distortion};

/// From where and how the platform is seen.
#[derive(Clone, Copy, Debug)]
pub(super) struct View<'a> {
    pub camera: &'a CameraModel,
    /// Whether the camera model comes from a calibration.
    pub is_known: bool,
    /// `camera_from_volant`.
    pub pose: Isometry3<f64>,
}

/// The camera model and the size of the images.
#[derive(Debug, Default)]
pub(super) struct ImageCamera {
    /// The given model, or an assumed one until one is given.
    model: Option<CameraModel>,
    /// Whether the model comes from a calibration.
    pub is_given: bool,
    /// Of the last image, px; `None` between a new calibration and the next image.
    size: Option<(u32, u32)>,
}

impl ImageCamera {
    /// Sets the model from the camera's calibration; returns whether it is another one.
    pub fn set(&mut self, camera: CameraModel) -> bool {
        let is_new = !self.is_given || self.model.as_ref() != Some(&camera);
        if is_new {
            *self = Self { model: Some(camera), is_given: true, size: None };
        }
        is_new
    }

    /// The model for an image: the given one, or an assumed one until one is given.
    ///
    /// `None` where the given one is for another image size: whether the images are scaled or
    /// cropped is unknown, and the filter estimates the pose with the given one.
    pub fn for_image(&mut self, image: &ImageView<'_>) -> Option<CameraModel> {
        let size = Some(size_of(image));
        if !self.is_given && self.size != size {
            self.model = assumed_camera(image.width, image.height);
        }
        self.size = size;
        self.latest().cloned()
    }

    /// The model of the last image; `None` between a new calibration and the next image.
    pub fn latest(&self) -> Option<&CameraModel> {
        self.model.as_ref().filter(|model| Some(model.size()) == self.size)
    }

    /// Size (width, height; px) of the given model where the image has another one.
    pub fn mismatched_size(&self, image: &ImageView<'_>) -> Option<(u32, u32)> {
        let size = self.model.as_ref().filter(|_| self.is_given)?.size();
        (size != size_of(image)).then_some(size)
    }
}

fn size_of(image: &ImageView<'_>) -> (u32, u32) {
    (image.width as u32, image.height as u32)
}

/// A camera without distortion and with a horizontal field of view of 58° (focal length 0.9 of the
/// longer side), which is that of common webcams; stands in until a calibration arrives.
fn assumed_camera(width: usize, height: usize) -> Option<CameraModel> {
    let f = 0.9 * width.max(height) as f64;
    CameraModel::new(
        width as u32,
        height as u32,
        [f, f, (width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0],
        Distortion::PlumbBob([0.0; 5]),
    )
    .ok()
}
