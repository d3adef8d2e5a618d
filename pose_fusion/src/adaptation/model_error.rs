//! Model error of the prediction, identified from the images: what neither the noise of the IMU nor
//! its estimated constants ([`crate::ekf::calibration`]) describe.
//!
//! An image's innovation has two parts. What no pose explains (2 of the 8 numbers of four markers)
//! is pixel noise and nothing else ([`super::pixel_noise`]); what a pose explains (6 numbers) is
//! the error of the prediction. Where the second part is larger than its covariance, the noise that
//! grows with rate and specific force is raised, and returns slowly.

/// Memory, images.
const MEMORY: f64 = 15.0;
/// Degrees of freedom of a pose.
const POSE: f64 = 6.0;
/// Mean NIS per degree of freedom above which the sigmas grow, and below which they shrink back.
const LARGE: f64 = 1.8;
const SMALL: f64 = 1.25;
/// Factors per image: tenfold within half a second, back within five.
const GROWTH: f64 = 1.15;
const DECAY: f64 = 0.985;
/// Factor where the images contradict the prediction.
const CONTRADICTED: f64 = 3.0;
/// Largest factor: 5 % of rate and specific force.
const LIMIT: f64 = 50.0;

/// Factor on the noise that grows with the motion.
#[derive(Clone, Debug)]
pub struct ModelError {
    ratio: f64,
    factor: f64,
}

impl Default for ModelError {
    fn default() -> Self {
        Self { ratio: 1.0, factor: 1.0 }
    }
}

impl ModelError {
    /// Adds an image of four markers (`internal` of whose NIS no pose explains) or three (0: a pose
    /// explains all). Returns whether the sigmas grow.
    pub fn add(&mut self, nis: f64, internal: f64) -> bool {
        let ratio = ((nis - internal) / POSE).clamp(0.0, 6.0);
        self.ratio += (ratio - self.ratio) / MEMORY;
        let grows = self.ratio > LARGE;
        if grows {
            self.factor = (self.factor * GROWTH).min(LIMIT);
        } else if self.ratio < SMALL {
            self.factor = (self.factor * DECAY).max(1.0);
        }
        grows
    }

    /// Notes that the prediction had to give way to images that contradict it.
    pub fn contradicted(&mut self) {
        self.factor = (self.factor * CONTRADICTED).min(LIMIT);
    }

    /// Returns the factor on the sigmas, at least 1.
    pub fn factor(&self) -> f64 {
        self.factor
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_answers_to_what_a_pose_explains_and_not_to_pixel_noise() {
        let mut error = ModelError::default();
        assert_eq!((0..100).filter(|_| error.add(26.0, 20.0)).count(), 0);
        assert_eq!(error.factor(), 1.0);
        assert!((0..60).filter(|_| error.add(20.0, 2.0)).count() > 30);
        assert!(error.factor() > 20.0, "{}", error.factor());
        assert!((0..500).filter(|_| error.add(8.0, 2.0)).count() < 20);
        assert_eq!(error.factor(), 1.0);
    }
}
