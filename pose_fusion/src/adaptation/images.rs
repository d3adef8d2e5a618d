//! What the images identify.

use super::{
    camera_shake::CameraShake,
    innovation_scale::{InnovationScale, PIXEL_NOISE},
    layout_misfit::LayoutMisfit,
    stamp_jitter::KEPT,
    unreported_motion::UnreportedMotion,
};
use crate::measurements::{
    markers::{AGREEING, Residual},
    rope::RopeIdentification,
};
use rig_model::Stamp;
use std::collections::VecDeque;

/// What the images identify.
#[derive(Clone, Debug, Default)]
pub struct ImageAdaptation {
    /// Stamps of the newest images.
    pub stamps: VecDeque<Stamp>,
    /// Factor on the claimed pixel variance.
    pub pixel_noise: InnovationScale,
    /// Factor on the sigmas of the model that the images are predicted with.
    pub model_error: InnovationScale,
    /// Shake of the camera.
    pub shake: CameraShake,
    /// Rope, where one is configured.
    pub rope: RopeIdentification,
    /// Error of the marker layout.
    pub layout: LayoutMisfit,
    /// Newest image with which the model error was small.
    pub calm: Option<Stamp>,
    /// Motion of the climber that its encoders do not report.
    pub climber_motion: UnreportedMotion,
    /// Misfit of the newest image with four markers, in units of its covariance.
    whitened: Residual,
}

impl ImageAdaptation {
    /// Remembers the stamp of an image.
    pub fn remember(&mut self, stamp: Stamp) {
        if self.stamps.len() == KEPT {
            self.stamps.pop_front();
        }
        self.stamps.push_back(stamp);
    }

    /// Identifies the pixel noise from what no pose explains of an image, in units of its
    /// covariance. Where markers were rejected, only what changes from image to image counts: what
    /// stays is a false marker.
    pub fn add_misfit(&mut self, whitened: &Residual, rejected: bool) {
        let stays = if rejected { whitened.dot(&self.whitened) } else { 0.0 };
        self.pixel_noise.add(whitened.norm_squared() - stays, &PIXEL_NOISE);
        self.whitened = *whitened;
    }

    /// Returns whether the markers of the image before agreed with each other.
    pub fn agreed_before(&self) -> bool {
        self.whitened.norm_squared() < AGREEING
    }
}
