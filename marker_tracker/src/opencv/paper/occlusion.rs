//! Occlusion (paper, II-D): a hidden marker moves with the visible ones, and the observations.

use crate::geometry::isotropic;
use nalgebra::Vector2;
use rig_model::{MarkerObservation, PerColor};

/// Standard deviation of a whole marker's centroid, per axis, px. On the recorded bags the RMS is
/// 0.10 to 0.36 px from marker to marker; `tests/bags` bounds the normalized squared error.
const DETECTED_SIGMA: f64 = 0.25;
/// Share of the area that noise may take away.
const MISSING_NOISE: f64 = 0.05;
/// Standard deviation that each predicted image adds, per axis, px: eq. 3 neglects the platform's
/// rotation. Measured on the recorded bags as the above.
const PREDICTED_SIGMA: f64 = 3.0;
/// Number of hidden markers from which no visual pose is estimated.
const TOO_MANY: usize = 2;

/// Where a marker was last seen or predicted.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Place {
    /// Centroid, px; `None` while lost.
    pub centroid: Option<Vector2<f64>>,
    /// Displacement since the previous image, px.
    pub flow: Vector2<f64>,
    /// Images since the last detection; `None` before the first.
    pub occluded: Option<u16>,
}

/// A marker's region in the current image.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sighting {
    /// Area centroid, px.
    pub centroid: Vector2<f64>,
    /// px².
    pub area: f64,
    /// Share of the expected area that is missing.
    pub missing: f64,
    /// Displacement since the previous image, px; `None` where it was not visible there.
    pub flow: Option<Vector2<f64>>,
}

/// Moves the places to the current image and returns the observations.
///
/// A visible marker is where it was measured; a hidden one moves by the mean flow of the visible
/// ones (eq. 3) for at most `max_predicted` images. With two or more hidden ones no visual pose is
/// estimated: they are published as lost, while their places move on for the search.
pub(super) fn observe(
    places: &mut PerColor<Place>,
    sightings: &PerColor<Option<Sighting>>,
    max_predicted: u16,
) -> PerColor<MarkerObservation> {
    let flows = || sightings.0.iter().flatten().filter_map(|s| s.flow);
    let mean = flows().sum::<Vector2<f64>>() / flows().count().max(1) as f64;
    let hidden = sightings.0.iter().filter(|s| s.is_none()).count();
    let mut observations = PerColor([MarkerObservation::lost(MarkerObservation::NEVER); 4]);
    for ((place, sighting), observation) in
        places.0.iter_mut().zip(&sightings.0).zip(&mut observations.0)
    {
        *observation = match sighting {
            Some(sighting) => {
                *place = Place {
                    centroid: Some(sighting.centroid),
                    flow: sighting.flow.unwrap_or_default(),
                    occluded: Some(0),
                };
                // How far the centroid moves where the missing area is at one side, px.
                let displacement =
                    (sighting.missing - MISSING_NOISE).max(0.0) * sighting.area.sqrt();
                let covariance = isotropic(DETECTED_SIGMA.hypot(displacement));
                MarkerObservation::detected(sighting.centroid, covariance, sighting.area)
            }
            None => {
                let Some(before) = place.occluded else { continue };
                let since = before.saturating_add(1).min(MarkerObservation::NEVER - 1);
                let centroid = place.centroid.filter(|_| since <= max_predicted).map(|c| c + mean);
                *place = Place { centroid, flow: mean, occluded: Some(since) };
                match centroid.filter(|_| hidden < TOO_MANY) {
                    Some(centroid) => {
                        let covariance = isotropic(PREDICTED_SIGMA * f64::from(since));
                        MarkerObservation::predicted(since, centroid, covariance)
                    }
                    None => MarkerObservation::lost(since),
                }
            }
        };
    }
    observations
}
