//! Marker observations: duplicates and unusable numbers are rejected, covariances bounded from
//! below.

use crate::{
    adaptation::{
        camera_shake::CameraShake,
        innovation_scale::{InnovationScale, PIXEL_NOISE},
        layout_misfit::LayoutMisfit,
        stamp_jitter::KEPT,
    },
    config::MarkerConfig,
    measurements::markers::{AGREEING, Offsets, Pixels, Residual},
    output::Warning,
    timeline::arrival::Source,
};
use nalgebra::Matrix2;
use rig_model::{MarkerObservation, MarkerObservations, MarkerState, Stamp};
use std::collections::VecDeque;

/// Largest coordinate (px) and variance (px²) of a usable centroid.
const LARGEST: [f64; 2] = [1e5, 1e6];
/// Smallest sigma accepted from an observation, px.
const SMALLEST_SIGMA: f64 = 0.01;

/// State of the marker input.
#[derive(Clone, Debug, Default)]
pub struct MarkerInput {
    /// Stamps of the newest images.
    pub stamps: VecDeque<Stamp>,
    /// Factor on the claimed pixel variance.
    pub noise: InnovationScale,
    /// Shake of the camera.
    pub shake: CameraShake,
    misfit: LayoutMisfit,
    /// Sigma of the markers' places, m, by images that contradict the layout; until used.
    pub layout_doubt: Option<f64>,
    /// Misfit of the newest image with four markers, in units of its covariance.
    whitened: Residual,
}

impl MarkerInput {
    /// Remembers the stamp of an image.
    pub fn remember(&mut self, stamp: Stamp) {
        if self.stamps.len() == KEPT {
            self.stamps.pop_front();
        }
        self.stamps.push_back(stamp);
    }

    /// Compares what no pose explains of an image with the layout.
    pub fn compare_layout(&mut self, misfit: &Offsets) {
        self.layout_doubt = self.misfit.add(misfit).or(self.layout_doubt);
    }

    /// Discards the evidence of the images on the layout.
    pub fn forget_layout(&mut self) {
        (self.misfit, self.layout_doubt) = (LayoutMisfit::default(), None);
    }

    /// Identifies the pixel noise from what no pose explains of an image, in units of its
    /// covariance. Where markers were rejected, only what changes from image to image counts: what
    /// stays is a false marker.
    pub fn add_misfit(&mut self, whitened: &Residual, rejected: bool) {
        let stays = if rejected { whitened.dot(&self.whitened) } else { 0.0 };
        self.noise.add(whitened.norm_squared() - stays, &PIXEL_NOISE);
        self.whitened = *whitened;
    }

    /// Returns whether the markers of the image before agreed with each other.
    pub fn agreed_before(&self) -> bool {
        self.whitened.norm_squared() < AGREEING
    }

    /// Returns the detected markers of an image with the covariance to assume; `reject` gets a
    /// warning for each unusable one.
    pub fn pixels(
        &self,
        observations: &MarkerObservations,
        config: &MarkerConfig,
        mut reject: impl FnMut(Warning),
    ) -> Pixels {
        let floor = Matrix2::identity() * config.pixel_floor.powi(2);
        let minimum = SMALLEST_SIGMA.powi(2);
        let mut pixels = [None; 4];
        for (color, marker) in observations.markers.iter() {
            if marker.state != MarkerState::Detected {
                continue;
            }
            let c = &marker.covariance;
            if !is_usable(marker) {
                let (stamp, what) = (observations.stamp, color.name());
                reject(Warning::NotFinite { from: Source::Image, stamp, what });
                continue;
            }
            let symmetric = (c + c.transpose()) * 0.5;
            let bounded =
                symmetric + Matrix2::identity() * (minimum - symmetric.trace() / 2.0).max(0.0);
            pixels[color.index()] = Some((marker.centroid, bounded * self.noise.factor + floor));
        }
        pixels
    }
}

/// Returns whether centroid and covariance of a marker are numbers in their range.
pub fn is_usable(marker: &MarkerObservation) -> bool {
    let c = &marker.covariance;
    marker.centroid.iter().all(|x| x.is_finite() && x.abs() < LARGEST[0])
        && c.iter().all(|x| x.is_finite() && x.abs() < LARGEST[1])
        && c.determinant() >= 0.0
        && c.trace() >= 0.0
}
