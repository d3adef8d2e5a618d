//! A camera's calibration as ROS's `camera_calibration` writes it: YAML text in, [`CameraModel`] out.

use crate::{CameraModel, CameraModelError, yaml};
use serde::Deserialize;
use thiserror::Error;

/// What is wrong with a calibration file.
#[derive(Debug, Error)]
pub enum CalibrationFileError {
    /// Not YAML, or a key is missing or of another type.
    #[error(transparent)]
    Yaml(#[from] serde_yaml_ng::Error),
    /// A camera matrix that is none.
    #[error("camera_matrix.data takes nine numbers, not {found}")]
    Matrix {
        /// How many there are.
        found: usize,
    },
    /// Values that cannot be.
    #[error(transparent)]
    Model(#[from] CameraModelError),
}

#[derive(Deserialize)]
struct Matrix {
    data: Vec<f64>,
}

#[derive(Deserialize)]
struct File {
    image_width: u32,
    image_height: u32,
    #[serde(default)]
    distortion_model: String,
    camera_matrix: Matrix,
    distortion_coefficients: Matrix,
}

impl CameraModel {
    /// From the text of a calibration file; the rectification in it is not looked at.
    ///
    /// # Errors
    /// What is wrong with it. The caller knows the file's name.
    pub fn from_calibration_file(text: &str) -> Result<Self, CalibrationFileError> {
        let file: File = serde_yaml_ng::from_value(yaml::parse(text)?)?;
        let k = &file.camera_matrix.data;
        let k: [f64; 9] =
            k.as_slice().try_into().map_err(|_| CalibrationFileError::Matrix { found: k.len() })?;
        let d = &file.distortion_coefficients.data;
        Ok(Self::from_camera_info(file.image_width, file.image_height, &file.distortion_model, d, &k)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FILE: &str = "image_width: 640
image_height: 480
camera_name: ceiling
camera_matrix: {rows: 3, cols: 3, data: [591.0, 0.0, 319.0, 0.0, 589.0, 235.0, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.23, 0.08, 0.0007, -0.0004, -0.006]}
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
projection_matrix: {rows: 3, cols: 4, data: [591, 0, 319, 0, 0, 589, 235, 0, 0, 0, 1, 0]}
";

    #[test]
    fn a_calibration_file_is_read_and_a_bad_one_is_refused() {
        let camera = CameraModel::from_calibration_file(FILE).unwrap();
        assert_eq!(camera.size(), (640, 480));
        assert_eq!(camera.focal_lengths().y, 589.0);
        let refused =
            |from, to| CameraModel::from_calibration_file(&FILE.replace(from, to)).unwrap_err().to_string();
        assert!(refused("591.0, 0.0, 319.0", "591.0, 319.0").contains("nine"));
        assert!(refused("plumb_bob", "brown").contains("brown"));
        assert!(refused("image_width", "width").contains("image_width"));
    }
}
