//! Excess of the images' innovations over their covariance. Of the 8 numbers of four markers, 2 are
//! pixel noise alone, and a pose explains 6: they show the error of the prediction. Where a part is
//! larger than its covariance, its factor grows, and returns slowly.

/// How fast a factor follows the excess.
#[derive(Debug)]
pub struct Tuning {
    /// Degrees of freedom of this part of an innovation.
    freedom: f64,
    /// Images over which the mean square is taken.
    memory: f64,
    /// Mean square per degree of freedom above which the factor grows …
    large: f64,
    /// … and below which it returns.
    small: f64,
    /// Growth per image; `None`: by the mean square, which is 1 afterwards.
    growth: Option<f64>,
    /// Decay per image; its cube below [`QUIET`].
    decay: f64,
    limit: f64,
}

/// Factor on the sigmas of the noise that grows with rate and specific force: tenfold within half a
/// second, back within five, at most 5 % of both.
pub const MODEL_ERROR: Tuning = Tuning {
    freedom: 6.0,
    memory: 15.0,
    large: 1.8,
    small: 1.25,
    growth: Some(1.15),
    decay: 0.985,
    limit: 50.0,
};

/// Factor on the pixel variance that the images claim: a hundredfold within a second, back within
/// six. Up to a hundred times the claimed sigma.
pub const PIXEL_NOISE: Tuning = Tuning {
    freedom: 2.0,
    memory: 15.0,
    large: 1.8,
    small: 1.05,
    growth: None,
    decay: 0.99,
    limit: 1e4,
};

/// Mean square per degree of freedom of a factor that is far too large.
const QUIET: f64 = 0.25;
/// Where images that contradict the prediction are followed, the factor is raised by this.
pub const CONTRADICTION_GROWTH: f64 = 3.0;

/// Factor that follows the excess.
#[derive(Clone, Debug)]
pub struct InnovationScale {
    /// Mean square per degree of freedom.
    pub ratio: f64,
    /// The factor, at least 1.
    pub factor: f64,
}

impl Default for InnovationScale {
    fn default() -> Self {
        Self { ratio: 1.0, factor: 1.0 }
    }
}

impl InnovationScale {
    /// Adds this part of an image's NIS. Returns whether the factor grows.
    pub fn add(&mut self, nis: f64, tuning: &Tuning) -> bool {
        if !nis.is_finite() {
            return false;
        }
        let ratio = (nis / tuning.freedom).clamp(0.0, 6.0);
        self.ratio += (ratio - self.ratio) / tuning.memory;
        let grows = self.ratio > tuning.large;
        if grows {
            let growth = tuning.growth.unwrap_or(self.ratio);
            self.factor = (self.factor * growth).min(tuning.limit);
            if tuning.growth.is_none() {
                self.ratio = 1.0;
            }
        } else if self.ratio < tuning.small {
            let decay = if self.ratio < QUIET { tuning.decay.powi(3) } else { tuning.decay };
            self.factor = (self.factor * decay).max(1.0);
        }
        grows
    }

    /// Multiplies the factor; never makes it smaller.
    pub fn raise(&mut self, by: f64, tuning: &Tuning) {
        self.factor = self.factor.max(self.factor * by).min(tuning.limit);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_model_error_grows_with_an_excess_and_returns() {
        let mut scale = InnovationScale::default();
        let mut grown = |n: usize, nis: f64| {
            let count = (0..n).filter(|_| scale.add(nis, &MODEL_ERROR)).count();
            (count, scale.factor)
        };
        assert_eq!(grown(200, 6.0), (0, 1.0));
        let (count, factor) = grown(200, 18.0);
        assert!(count > 150 && factor == MODEL_ERROR.limit, "{count} {factor}");
        let (count, factor) = grown(1000, 6.0);
        assert!(count < 100 && factor == 1.0, "{count} {factor}");
    }

    #[test]
    fn pixel_noise_a_hundredfold_is_found_within_a_second_and_forgotten_within_six() {
        let mut scale = InnovationScale::default();
        // Images at 30 Hz, of which the covariance contains the factor.
        let mut until = |variance: f64, done: fn(f64) -> bool| {
            (0..1000)
                .take_while(|_| {
                    scale.add(2.0 * variance / scale.factor, &PIXEL_NOISE);
                    !done(scale.factor)
                })
                .count()
        };
        let (found, forgotten) = (until(100.0, |f| f > 50.0), until(1.0, |f| f < 2.0));
        assert!(found < 30 && forgotten < 180, "{found} {forgotten}");
        scale.raise(f64::NAN, &PIXEL_NOISE);
        scale.raise(0.1, &PIXEL_NOISE);
        assert!((1.0..2.0).contains(&scale.factor));
        scale.raise(1e9, &PIXEL_NOISE);
        assert_eq!(scale.factor, PIXEL_NOISE.limit);
    }
}
