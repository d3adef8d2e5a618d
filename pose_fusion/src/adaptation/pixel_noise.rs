//! Pixel noise, identified from the images: what no pose explains of four markers is pixel noise.
//! Images that fit worse than they claim count less.

/// Memory, images.
const MEMORY: f64 = 40.0;
/// Degrees of freedom: eight numbers less those of a pose.
const FREEDOM: f64 = 2.0;
/// Mean square per degree of freedom above which the noise grows, and below which it shrinks back.
const LARGE: f64 = 1.4;
const SMALL: f64 = 1.05;
/// Largest factor on the variance.
const LIMIT: f64 = 100.0;

/// Factor on the claimed pixel variance.
#[derive(Clone, Debug)]
pub struct PixelNoise {
    ratio: f64,
    factor: f64,
}

impl Default for PixelNoise {
    fn default() -> Self {
        Self { ratio: 1.0, factor: 1.0 }
    }
}

impl PixelNoise {
    /// Adds the squared residuals of four markers that no pose explains, in units of their
    /// covariance.
    pub fn add(&mut self, internal: f64) {
        let ratio = (internal / FREEDOM).clamp(0.0, 6.0);
        self.ratio += (ratio - self.ratio) / MEMORY;
        if self.ratio > LARGE {
            self.factor = (self.factor * 1.02).min(LIMIT);
        } else if self.ratio < SMALL {
            self.factor = (self.factor * 0.99).max(1.0);
        }
    }

    /// Returns the factor on the claimed variance, at least 1.
    pub fn factor(&self) -> f64 {
        self.factor
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_grows_with_poor_images_and_returns() {
        let mut noise = PixelNoise::default();
        (0..200).for_each(|_| noise.add(2.0));
        assert_eq!(noise.factor(), 1.0);
        (0..200).for_each(|_| noise.add(10.0));
        assert!(noise.factor() > 5.0);
        (0..1000).for_each(|_| noise.add(1.5));
        assert_eq!(noise.factor(), 1.0);
    }
}
