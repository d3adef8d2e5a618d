//! Camera models and `CameraInfo`.

use super::header;
use rig_model::{CameraModel, CameraModelError, Distortion, Stamp};
use volant_msgs::sensor_msgs::msg as sensor;

/// Camera model of a `CameraInfo` message.
///
/// # Errors
/// As [`CameraModel::from_camera_info`], and for binning or a region of interest: `k` does not
/// describe such images.
pub fn camera_model(message: &sensor::CameraInfo) -> Result<CameraModel, CameraModelError> {
    let roi = &message.roi;
    let whole = (roi.width == 0 || roi.width == message.width)
        && (roi.height == 0 || roi.height == message.height)
        && roi.x_offset == 0
        && roi.y_offset == 0;
    if message.binning_x > 1 || message.binning_y > 1 || !whole {
        return Err(CameraModelError(format!(
            "binning {}x{} or a region of interest is set; send full images, or a camera_info \
             without them",
            message.binning_x, message.binning_y
        )));
    }
    CameraModel::from_camera_info(
        message.width,
        message.height,
        &message.distortion_model,
        &message.d,
        &message.k,
    )
}

/// `CameraInfo` message of a camera model, with p and r of an unrectified camera.
pub fn camera_message(frame_id: &str, at: Stamp, camera: &CameraModel) -> sensor::CameraInfo {
    let (width, height) = camera.size();
    let (f, c) = (camera.focal_lengths(), camera.principal_point());
    let (name, d) = match camera.distortion() {
        Distortion::PlumbBob(d) => ("plumb_bob", d.to_vec()),
        Distortion::RationalPolynomial(d) => ("rational_polynomial", d.to_vec()),
        Distortion::Equidistant(d) => ("equidistant", d.to_vec()),
    };
    sensor::CameraInfo {
        header: header(frame_id, at),
        width,
        height,
        distortion_model: name.to_owned(),
        d,
        k: [f.x, 0.0, c.x, 0.0, f.y, c.y, 0.0, 0.0, 1.0],
        r: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p: [f.x, 0.0, c.x, 0.0, 0.0, f.y, c.y, 0.0, 0.0, 0.0, 1.0, 0.0],
        ..sensor::CameraInfo::default()
    }
}
