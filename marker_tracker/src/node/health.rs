//! Explanations for the diagnostics.

use crate::node::stages::Stages;
use rig_model::CameraModel;

/// Mean values (0–255) below and above which an image shows nothing: 5 % from either end.
const NEARLY_BLACK: f64 = 12.0;
const NEARLY_WHITE: f64 = 243.0;

/// Explains from the images why no marker was detected for a second.
pub(super) fn why_none(stages: &Stages, camera: Option<&CameraModel>) -> String {
    let mean = stages.mean_brightness();
    let (width, height) = stages.size;
    let other_size = camera.map(CameraModel::size).filter(|size| {
        (usize::try_from(size.0), usize::try_from(size.1)) != (Ok(width), Ok(height))
    });
    if let Some((w, h)) = other_size {
        format!("no marker in view: the images are {width}x{height}, camera_info is for {w}x{h}")
    } else if mean < NEARLY_BLACK {
        let why = "check the light, the lens cap and the exposure";
        format!("no marker in view: the images are nearly black (mean {mean:.0} of 255); {why}")
    } else if mean > NEARLY_WHITE {
        format!(
            "no marker in view: the images are nearly white (mean {mean:.0} of 255); reduce the \
             exposure"
        )
    } else {
        "no marker in view".to_owned()
    }
}
