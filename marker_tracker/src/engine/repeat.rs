//! A camera that stands still sends the same image again: byte for byte, noise and all. That is no measurement.

use super::Engine;
use crate::image::ImageView;
use nalgebra::{Matrix2, Vector2};
use rig_model::{MarkerObservation, MarkerObservations, MarkerState, PerColor};

/// Places that are compared, and bytes of each. A sensor's noise makes the first of them differ.
const PLACES: usize = 16;
const BYTES: usize = 48;

/// Bytes of an image from places spread over it.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    size: (usize, usize, usize),
    bytes: [[u8; BYTES]; PLACES],
}

impl Default for Sample {
    fn default() -> Self {
        Self { size: (0, 0, 0), bytes: [[0; BYTES]; PLACES] }
    }
}

impl Sample {
    fn places<'a>(image: &ImageView<'a>) -> impl Iterator<Item = &'a [u8]> {
        let ImageView { width, height, step, data, .. } = *image;
        let row = width * image.format.bytes_per_pixel();
        (0..PLACES).map(move |i| {
            // Down the image and to and fro across it.
            let y = (2 * i + 1) * height / (2 * PLACES);
            let x = (i * 7 % PLACES) * row.saturating_sub(BYTES) / PLACES;
            let start = y * step + x;
            data.get(start..start + BYTES.min(row)).unwrap_or(&[])
        })
    }

    /// Whether the image has these bytes; keeps its own where it does not.
    fn is_repeated(&mut self, image: &ImageView<'_>) -> bool {
        let size = (image.width, image.height, image.format.bytes_per_pixel());
        let same = self.size == size
            && Self::places(image).zip(&self.bytes).all(|(new, old)| old[..new.len()] == *new);
        if !same {
            self.size = size;
            for (new, old) in Self::places(image).zip(&mut self.bytes) {
                old[..new.len()].copy_from_slice(new);
            }
        }
        same
    }
}

impl Engine {
    /// Whether the image is the one before it: in places all over it, and in every pixel of the followed outlines.
    ///
    /// A drawn scene without noise may stand still but for the markers, so both are asked.
    pub(super) fn is_repeated(&mut self, image: &ImageView<'_>) -> bool {
        self.sample.is_repeated(image)
            && self.markers.0.iter().all(|m| {
                let Some(appearance) = &m.appearance else { return true };
                m.outline.is_unchanged(&crate::signal::Sampler::new(image, &appearance.discriminant))
            })
    }

    /// What is said to a repeated image: nothing was measured, and where the markers are now is told by none of them.
    pub(super) fn repeat(&mut self, image: &ImageView<'_>) -> MarkerObservations {
        self.repeated = self.repeated.saturating_add(1);
        let max = self.config.max_predicted;
        let markers = PerColor::from_fn(|color| {
            let m = &mut self.markers[color];
            m.fit = None;
            m.reason = "the image is byte for byte the one before";
            let Some(since) = m.occluded else { return MarkerObservation::lost(MarkerObservation::NEVER) };
            let since = since.saturating_add(1).min(MarkerObservation::NEVER - 1);
            m.occluded = Some(since);
            match m.centroid {
                Some(place) if since <= max => {
                    // It may go on as it did.
                    m.sigma += 1.0 + m.flow.norm();
                    MarkerObservation {
                        state: MarkerState::Predicted,
                        occluded_frames: since,
                        centroid: place,
                        covariance: Matrix2::identity() * m.sigma * m.sigma,
                        area: 0.0,
                    }
                }
                _ => {
                    m.centroid = None;
                    m.flow = Vector2::zeros();
                    MarkerObservation::lost(since)
                }
            }
        });
        MarkerObservations { stamp: image.stamp, markers }
    }
}
