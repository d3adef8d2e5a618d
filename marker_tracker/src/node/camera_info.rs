//! A camera's calibration from the file that `camera_info_url` names, as `camera_calibration` writes it.

use rig_model::CameraModel;
use serde::Deserialize;
use std::path::PathBuf;

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

/// Reads `file:///path` or a plain path.
///
/// # Errors
/// One line that names the file and what is wrong with it.
pub(crate) fn read(url: &str) -> Result<CameraModel, String> {
    let path = match url.split_once("://") {
        Some(("file", path)) => PathBuf::from(path),
        Some((scheme, _)) => {
            return Err(format!(
                "camera_info_url {url}: `{scheme}://` is not handled; use file:///path/to/camera.yaml"
            ));
        }
        None => PathBuf::from(url),
    };
    let text = std::fs::read_to_string(&path)
        .map_err(|e| format!("camera_info_url {}: {e}; give a calibration file's path", path.display()))?;
    parse(&text).map_err(|e| format!("camera_info_url {}: {e}; calibrate the camera anew", path.display()))
}

fn parse(text: &str) -> Result<CameraModel, String> {
    let file: File = serde_yaml_ng::from_str(text).map_err(|e| e.to_string())?;
    let k: [f64; 9] = file
        .camera_matrix
        .data
        .as_slice()
        .try_into()
        .map_err(|_| "camera_matrix.data takes nine numbers".to_owned())?;
    CameraModel::from_camera_info(
        file.image_width,
        file.image_height,
        &file.distortion_model,
        &file.distortion_coefficients.data,
        &k,
    )
    .map_err(|e| e.to_string())
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
    fn a_calibration_file_is_read_and_a_bad_one_is_named() {
        let camera = parse(FILE).unwrap();
        assert_eq!(camera.size(), (640, 480));
        assert_eq!(camera.focal_lengths().y, 589.0);
        assert!(parse(&FILE.replace("591.0, 0.0, 319.0", "591.0, 319.0")).unwrap_err().contains("nine"));
        assert!(parse(&FILE.replace("plumb_bob", "brown")).unwrap_err().contains("brown"));
        assert!(read("http://host/camera.yaml").unwrap_err().contains("http"));
        assert!(read("/does/not/exist.yaml").unwrap_err().contains("/does/not/exist.yaml"));
    }
}
