//! The camera's calibration from the file named by `camera_info_url`, as written by
//! `camera_calibration`.

use rig_model::CameraModel;
use std::path::PathBuf;

/// Reads a calibration from `file:///path` or a plain path.
pub(crate) fn read(url: &str) -> Result<CameraModel, String> {
    let path = match url.split_once("://") {
        Some(("file", path)) => PathBuf::from(path),
        Some((scheme, _)) => {
            return Err(format!(
                "camera_info_url {url}: `{scheme}://` is not supported; use \
                 file:///path/to/camera.yaml"
            ));
        }
        None => PathBuf::from(url),
    };
    let text = node_kit::files::read_text(&path)
        .map_err(|e| format!("camera_info_url {}: {e}", path.display()))?;
    CameraModel::from_calibration_file(&text)
        .map_err(|e| format!("camera_info_url {}: {e}; calibrate the camera again", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_file() {
        assert!(read("http://host/camera.yaml").unwrap_err().contains("http"));
        assert!(read("/does/not/exist.yaml").unwrap_err().contains("/does/not/exist.yaml"));
        assert!(read("file:///dev/null").unwrap_err().contains("/dev/null"));
    }
}
