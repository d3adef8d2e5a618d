//! Shake of the camera: an error that all markers of an image share, and that is another one in the
//! next image. It is found in changes from image to image that take back earlier ones. Equations:
//! `docs/src/equations.md`, "Markers".

use crate::measurements::markers::ImageInnovation;
use nalgebra::Vector2;
use rig_model::Stamp;

/// Number of images over which the variances are means.
const MEMORY: f64 = 30.0;
/// Largest difference that counts, in units of what earlier ones predict: one image is no shake.
const SURPRISING: f64 = 3.0;
/// A variance above this many times what the images claim is a shake …
const LARGE: f64 = 6.0;
/// … where deviations contradict the ones before by this share of their square (6/13 for white
/// noise) …
const ALTERNATING: f64 = 0.2;
/// … or, for vibrations that advance by 30 to 180° from image to image, where they contradict by
/// this share those up to half of [`LAGS`] images before (a sine by three quarters at least), and
/// resemble by this share those twice as long before.
const OPPOSED: f64 = 0.35;
const REPEATED: f64 = 0.1;
const LAGS: usize = 12;
/// Largest cosine of the angle from image to image: 30°.
const SLOWEST: f64 = 0.866;
/// Images further apart than this say nothing: the error of the motion grows, s.
const APART: f64 = 0.25;
/// Variance of a shake that the first images cannot exclude, px², and their number.
const UNKNOWN: f64 = 0.2 * 0.2;
const FIRST: f64 = 15.0;
/// Number of changes whose mean is the usual one.
const USUAL: usize = 3;
/// `−E[d[k] d[k−1]]` and `E[d²]` of white noise of variance 1.
const WHITE: [f64; 2] = [4.0 / 3.0, 26.0 / 9.0];

/// Returns the mean square of the deviations of a vibration of variance 1 that advances by an angle
/// of this cosine from image to image.
fn of_vibration(cosine: f64) -> f64 {
    let angle = cosine.acos();
    let usual = (1..=USUAL).map(|k| (k as f64 * angle).sin_cos());
    let (sines, cosines) = usual.fold((0.0, 0.0), |sum, (s, c)| (sum.0 + s, sum.1 + c));
    let count = USUAL as f64;
    (2.0 - 2.0 * cosine) * ((1.0 - cosines / count).powi(2) + (sines / count).powi(2))
}

/// Shake of the camera, by image axis.
#[derive(Clone, Debug, Default)]
pub struct CameraShake {
    /// Newest image, and what was left of its residuals, px; NaN where there is no marker.
    last: Option<(Stamp, [Vector2<f64>; 4])>,
    /// Changes of the mean marker from image to image, and their deviations from the mean of those
    /// before, the newest one first, px.
    changes: [Option<Vector2<f64>>; USUAL],
    deviations: [Option<Vector2<f64>>; LAGS],
    /// Mean square of the deviations, and of what each takes back of those before it, px².
    square: Vector2<f64>,
    opposed: [Vector2<f64>; LAGS],
    /// Number of images, up to [`MEMORY`].
    count: f64,
    /// Variance of the mean marker that the newest image claims, px².
    claimed: Vector2<f64>,
}

impl CameraShake {
    /// Adds an image that is processed for the first time.
    pub fn add(&mut self, stamp: Stamp, record: &ImageInnovation) {
        if !has_enough(record) {
            return;
        }
        // At a rate at which images say nothing of a shake, the doubt fades as well.
        self.count = (self.count + 1.0).min(MEMORY);
        let change = self.change_to(stamp, record);
        self.claimed = record.mean_variance;
        let deviation = change.zip(self.usual_change()).map(|(change, usual)| {
            let least = self.claimed.add_scalar(self.doubt()) * WHITE[1];
            let most = self.square.sup(&least);
            let most = most.map(|square| SURPRISING * square.sqrt());
            (change - usual).zip_map(&most, |d, most| d.clamp(-most, most))
        });
        if let (Some(d), [Some(_), ..]) = (deviation, self.deviations) {
            self.square += (d.component_mul(&d) - self.square) / self.count;
            for (opposed, before) in self.opposed.iter_mut().zip(&self.deviations) {
                let product = before.map_or(Vector2::zeros(), |before| d.component_mul(&before));
                *opposed -= (product + *opposed) / self.count;
            }
        }
        self.changes.rotate_right(1);
        self.changes[0] = change;
        self.deviations.rotate_right(1);
        self.deviations[0] = deviation;
        self.corrected(stamp, record);
    }

    /// Returns the mean of the last changes: an error of the velocity.
    fn usual_change(&self) -> Option<Vector2<f64>> {
        let sum: Option<Vector2<f64>> = self.changes.iter().copied().sum();
        sum.map(|sum| sum / USUAL as f64)
    }

    /// Returns by how much the markers changed unlike the prediction since the image before: the
    /// median, which a false marker does not move.
    fn change_to(&self, stamp: Stamp, record: &ImageInnovation) -> Option<Vector2<f64>> {
        let (_, left) = self.last.as_ref().filter(|(at, _)| stamp.seconds_since(*at) < APART)?;
        let mut change = Vector2::zeros();
        for axis in 0..2 {
            let mut changes: [f64; 4] =
                std::array::from_fn(|i| record.markers[i].residual[axis] - left[i][axis]);
            changes.sort_by(f64::total_cmp);
            let count = changes.iter().filter(|change| change.is_finite()).count();
            change[axis] = match count {
                4 => (changes[1] + changes[2]) / 2.0,
                3 => changes[1],
                _ => return None,
            };
        }
        Some(change)
    }

    /// Notes what is left of the residuals of an image, which may be processed more than once.
    pub fn corrected(&mut self, stamp: Stamp, record: &ImageInnovation) {
        if has_enough(record) && self.last.is_none_or(|(newest, _)| newest <= stamp) {
            self.last = Some((stamp, record.left));
        }
    }

    /// Notes that the pose was initialized from an image: differences begin there.
    pub fn interrupt(&mut self, stamp: Stamp, record: &ImageInnovation) {
        (self.last, self.changes, self.deviations) = (None, [None; USUAL], [None; LAGS]);
        self.corrected(stamp, record);
    }

    /// Returns the variance of the shake in x and y of the image, px²; 0 without one.
    pub fn variance(&self) -> Vector2<f64> {
        Vector2::from_fn(|axis, _| {
            let (square, claimed) = (self.square[axis], self.claimed[axis]);
            let opposed = self.opposed.map(|product| product[axis]);
            let mut variance = 0.0;
            if opposed[0] > ALTERNATING * square {
                variance = opposed[0] / WHITE[0];
            }
            let sine = square - WHITE[1] * claimed;
            let vibrates = (1..=LAGS / 2).any(|lag| {
                opposed[lag - 1] > OPPOSED * square && -opposed[2 * lag - 1] > REPEATED * square
            });
            if square > LARGE * WHITE[1] * claimed && vibrates {
                let cosine = (-(opposed[0] - WHITE[0] * claimed) / sine).clamp(-1.0, SLOWEST);
                variance = f64::max(variance, sine / of_vibration(cosine) + claimed);
            }
            let found = if variance > LARGE * claimed { variance - claimed } else { 0.0 };
            found.max(self.doubt())
        })
    }

    /// Returns the variance of a shake that too few images exclude, px².
    fn doubt(&self) -> f64 {
        UNKNOWN * (1.0 - self.count / FIRST).max(0.0).powi(2)
    }
}

/// Whether enough markers are seen that one of them may be false.
fn has_enough(record: &ImageInnovation) -> bool {
    record.left.iter().filter(|left| left.x.is_finite()).count() >= 3
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurements::{Innovation, Outcome};
    use rig_simulator::random::Random;

    const CLAIMED: f64 = 0.001;

    /// Variance found of images whose markers are off by `error` px (image number), seen by a
    /// filter that takes half of each residual as motion; `interval` between the images, ms.
    fn found(interval: i64, mut error: impl FnMut(usize, &mut Random) -> [Vector2<f64>; 4]) -> f64 {
        let (mut shake, mut random) = (CameraShake::default(), Random::new(4));
        let (mut position, mut velocity) = (Vector2::zeros(), Vector2::zeros());
        for k in 0..300 {
            let seen = error(k, &mut random)
                .map(|e| e + Vector2::from_fn(|_, _| random.normal() * (4.0 * CLAIMED).sqrt()));
            position += velocity;
            let residuals = seen.map(|seen| seen - position);
            // The false one is rejected.
            let mean = (residuals[0] + residuals[2] + residuals[3]) / 3.0;
            position += mean * 0.5;
            velocity += mean * 0.1;
            let mut record = ImageInnovation {
                markers: [Innovation::without_values(Outcome::Used); 4],
                nis: 0.0,
                used: 4,
                misfit: None,
                against_prediction: None,
                with_free_climber: [f64::NAN; 3],
                mean_variance: Vector2::repeat(CLAIMED),
                left: residuals.map(|residual| residual - mean * 0.5),
                evidence: Default::default(),
            };
            for (marker, residual) in record.markers.iter_mut().zip(residuals) {
                marker.residual = residual;
            }
            shake.add(Stamp::from_nanos(1 + 1_000_000 * interval * k as i64), &record);
        }
        shake.variance().mean()
    }

    #[test]
    fn a_shake_is_found_and_motion_shocks_and_false_markers_are_none() {
        let all = |x: f64| [Vector2::new(x, -x); 4];
        let white = found(33, |_, random| [Vector2::from_fn(|_, _| 0.3 * random.normal()); 4]);
        assert!((0.03..0.2).contains(&white), "{white}");
        // 9, 7 and 4 Hz at 30 images per second.
        for (angle, amplitude) in [(1.885, 0.3), (1.466, 0.3), (0.838, 0.6)] {
            let vibration = found(33, |k, _| all(amplitude * (k as f64 * angle).sin()));
            let range = amplitude.powi(2) * 0.2..amplitude.powi(2);
            assert!(range.contains(&vibration), "{angle}: {vibration}");
        }
        assert_eq!(CameraShake::default().variance(), Vector2::repeat(UNKNOWN));
        let none = found(33, |_, _| all(0.0));
        let motion = found(33, |k, _| all(20.0 * (k as f64 * 0.2).sin()));
        let shocks = found(33, |k, _| all(2.0 * (k / 60) as f64));
        let one_false = found(33, |_, random| {
            let mut errors = all(0.0);
            errors[1].x = 30.0 * random.normal();
            errors
        });
        let slow = found(400, |_, _| all(0.0));
        assert_eq!([none, motion, shocks, one_false, slow], [0.0; 5]);
    }
}
