//! Misfit of the marker layout: what no pose explains of four markers, and stays, is an error of
//! their places in the rig file. It raises the variance of the markers' offsets
//! ([`crate::ekf::calibration`]); by itself it moves nothing.

use crate::measurements::markers::Offsets;

/// Memory, and fewest images before the mean counts: one second, and half a second of most cameras.
const MEMORY: f64 = 30.0;
const FEWEST: f64 = 15.0;
/// Images after which a layout that they did not contradict counts as right, three seconds: what
/// contradicts it later is a false marker.
const LAYOUT_CONFIRMED: f64 = 90.0;
/// Mean misfit that is an error of the layout, each axis, m; correct files have 0.15 mm at most.
const MISFIT: f64 = 0.25e-3;
/// Largest misfit of a layout measured by hand, m; a larger one is that of a false marker.
const LARGEST: f64 = 0.005;
/// An error of the layout stays from image to image: the square of the mean exceeds what the
/// images' scatter gives it by this factor (χ² of two degrees of freedom: 1e-4).
const LASTING: f64 = 9.0;
/// Two of eight offsets are not explained by a pose.
const SEEN: f64 = 2.0;

/// Mean of what no pose explains.
#[derive(Clone, Debug, Default)]
pub struct LayoutMisfit {
    mean: Offsets,
    /// Mean square, m².
    square: f64,
    /// Images in the mean.
    count: f64,
    /// Sigma of the markers' places, each axis, m, by images that contradict them; until used.
    pub doubt: Option<f64>,
}

/// Returns the sigma of the markers' places, each axis, m; `None` for a false marker.
pub fn sigma(misfit: &Offsets) -> Option<f64> {
    (misfit.norm() < LARGEST).then(|| (misfit.norm_squared() / SEEN).sqrt())
}

impl LayoutMisfit {
    /// Adds an image of four markers. Returns the standard deviation of the markers' places, each
    /// axis, m, where the images contradict the layout.
    pub fn add(&mut self, misfit: &Offsets) -> Option<f64> {
        sigma(misfit)?;
        self.count += 1.0;
        let weight = (1.0 / self.count).max(1.0 / MEMORY);
        self.mean += (misfit - self.mean) * weight;
        self.square += (misfit.norm_squared() - self.square) * weight;
        let mean = self.mean.norm_squared();
        let lasts = mean > LASTING * (self.square - mean) * weight;
        let due = (FEWEST..LAYOUT_CONFIRMED).contains(&self.count);
        let found = sigma(&self.mean).filter(|sigma| due && lasts && *sigma > MISFIT);
        if found.is_some() {
            *self = Self { doubt: found, ..Self::default() };
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
        let off = Offsets::repeat(5e-4);
        let found = (0..30).find_map(|k| misfit.add(&(noise(k) + off)));
        assert!(found.is_some_and(|sigma| (2.5e-4..1.5e-3).contains(&sigma)), "{found:?}");
        assert!((0..300).all(|k| misfit.add(&noise(k)).is_none()));
        // Beside a confirmed layout it is a false marker.
        let moved = Offsets::repeat(1e-3);
        assert!((0..200).all(|k| misfit.add(&(noise(k) + moved)).is_none()));
        // Noise as large as a layout's error, from the first image on.
        let mut noisy = LayoutMisfit::default();
        assert!((0..80).all(|k| noisy.add(&(noise(k) * 6.0)).is_none()));
        let far = Offsets::repeat(0.05);
        assert!((0..300).all(|_| misfit.add(&far).is_none()));
        assert!((0..300).all(|_| misfit.add(&Offsets::repeat(f64::NAN)).is_none()));
    }
}
