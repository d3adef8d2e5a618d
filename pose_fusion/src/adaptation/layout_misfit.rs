//! Misfit of the marker layout, identified from the images: what no pose explains of four markers,
//! and stays, is an error of their places in the rig file.
//!
//! It raises the variance of the markers' offsets, which the filter estimates
//! ([`crate::ekf::calibration`]); by itself it moves nothing.

use crate::measurements::markers::Offsets;

/// Memory and fewest images before the mean counts: one second, and half a second of a usual camera.
const MEMORY: f64 = 30.0;
const FEWEST: f64 = 15.0;
/// Fewest images while none has confirmed the layout: the first pose is built on it.
const FIRST: f64 = 3.0;
/// Misfit of the fewest images that is an error of the layout, each axis, m: a quarter of a millimeter. Correct files
/// have at most 0.15 mm on seven recordings.
const MISFIT: f64 = 0.25e-3;
/// Largest distance of what a layout measured by hand leaves; a larger one is a false marker, m.
const LARGEST: f64 = 0.005;
/// Two of eight offsets are not explained by a pose.
const SEEN: f64 = 2.0;

/// Mean of what no pose explains.
#[derive(Clone, Debug, Default)]
pub struct LayoutMisfit {
    mean: Offsets,
    /// Images in the mean, and in all.
    count: f64,
    compared: f64,
}

/// Returns the standard deviation of the markers' places, each axis, m, of a misfit; `None` where
/// it is that of a false marker.
pub fn sigma(misfit: &Offsets) -> Option<f64> {
    (misfit.norm() < LARGEST).then(|| (misfit.norm_squared() / SEEN).sqrt())
}

impl LayoutMisfit {
    /// Adds an image of four markers. Returns the standard deviation of the markers' places, each
    /// axis, m, where the images contradict the layout.
    pub fn add(&mut self, misfit: &Offsets) -> Option<f64> {
        sigma(misfit)?;
        self.count += 1.0;
        self.compared += 1.0;
        self.mean += (misfit - self.mean) * (1.0 / self.count).max(1.0 / MEMORY);
        let fewest = if self.compared <= FEWEST { FIRST } else { FEWEST };
        let limit = MISFIT * (FEWEST / self.count).sqrt().max(1.0);
        let found = sigma(&self.mean).filter(|sigma| self.count >= fewest && *sigma > limit);
        if found.is_some() {
            *self = Self { compared: self.compared, ..Self::default() };
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stays_is_found_and_noise_and_false_markers_are_not() {
        let noise = |k: usize| Offsets::from_fn(|i, _| 3e-4 * ((7 * k + 3 * i) as f64).sin());
        let mut misfit = LayoutMisfit::default();
        assert!((0..300).all(|k| misfit.add(&noise(k)).is_none()));
        let off = Offsets::repeat(5e-4);
        let found = (0..30).find_map(|k| misfit.add(&(noise(k) + off)));
        assert!(found.is_some_and(|sigma| (2.5e-4..1.5e-3).contains(&sigma)), "{found:?}");
        let far = Offsets::repeat(0.05);
        assert!((0..300).all(|_| misfit.add(&far).is_none()));
        assert!((0..300).all(|_| misfit.add(&Offsets::repeat(f64::NAN)).is_none()));
    }
}
