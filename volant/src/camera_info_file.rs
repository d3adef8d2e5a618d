//! The camera_info file that ROS's camera drivers read (`camera_info_url`): written, or updated in
//! place.

use crate::parameter_update::{list, replace};
use anyhow::{Context, Result};
use node_kit::files;
use rig_model::{CameraModel, Distortion};
use ros_parameters::{ParameterValue, edit::set_entry};
use std::path::{Path, PathBuf};

/// Writes a calibration: a new file, or the entries of an existing one, of which every other entry
/// and comment stays. Returns the name of the former file's copy.
///
/// # Errors
/// A file that is not YAML or not writable; it is unchanged then.
pub fn write(path: &Path, camera: &CameraModel, name: Option<&str>) -> Result<Option<PathBuf>> {
    let shown = || path.display().to_string();
    if !path.exists() {
        let text = text(camera, name.unwrap_or("camera")).with_context(shown)?;
        files::write(path, text.as_bytes(), false)?;
        return Ok(None);
    }
    let before = files::read_text(path).with_context(shown)?;
    let after = updated(&before, camera, name)
        .with_context(|| format!("{}; or name another file with --out", shown()))?;
    Ok(Some(replace(path, after.as_bytes())?))
}

/// Checks before the work for it that [`write()`] will be able to write a file.
///
/// # Errors
/// As [`write()`].
pub fn check(path: &Path) -> Result<()> {
    if !path.exists() {
        return Ok(files::check_outputs(&[path], false, &[])?);
    }
    let any =
        CameraModel::new(640, 480, [600.0, 600.0, 320.0, 240.0], Distortion::PlumbBob([0.0; 5]))?;
    let before = files::read_text(path).with_context(|| path.display().to_string())?;
    updated(&before, &any, None)
        .map(drop)
        .with_context(|| format!("{}; or name another file with --out", path.display()))
}

/// A new file's text.
fn text(camera: &CameraModel, name: &str) -> Result<String> {
    let form = "image_width: 0\nimage_height: 0\ncamera_name: camera\n\
                camera_matrix:\n  rows: 3\n  cols: 3\n  data: []\n\
                distortion_model: plumb_bob\n\
                distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: []\n\
                rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n\
                projection_matrix:\n  rows: 3\n  cols: 4\n  data: []\n";
    updated(form, camera, Some(name))
}

fn updated(text: &str, camera: &CameraModel, name: Option<&str>) -> Result<String> {
    use ParameterValue::{Integer, String as Text};
    let (width, height) = camera.size();
    let (f, c) = (camera.focal_lengths(), camera.principal_point());
    let (kind, coefficients): (&str, &[f64]) = match camera.distortion() {
        Distortion::PlumbBob(d) => ("plumb_bob", d),
        Distortion::RationalPolynomial(d) => ("rational_polynomial", d),
        Distortion::Equidistant(d) => ("equidistant", d),
    };
    let entries: [(&[&str], ParameterValue); 7] = [
        (&["image_width"], Integer(width.into())),
        (&["image_height"], Integer(height.into())),
        (&["camera_matrix", "data"], list(&[f.x, 0.0, c.x, 0.0, f.y, c.y, 0.0, 0.0, 1.0])),
        (&["distortion_model"], Text(kind.to_owned())),
        (&["distortion_coefficients", "cols"], Integer(coefficients.len() as i64)),
        (&["distortion_coefficients", "data"], list(coefficients)),
        (
            &["projection_matrix", "data"],
            list(&[f.x, 0.0, c.x, 0.0, 0.0, f.y, c.y, 0.0, 0.0, 0.0, 1.0, 0.0]),
        ),
    ];
    let mut text = text.to_owned();
    for (keys, value) in &entries {
        text = set_entry(&text, keys, value)?;
    }
    Ok(match name {
        Some(name) => set_entry(&text, &["camera_name"], &Text(name.to_owned()))?,
        None => text,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_new_file_is_read_back_and_an_existing_one_keeps_the_rest() {
        let folder = tempfile::TempDir::new().unwrap();
        let path = folder.path().join("camera.yaml");
        let plumb_bob = Distortion::PlumbBob([-0.25, 0.125, 1e-4, -2e-4, 0.0]);
        let camera = CameraModel::new(640, 480, [500.5, 501.25, 320.0, 240.0], plumb_bob).unwrap();
        assert_eq!(write(&path, &camera, None).unwrap(), None);
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(CameraModel::from_calibration_file(&text).unwrap(), camera);
        check(&path).unwrap();
        let own = format!("# lens 8 mm\n{text}serial: 0815 # on the label\n");
        fs::write(&path, &own).unwrap();
        let rational = Distortion::RationalPolynomial([0.5; 8]);
        let other = CameraModel::new(640, 480, [600.0, 600.0, 321.0, 239.0], rational).unwrap();
        let backup = write(&path, &other, None).unwrap().unwrap();
        assert_eq!(fs::read_to_string(backup).unwrap(), own);
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(CameraModel::from_calibration_file(&text).unwrap(), other);
        assert!(text.starts_with("# lens 8 mm\nimage_width: 640\n"), "{text}");
        assert!(text.contains("camera_name: camera\n") && text.ends_with("# on the label\n"));
        fs::write(&path, "a: [").unwrap();
        for refused in [write(&path, &other, None).map(drop), check(&path)] {
            let error = format!("{:#}", refused.unwrap_err());
            assert!(error.contains("camera.yaml"), "{error}");
        }
        check(&folder.path().join("new.yaml")).unwrap();
        assert!(check(&folder.path().join("no/new.yaml")).is_err());
    }
}
