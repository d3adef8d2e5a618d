//! Motion of the climber that its encoders do not report: whether the innovations of the last
//! images point to where it would move the markers. Those of a camera that shakes, or of an error
//! along an axis that moves, do not. Equations: `docs/src/equations.md`, "Encoders".

use crate::health::rig_evidence::ImageEvidence;
use nalgebra::Vector3;

/// Memory, images.
const MEMORY: f64 = 45.0;
/// Standard deviations by which a motion differs from none.
const CERTAIN: f64 = 5.5;
/// The same for the single axis.
const ALONG: f64 = 3.0;

/// Sums over the last images, for x, y and turn of the climber.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UnreportedMotion {
    score: Vector3<f64>,
    /// Variance of the score.
    information: Vector3<f64>,
}

impl UnreportedMotion {
    /// Adds an image while these axes stand: it says nothing of the others.
    pub fn add(&mut self, image: &ImageEvidence, standing: [bool; 3]) {
        let fade = 1.0 - 1.0 / MEMORY;
        let transposed = image.by_climber.transpose();
        let score = transposed * image.whitened;
        let information = (transposed * image.by_climber).diagonal();
        if (score + information).sum().is_finite() {
            self.score = self.score * fade + score;
            self.information = self.information * (fade * fade) + information;
        }
        for i in (0..3).filter(|i| !standing[*i]) {
            (self.score[i], self.information[i]) = (0.0, 0.0);
        }
    }

    /// Returns for each axis whether images show that the climber moves along it.
    pub fn is_shown(&self) -> [bool; 3] {
        let squares = self.score.zip_map(&self.information, |score, information| {
            if information > 0.0 { score * score / information } else { 0.0 }
        });
        let certain = squares.sum() > CERTAIN * CERTAIN;
        std::array::from_fn(|i| certain && squares[i] > ALONG * ALONG)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{SMatrix, SVector};
    use rig_simulator::random::Random;

    /// What 60 images show where x and turn stand, the climber moves by `motion` between them, and
    /// the camera vibrates by `shake` standard deviations, 84° from image to image.
    fn shown(motion: Vector3<f64>, shake: f64) -> [bool; 3] {
        let (mut unreported, mut random) = (UnreportedMotion::default(), Random::new(5));
        let by_climber = SMatrix::<f64, 8, 3>::from_fn(|i, j| if i % 3 == j { 1.0 } else { 0.1 });
        for k in 0..60 {
            let vibration = shake * (f64::from(k) * 1.466).sin();
            let whitened =
                by_climber * motion + SVector::from_fn(|_, _| random.normal() + vibration);
            let image = ImageEvidence { by_climber, whitened, ..ImageEvidence::default() };
            unreported.add(&image, [true, false, true]);
        }
        unreported.is_shown()
    }

    #[test]
    fn a_motion_along_an_axis_that_stands_is_shown_and_vibrations_are_none() {
        assert_eq!(shown(Vector3::zeros(), 0.0), [false; 3]);
        assert_eq!(shown(Vector3::new(0.8, 0.0, 0.0), 0.0), [true, false, false]);
        let other = shown(Vector3::new(0.0, 5.0, 0.0), 0.0);
        assert!(!other[1], "its encoder moves");
        assert_eq!(shown(Vector3::zeros(), 3.0), [false; 3]);
        let mut unreported = UnreportedMotion::default();
        unreported.add(
            &ImageEvidence { whitened: SVector::repeat(f64::NAN), ..ImageEvidence::default() },
            [true; 3],
        );
        assert_eq!(unreported, UnreportedMotion::default());
    }
}
