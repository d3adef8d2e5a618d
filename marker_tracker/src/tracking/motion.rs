//! The platform's pose and its motion from image to image.

use nalgebra::{Isometry3, Vector6};
use rig_model::{Stamp, planar_pose::moved};

/// Displacement of the platform over one image interval, along the camera's axes: of its origin, m,
/// and rotation vector, rad.
pub(super) type Motion = Vector6<f64>;

/// The motion from one pose (`camera_from_volant`) to the next.
fn motion_between(from: &Isometry3<f64>, to: &Isometry3<f64>) -> Motion {
    let translation = to.translation.vector - from.translation.vector;
    let rotation = (to.rotation * from.rotation.inverse()).scaled_axis();
    Motion::from_iterator(translation.iter().chain(rotation.iter()).copied())
}

/// Pose of the platform in the last image and its last motion.
#[derive(Clone, Debug, Default)]
pub(super) struct PlatformMotion {
    /// `camera_from_volant`; `None` before acquisition and after loss.
    pub pose: Option<Isometry3<f64>>,
    /// Over the last interval, where three markers determined the pose at both of its ends.
    pub last: Option<Motion>,
    /// Whether three markers determined the pose in the last image.
    is_determined: bool,
}

impl PlatformMotion {
    /// The pose at constant velocity; `ratio`: this image interval over the previous one.
    pub fn predicted(&self, ratio: f64, use_motion: bool) -> Option<Isometry3<f64>> {
        let pose = self.pose?;
        let motion = self.last.filter(|_| use_motion);
        Some(motion.map_or(pose, |motion| moved(&pose, &(motion * ratio))))
    }

    /// Replaces the last motion by the one from `before` to the current pose, which three markers
    /// determine where `is_determined`.
    pub fn update(&mut self, before: Option<Isometry3<f64>>, is_determined: bool) {
        let before = before.filter(|_| self.is_determined && is_determined);
        self.last = before.zip(self.pose).map(|(from, to)| motion_between(&from, &to));
        self.is_determined = is_determined;
    }
}

/// Time between images.
#[derive(Clone, Debug, Default)]
pub(super) struct ImageInterval {
    last: Option<Stamp>,
    /// Before the last image, s; 0 before the second image and where time was set back.
    pub seconds: f64,
}

impl ImageInterval {
    /// Bounds of the ratio of two consecutive intervals. A camera that drops up to three images in
    /// a row stays within them; beyond, constant velocity is no better than standing still.
    const RATIO: (f64, f64) = (0.2, 4.0);

    /// The interval up to an image of this stamp over the previous one.
    pub fn ratio(&self, stamp: Stamp) -> f64 {
        match self.last.map(|last| stamp.seconds_since(last)) {
            Some(dt) if self.seconds > 0.0 => {
                (dt / self.seconds).clamp(Self::RATIO.0, Self::RATIO.1)
            }
            _ => 1.0,
        }
    }

    /// Advances to the stamp of a new image; returns its [`ratio`](Self::ratio).
    pub fn advance(&mut self, stamp: Stamp) -> f64 {
        let ratio = self.ratio(stamp);
        self.seconds = self.last.map_or(0.0, |last| stamp.seconds_since(last).max(0.0));
        self.last = Some(stamp);
        ratio
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stamp_that_is_set_back_starts_a_new_interval() {
        let mut interval = ImageInterval::default();
        for (seconds, ratio, before) in
            [(10, 1.0, 0.0), (11, 1.0, 1.0), (5, 0.2, 0.0), (6, 1.0, 1.0)]
        {
            assert_eq!(interval.advance(Stamp::from_nanos(seconds * 1_000_000_000)), ratio);
            assert_eq!(interval.seconds, before);
        }
    }

    #[test]
    fn a_motion_needs_three_markers_at_both_of_its_ends() {
        let mut motion = PlatformMotion::default();
        let images = [true, true, false, true, true];
        for (k, (is_determined, is_known)) in
            images.into_iter().zip([false, true, false, false, true]).enumerate()
        {
            let before = motion.pose.replace(Isometry3::translation(k as f64, 0.0, 1.0));
            motion.update(before, is_determined);
            assert_eq!(motion.last.is_some(), is_known, "image {k}");
        }
    }
}
