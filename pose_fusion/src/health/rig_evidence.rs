//! What images show of errors of the rig's files. The filter takes focal length, camera mounting,
//! encoder scale, the offset of the encoders' stamps and the size of the marker layout as given.
//! The sensitivity of its state to errors θ of these (`ekf/consider.rs`) gives their effect on the
//! innovation of each image: `L⁻¹ r = B θ` and white noise of variance 1. Least squares over the
//! last images give θ. It is never applied: errors that are certain and large widen the covariance
//! and are reported. Equations: `docs/src/equations.md`, "Detection of calibration
//! errors from innovations".

use crate::ekf::consider::{CLIMBER_OFFSET, FILE_ERRORS, FOCAL, FileErrors, MOUNTING, SIZE};
use nalgebra::{Cholesky, SMatrix, SVector};
use rig_model::Stamp;

/// Memory, s.
const MEMORY: f64 = 60.0;
/// Squared innovation of an image above which it counts less: shocks and false markers.
const LARGEST: f64 = 20.0;
/// Expected errors (1 sigma) and the smallest ones that are reported, in the order of
/// [`FileErrors`]. With correct files estimates that are [`CERTAIN`] are at most 0.011 s, 0.45 %
/// (size) and 5 % (encoder scale, which the motion of a climber resembles: not reported), on seven
/// recordings, three of them with real IMU samples.
const LIMITS: [(f64, f64); FILE_ERRORS] = [
    (0.01, 0.004),
    (0.005, 0.002),
    (0.005, 0.002),
    (0.005, 0.01),
    (0.01, f64::INFINITY),
    (0.1, 0.02),
    (0.01, 0.005),
];
/// Standard deviations by which a reported error differs from zero; that of the size, which steps
/// of a slow climber's encoders resemble, is up to 6.5 with correct files.
const CERTAIN: f64 = 5.0;
const CERTAIN_SIZE: f64 = 8.0;
/// Share of the excess of the squared innovations that a reported error explains: at least 0.25 of
/// late stamps, up to 0.18 where the camera shakes.
const EXPLAINED: f64 = 0.2;

/// What one image shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImageEvidence {
    /// `B`.
    pub by_error: SMatrix<f64, 8, FILE_ERRORS>,
    /// The same for a motion of the climber that the encoders do not report: x, y (m), turn (rad).
    pub by_climber: SMatrix<f64, 8, 3>,
    /// `L⁻¹ r`.
    pub whitened: SVector<f64, 8>,
}

/// Least squares of the errors over the last images.
#[derive(Clone, Debug, Default)]
pub struct RigEvidence {
    newest: Option<Stamp>,
    information: SMatrix<f64, FILE_ERRORS, FILE_ERRORS>,
    score: FileErrors,
    /// Sum of the squared innovations less what is expected of them.
    excess: f64,
    /// FileErrors that are certain and large; zero for the others.
    pub wrong: FileErrors,
}

impl RigEvidence {
    /// Adds an image.
    pub fn add(&mut self, stamp: Stamp, image: &ImageEvidence) {
        let transposed = image.by_error.transpose();
        let square = image.whitened.norm_squared();
        let weight = (LARGEST / square).min(1.0).sqrt();
        let rows = image.by_error.row_iter().filter(|row| row.iter().any(|x| *x != 0.0)).count();
        let information = transposed * image.by_error;
        let score = transposed * image.whitened * weight;
        if !(information.sum() + score.sum()).is_finite() {
            return;
        }
        let since = self.newest.map_or(0.0, |newest| stamp.seconds_since(newest).max(0.0));
        self.newest = Some(stamp);
        let fade = (-since / MEMORY).exp();
        self.information = self.information * fade + information;
        self.score = self.score * fade + score;
        self.excess = self.excess * fade + square.min(LARGEST) - rows as f64;
        self.wrong = self.certain().unwrap_or_default();
    }

    fn certain(&self) -> Option<FileErrors> {
        let expected = FileErrors::from(LIMITS.map(|(sigma, _)| sigma.powi(-2)));
        let cholesky = Cholesky::new(self.information + SMatrix::from_diagonal(&expected))?;
        let (mut errors, covariance) = (cholesky.solve(&self.score), cholesky.inverse());
        for (k, (_, least)) in LIMITS.into_iter().enumerate() {
            let certain = if k == SIZE { CERTAIN_SIZE } else { CERTAIN };
            let certain = certain.max((EXPLAINED * self.excess).max(0.0).sqrt());
            if errors[k].abs() < (certain * covariance[(k, k)].sqrt()).max(least) {
                errors[k] = 0.0;
            }
        }
        Some(errors)
    }
}

/// Returns a sentence for each error that is not zero. They name its size only: a large error moves
/// the filter so far that its sign may be wrong.
pub fn findings(wrong: &FileErrors) -> Vec<String> {
    let mounting = wrong.fixed_rows::<3>(MOUNTING).norm();
    let percent = |k: usize| 100.0 * wrong[k].abs();
    let milliseconds = 1e3 * wrong[CLIMBER_OFFSET].abs();
    let all = [
        (
            wrong[FOCAL],
            format!("the focal length of `camera_info` is about {:.1} %", percent(FOCAL)),
        ),
        (
            mounting,
            format!(
                "`camera.orientation` (or a marker beside its place) is about {:.1}°",
                mounting.to_degrees()
            ),
        ),
        (
            wrong[CLIMBER_OFFSET],
            format!(
                "the offset of the encoders' stamps from the images' (`clock.climber_offset`) is \
                 about {milliseconds:.0} ms"
            ),
        ),
        (
            wrong[SIZE],
            format!(
                "the size of the layout in `markers` (or the accelerometer's scale) is about {:.1} %",
                percent(SIZE)
            ),
        ),
    ];
    let found = all.into_iter().filter(|(error, _)| *error != 0.0);
    found.map(|(_, text)| format!("images and IMU show that {text} off")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_simulator::random::Random;

    /// The smallest error that is reported, or the expected one.
    fn size_of((expected, least): (f64, f64)) -> f64 {
        if least.is_finite() { least } else { expected }
    }

    /// Evidence of 20 s of images with these errors; every tenth has a false marker.
    fn add(evidence: &mut RigEvidence, from: f64, errors: &FileErrors, random: &mut Random) {
        let epoch = Stamp::from_nanos(1_760_001_000_000_000_000);
        for k in 0..600 {
            let by_error = SMatrix::from_fn(|_, j| 0.2 * random.normal() / size_of(LIMITS[j]));
            let mut whitened = by_error * errors + SVector::from_fn(|_, _| random.normal());
            if k % 10 == 0 {
                whitened[0] += 1e3;
            }
            let stamp = epoch.plus_seconds(from + f64::from(k) / 30.0);
            evidence.add(stamp, &ImageEvidence { by_error, whitened, ..ImageEvidence::default() });
        }
    }

    #[test]
    fn a_large_error_is_found_small_ones_are_not_and_a_mended_one_is_forgotten() {
        let mut random = Random::new(7);
        for (k, (expected, least)) in LIMITS.into_iter().enumerate() {
            for (factor, sign) in [(2.0, 1.0), (2.0, -1.0), (0.5, 1.0)] {
                let error = sign * factor * size_of((expected, least));
                let errors = FileErrors::from_fn(|i, _| if i == k { error } else { 0.0 });
                let mut evidence = RigEvidence::default();
                add(&mut evidence, 0.0, &errors, &mut random);
                let reported = factor > 1.0 && least.is_finite();
                let close = (evidence.wrong - errors).amax() < 0.2 * error.abs();
                assert_eq!(close, reported, "{k} {error}: {:?}", evidence.wrong.as_slice());
                assert_eq!(findings(&evidence.wrong).len(), usize::from(reported));
                for stretch in 1..12 {
                    add(
                        &mut evidence,
                        20.0 * f64::from(stretch),
                        &FileErrors::zeros(),
                        &mut random,
                    );
                }
                assert_eq!(evidence.wrong, FileErrors::zeros());
            }
        }
    }

    #[test]
    fn an_error_that_explains_little_of_the_misfit_is_none() {
        for (scale, found) in [(1.0, 1), (3.0, 0)] {
            let (mut evidence, mut random) = (RigEvidence::default(), Random::new(8));
            for k in 0..600 {
                let by_error = SMatrix::<f64, 8, FILE_ERRORS>::from_fn(|_, j| {
                    0.2 * random.normal() / size_of(LIMITS[j])
                });
                let whitened = by_error.column(FOCAL) * 0.008
                    + SVector::from_fn(|_, _| scale * random.normal());
                let stamp = Stamp::default().plus_seconds(f64::from(k) / 30.0);
                evidence.add(stamp, &ImageEvidence { by_error, whitened, ..Default::default() });
            }
            assert_eq!(findings(&evidence.wrong).len(), found, "{scale}: {:?}", evidence.wrong);
        }
    }

    #[test]
    fn numbers_that_are_not_finite_are_ignored() {
        let mut evidence = RigEvidence::default();
        for bad in [f64::NAN, f64::INFINITY] {
            let mut image = ImageEvidence::default();
            image.whitened[3] = bad;
            image.by_error[(3, 2)] = 1.0;
            evidence.add(Stamp::default(), &image);
            image.by_error[(3, 2)] = bad;
            evidence.add(Stamp::default(), &image);
        }
        assert_eq!((evidence.newest, evidence.wrong), (None, FileErrors::zeros()));
    }
}
