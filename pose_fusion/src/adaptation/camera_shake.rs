//! Shake of the camera: an error that all markers of an image share, and that is another one in the
//! next image. It is found in second differences from image to image, of which each takes back the
//! one before. Equations: `docs/src/equations.md`, "Markers".

use crate::measurements::markers::ImageInnovation;
use nalgebra::Vector2;
use rig_model::Stamp;

/// Number of images over which the variances are means.
const MEMORY: f64 = 15.0;
/// Largest difference that counts, in units of what earlier ones predict: one image is no shake.
const SURPRISING: f64 = 3.0;
/// A variance above this many times what the images claim is a shake …
const LARGE: f64 = 4.5;
/// … where the differences contradict each other by this share of their square: two thirds for
/// white noise, −cos θ for a vibration that advances by the angle θ from image to image.
const ALTERNATING: f64 = 0.2;
/// Images further apart than this say nothing: the error of the motion grows, s.
const APART: f64 = 0.25;
/// Variance of a shake that the first images cannot exclude, px².
const UNKNOWN: f64 = 0.2 * 0.2;
/// `−E[d[k] d[k−1]]` and `E[d²]` of white noise of variance 1.
const WHITE: [f64; 2] = [4.0, 6.0];

/// Shake of the camera, by image axis.
#[derive(Clone, Debug, Default)]
pub struct CameraShake {
    /// Newest image, and what was left of its residuals, px; NaN where there is no marker.
    last: Option<(Stamp, [Vector2<f64>; 4])>,
    /// First and second difference of the mean marker at the newest image, px.
    change: Option<Vector2<f64>>,
    bend: Option<Vector2<f64>>,
    /// Mean square of the second differences, and of what each takes back of the one before, px².
    square: Vector2<f64>,
    alternating: Vector2<f64>,
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
        let bend = change.zip(self.change).map(|(change, before)| {
            let least = self.claimed.add_scalar(self.doubt()) * WHITE[1];
            let most = self.square.sup(&least);
            let most = most.map(|square| SURPRISING * square.sqrt());
            (change - before).zip_map(&most, |d, most| d.clamp(-most, most))
        });
        if let (Some(bend), Some(before)) = (bend, self.bend) {
            self.square += (bend.component_mul(&bend) - self.square) / self.count;
            self.alternating -= (bend.component_mul(&before) + self.alternating) / self.count;
        }
        (self.change, self.bend) = (change, bend);
        self.corrected(stamp, record);
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
        (self.last, self.change, self.bend) = (None, None, None);
        self.corrected(stamp, record);
    }

    /// Returns the variance of the shake in x and y of the image, px²; 0 without one.
    pub fn variance(&self) -> Vector2<f64> {
        Vector2::from_fn(|axis, _| {
            let (alternating, claimed) = (self.alternating[axis], self.claimed[axis]);
            let variance = alternating / WHITE[0];
            let shakes =
                variance > LARGE * claimed && alternating > ALTERNATING * self.square[axis];
            let found = if shakes { variance - claimed } else { 0.0 };
            found.max(self.doubt())
        })
    }

    /// Returns the variance of a shake that too few images exclude, px².
    fn doubt(&self) -> f64 {
        UNKNOWN * (1.0 - self.count / MEMORY).powi(2)
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
        // 9 Hz at 30 images per second.
        let vibration = found(33, |k, _| all(0.3 * (k as f64 * 1.885).sin()));
        assert!((0.01..0.1).contains(&vibration), "{vibration}");
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
