//! Explanations for the diagnostics.

use crate::node::{incomplete::IncompleteImages, stages::Stages};
use node_kit::Health;
use rig_model::CameraModel;

/// Mean values (0–255) below and above which an image shows nothing: 5 % from either end.
const NEARLY_BLACK: f64 = 12.0;
const NEARLY_WHITE: f64 = 243.0;

/// Level and message of the node's status.
pub(super) fn assess(
    stages: &Stages,
    camera: Option<&CameraModel>,
    incomplete: &IncompleteImages,
) -> (Health, String) {
    if stages.convert.count == 0 {
        (Health::Error, incomplete.why_none())
    } else if stages.accepted() == 0 {
        let message = "every image of the last second was rejected; see the log for the reason";
        (Health::Error, message.to_owned())
    } else if stages.repeated == stages.accepted() {
        // A saturated image is the same again without a fault of the camera.
        why_blank(stages).map_or_else(
            || {
                let message = "every image of the last second is byte for byte the previous one: \
                               the camera or its driver hangs";
                (Health::Error, message.to_owned())
            },
            |message| (Health::Warn, message),
        )
    } else if stages.rejected > 0 {
        let count = stages.rejected;
        let message =
            format!("{count} images of the last second were rejected; see the log for the reason");
        (Health::Warn, message)
    } else if camera.is_none() {
        (Health::Warn, "no camera_info yet: geometry is only checked coarsely".to_owned())
    } else if stages.detected[0] == stages.accepted() {
        (Health::Warn, why_none(stages, camera))
    } else {
        (Health::Ok, "tracking".to_owned())
    }
}

/// Explains from the images why no marker was detected for a second.
fn why_none(stages: &Stages, camera: Option<&CameraModel>) -> String {
    let (width, height) = stages.size;
    let other_size = camera.map(CameraModel::size).filter(|size| {
        (usize::try_from(size.0), usize::try_from(size.1)) != (Ok(width), Ok(height))
    });
    if let Some((w, h)) = other_size {
        return format!(
            "no marker in view: the images are {width}x{height}, camera_info is for {w}x{h}"
        );
    }
    why_blank(stages).unwrap_or_else(|| "no marker in view".to_owned())
}

/// Names images without a marker that are black or white.
fn why_blank(stages: &Stages) -> Option<String> {
    let mean = stages.mean_brightness();
    if stages.detected[0] == 0 {
        None
    } else if mean < NEARLY_BLACK {
        let why = "check the light, the lens cap and the exposure";
        Some(format!(
            "no marker in view: the images are nearly black (mean {mean:.0} of 255); {why}"
        ))
    } else if mean > NEARLY_WHITE {
        Some(format!(
            "no marker in view: the images are nearly white (mean {mean:.0} of 255); reduce the \
             exposure"
        ))
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::{ImageView, PixelFormat};
    use rig_model::Stamp;

    #[test]
    fn a_repeated_image_is_a_camera_that_hangs_unless_it_is_black_or_white() {
        for (value, wanted) in [(0, "nearly black"), (90, "hangs"), (255, "nearly white")] {
            let data = [value; 3 * 16 * 16];
            let mut stages = Stages::default();
            (stages.repeated, stages.detected[0], stages.convert.count) = (30, 30, 30);
            for _ in 0..30 {
                stages.add_brightness(&ImageView {
                    stamp: Stamp::default(),
                    width: 16,
                    height: 16,
                    step: 3 * 16,
                    format: PixelFormat::Rgb8,
                    data: &data,
                });
            }
            let (_, message) = assess(&stages, None, &IncompleteImages::default());
            assert!(message.contains(wanted), "{value}: {message}");
        }
    }
}
