//! Marker observations: duplicates and unusable numbers are rejected, covariances bounded from
//! below.

use crate::{
    config::MarkerConfig, measurements::markers::Pixels, output::Warning, timeline::arrival::Source,
};
use nalgebra::Matrix2;
use rig_model::{MarkerObservation, MarkerObservations, MarkerState};

/// Largest coordinate (px) and variance (px²) of a usable centroid.
const LARGEST: [f64; 2] = [1e5, 1e6];
/// Smallest sigma accepted from an observation, px.
const SMALLEST_SIGMA: f64 = 0.01;

/// Returns the detected markers of an image with the covariance to assume: `noise_factor` times the
/// claimed one. `reject` gets a warning for each unusable marker.
pub fn pixels(
    observations: &MarkerObservations,
    config: &MarkerConfig,
    noise_factor: f64,
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
        pixels[color.index()] = Some((marker.centroid, bounded * noise_factor + floor));
    }
    pixels
}

/// Returns whether centroid and covariance of a marker are numbers in their range.
pub fn is_usable(marker: &MarkerObservation) -> bool {
    let c = &marker.covariance;
    marker.centroid.iter().all(|x| x.is_finite() && x.abs() < LARGEST[0])
        && c.iter().all(|x| x.is_finite() && x.abs() < LARGEST[1])
        && c.determinant() >= 0.0
        && c.trace() >= 0.0
}
