//! Explanations for the diagnostics.

use crate::node::{incomplete::IncompleteImages, stages::Stages};
use node_kit::Health;
use rig_model::CameraModel;

/// Mean values (0–255) below and above which an image shows nothing: 5 % from either end.
const NEARLY_BLACK: f64 = 12.0;
const NEARLY_WHITE: f64 = 243.0;

/// Level and message of the node's status; `uses_camera`: whether the method needs a camera model;
/// `why`: the reason why the markers were not found in the last image.
pub(super) fn assess(
    stages: &Stages,
    camera: Option<&CameraModel>,
    uses_camera: bool,
    incomplete: &IncompleteImages,
    why: Option<String>,
) -> (Health, String) {
    let error = |message: &str| (Health::Error, message.to_owned());
    if stages.convert.count == 0 {
        (Health::Error, incomplete.why_none())
    } else if stages.accepted() == 0 {
        error("every image of the last second was rejected; see the log for the reason")
    } else if stages.repeated == stages.accepted() {
        // A saturated image is the same again without a fault of the camera.
        match why_blank(stages) {
            Some(message) => (Health::Warn, message),
            None => error(
                "every image of the last second is byte for byte the previous one: the camera or \
                 its driver hangs",
            ),
        }
    } else if stages.rejected > 0 {
        let count = stages.rejected;
        let message =
            format!("{count} images of the last second were rejected; see the log for the reason");
        (Health::Warn, message)
    } else if camera.is_none() && uses_camera {
        let why = if incomplete.is_info_rejected {
            "camera_info is rejected (see the log for the reason)"
        } else {
            "no camera_info yet"
        };
        (Health::Warn, format!("{why}: geometry is only checked coarsely"))
    } else if stages.detected[0] == stages.accepted() {
        (Health::Warn, why_none(stages, camera.filter(|_| uses_camera), why))
    } else {
        (Health::Ok, "tracking".to_owned())
    }
}

/// Explains from the images why no marker was detected for a second.
fn why_none(stages: &Stages, camera: Option<&CameraModel>, why: Option<String>) -> String {
    let (width, height) = stages.size;
    let is_other = |&(w, h): &(u32, u32)| (w as usize, h as usize) != (width, height);
    if let Some((w, h)) = camera.map(CameraModel::size).filter(is_other) {
        return format!(
            "no marker in view: the images are {width}x{height}, camera_info is for {w}x{h}"
        );
    }
    let found_none = "no marker in view".to_owned();
    why_blank(stages).or(why.map(|why| format!("{found_none}: {why}"))).unwrap_or(found_none)
}

/// Names images without a marker that are black or white.
fn why_blank(stages: &Stages) -> Option<String> {
    let mean = stages.mean_brightness();
    let (tone, remedy) = match stages.detected[0] {
        0 => return None,
        _ if mean < NEARLY_BLACK => ("black", "check the light, the lens cap and the exposure"),
        _ if mean > NEARLY_WHITE => ("white", "reduce the exposure"),
        _ => return None,
    };
    Some(format!(
        "no marker in view: the images are nearly {tone} (mean {mean:.0} of 255); {remedy}"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::fixtures::drawn;
    use rig_model::Stamp;

    #[test]
    fn a_repeated_image_is_a_camera_that_hangs_unless_it_is_black_or_white() {
        for (value, wanted) in [(0, "nearly black"), (90, "hangs"), (255, "nearly white")] {
            let image = drawn(16, 16, value, &[]);
            let mut stages = Stages::default();
            (stages.repeated, stages.detected[0], stages.convert.count) = (30, 30, 30);
            for _ in 0..30 {
                stages.add_brightness(&image.view(Stamp::default()));
            }
            let counts = IncompleteImages::default();
            let (_, message) = assess(&stages, None, true, &counts, None);
            assert!(message.contains(wanted), "{value}: {message}");
        }
    }

    #[test]
    fn a_camera_model_is_named_only_where_the_method_needs_one() {
        let mut stages = Stages::default();
        (stages.size, stages.detected[0], stages.convert.count) = ((320, 240), 30, 30);
        let mut counts = IncompleteImages::default();
        let lens = rig_model::Distortion::PlumbBob([0.0; 5]);
        let large = CameraModel::new(640, 480, [600.0, 600.0, 319.5, 239.5], lens).unwrap();
        for (camera, is_info_rejected, uses_camera, wanted) in [
            (None, false, true, "no camera_info yet"),
            (None, true, true, "camera_info is rejected"),
            (Some(&large), false, true, "640x480"),
            (None, true, false, "nearly black"),
            (Some(&large), false, false, "nearly black"),
        ] {
            counts.is_info_rejected = is_info_rejected;
            let (_, message) = assess(&stages, camera, uses_camera, &counts, None);
            assert!(message.contains(wanted), "{message}");
        }
    }
}
