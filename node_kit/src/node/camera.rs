//! Camera models that a camera sends with each image, and that seldom change.

use crate::{convert, inbox::now};
use parking_lot::Mutex;
use rig_model::{CameraModel, CameraModelError};
use std::{
    sync::Arc,
    time::{Duration, Instant},
};
use volant_msgs::sensor_msgs::msg::CameraInfo;

/// Interval at which an unchanged model is passed on, for a node that was inactive before.
const REPEAT: Duration = Duration::from_secs(1);

/// Passes on the first of equal `CameraInfo` messages, and one per second of the others, so that
/// they wake no thread.
#[derive(Debug, Default)]
pub struct CameraChanges(Mutex<Option<(Instant, Arc<CameraInfo>)>>);

impl CameraChanges {
    /// Camera model of a message; `None` where it was passed on less than a second ago.
    ///
    /// # Errors
    /// As [`convert::camera_model`].
    pub fn model(&self, message: Arc<CameraInfo>) -> Option<Result<CameraModel, CameraModelError>> {
        let mut last = self.0.lock();
        let is_known = |(at, known): &(Instant, Arc<CameraInfo>)| {
            at.elapsed() < REPEAT && is_same_model(known, &message)
        };
        if last.as_ref().is_some_and(is_known) {
            return None;
        }
        let model = convert::camera_model(&message);
        *last = Some((now(), message));
        Some(model)
    }
}

/// Whether [`convert::camera_model`] reads the same from both messages.
fn is_same_model(a: &CameraInfo, b: &CameraInfo) -> bool {
    let region = |m: &CameraInfo| {
        let roi = &m.roi;
        [m.width, m.height, roi.x_offset, roi.y_offset, roi.width, roi.height]
    };
    region(a) == region(b)
        && (a.binning_x, a.binning_y) == (b.binning_x, b.binning_y)
        && a.distortion_model == b.distortion_model
        && (&a.d, &a.k) == (&b.d, &b.k)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_model::{Distortion, Stamp};

    #[test]
    fn the_first_of_equal_models_and_each_change_are_passed_on() {
        let message = |second: i64, focal: f64| {
            let lens = Distortion::PlumbBob([0.0; 5]);
            let camera = CameraModel::new(640, 480, [focal, focal, 320.0, 240.0], lens).unwrap();
            Arc::new(convert::camera_message("camera", Stamp::from_nanos(second), &camera))
        };
        let changes = CameraChanges::default();
        let passed = |m| changes.model(m).map(|model| model.unwrap().focal_lengths().x);
        assert_eq!(passed(message(1, 500.0)), Some(500.0));
        assert_eq!(passed(message(2, 500.0)), None);
        assert_eq!(passed(message(3, 501.0)), Some(501.0));
        if let Some((at, _)) = changes.0.lock().as_mut() {
            *at -= REPEAT;
        }
        assert_eq!(passed(message(4, 501.0)), Some(501.0));
        let mut cropped = (*message(5, 501.0)).clone();
        cropped.binning_x = 2;
        assert!(changes.model(Arc::new(cropped)).unwrap().is_err());
    }
}
