//! Camera calibration files of ROS's `camera_calibration`: YAML → [`CameraModel`].

use crate::CameraModel;
use ros_parameters::yaml;
use serde::Deserialize;
use thiserror::Error;

/// Invalid calibration file: the key or the value, and what is wrong with it.
#[derive(Debug, Error)]
#[error("{0}")]
pub struct CalibrationFileError(String);

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
    /// Parses the text of a calibration file; its rectification and projection are ignored.
    ///
    /// # Errors
    /// [`CalibrationFileError`], without the name of the file.
    pub fn from_calibration_file(text: &str) -> Result<Self, CalibrationFileError> {
        let file = yaml::parse(text).and_then(serde_yaml_ng::from_value::<File>);
        let file = file.map_err(|e| CalibrationFileError(e.to_string()))?;
        let k = file.camera_matrix.data.as_slice();
        let k: &[f64; 9] = k.try_into().map_err(|_| {
            let what = format!("camera_matrix.data has {} numbers; it must have nine", k.len());
            CalibrationFileError(what)
        })?;
        let d = &file.distortion_coefficients.data;
        let (width, height) = (file.image_width, file.image_height);
        Self::from_camera_info(width, height, &file.distortion_model, d, k)
            .map_err(|e| CalibrationFileError(e.to_string()))
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
    fn a_valid_calibration_file_is_read_and_an_invalid_one_is_rejected() {
        let camera = CameraModel::from_calibration_file(FILE).unwrap();
        assert_eq!(camera.size(), (640, 480));
        assert_eq!(camera.focal_lengths().y, 589.0);
        let error = |from, to| {
            CameraModel::from_calibration_file(&FILE.replace(from, to)).unwrap_err().to_string()
        };
        assert!(error("591.0, 0.0, 319.0", "591.0, 319.0").contains("nine"));
        assert!(error("plumb_bob", "brown").contains("brown"));
        assert!(error("image_width", "width").contains("image_width"));
    }
}
