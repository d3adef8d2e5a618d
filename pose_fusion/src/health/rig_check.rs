//! Light check of the rig file: symptoms that the filter shows while it runs and that a correct rig
//! would not; `volant check` finds the cause (`docs/src/check.md`). The limits are several times
//! the largest value of correct files (in brackets) on seven recordings, three of them with real
//! IMU samples; `test/tests/check.rs` repeats it.

use crate::{
    health::{
        rig_evidence,
        status::{Status, TimeOffsetStatus},
    },
    input::imu_stamps::Bursts,
    measurements::Outcome,
    output::MarkerUpdates,
};
use nalgebra::Vector2;
use rig_model::PerColor;

/// Memory of the means, measured markers of one color: five seconds of a usual camera.
const MEMORY: f64 = 150.0;
/// Consecutive measured markers of which none is used before that is reported: ten seconds.
const NO_POSE: u32 = 1200;

/// Mean innovation of a marker, px (0.06 px).
const MEAN_INNOVATION: f64 = 0.15;
/// Standard deviations by which it differs from zero.
const CERTAIN: f64 = 5.0;
/// Share of a marker's measurements that are rejected (0.006).
const REJECTED: f64 = 0.05;
/// Factor on the claimed pixel sigma (1.0).
const PIXEL_NOISE: f64 = 1.5;
/// Accelerometer bias, m/s² (0.10), and gyroscope bias, rad/s (0.02).
const BIAS: [f64; 2] = [0.3, 0.06];
/// Scale factors of gyroscope and accelerometer (0.005).
const SCALE: [f64; 2] = [0.015, 0.02];
/// Rotations of gyroscope and accelerometer against `imu.orientation`, rad (0.003, 0.013).
const ROTATION: [f64; 2] = [0.03, 0.04];
/// Estimated offset of a marker from its place in the rig file, m (0.00002).
const OFFSET: f64 = 0.0003;
/// Camera time offset beside the configured one, s (0.001): more than the age of an image.
const TIME_OFFSET: f64 = 0.05;

/// Recent measurements of one marker.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Marker {
    count: f64,
    /// Mean innovation, px, and mean square, px².
    innovation: Vector2<f64>,
    square: f64,
    /// Share of rejected measurements.
    rejected: f64,
}

/// Light check of the rig file.
#[derive(Clone, Debug, Default)]
pub struct RigCheck {
    has_camera: bool,
    markers: PerColor<Marker>,
    /// Measured markers since the last one that was used.
    unused: u32,
}

impl RigCheck {
    /// Records that a camera model has arrived. Before it, every marker is rejected.
    pub fn note_camera(&mut self) {
        self.has_camera = true;
    }

    /// Adds the markers of an image.
    pub fn note(&mut self, image: &MarkerUpdates) {
        if !self.has_camera {
            return;
        }
        let detected = image.markers.0.iter().filter(|m| m.outcome != Outcome::NotDetected).count();
        for (color, record) in image.markers.iter() {
            let rejected = match record.outcome {
                Outcome::Used => false,
                // Two markers begin no pose, however right they are.
                Outcome::NotInitialized if detected < 3 => continue,
                Outcome::NotInitialized | Outcome::Gated | Outcome::Inconsistent => true,
                _ => continue,
            };
            self.unused = if rejected { self.unused.saturating_add(1) } else { 0 };
            let marker = &mut self.markers[color];
            marker.count += 1.0;
            let weight = (1.0 / marker.count).max(1.0 / MEMORY);
            marker.rejected += (f64::from(u8::from(rejected)) - marker.rejected) * weight;
            // A false marker far off says nothing about the layout; its share counts above.
            if !rejected && record.residual.norm().is_finite() {
                marker.innovation += (record.residual - marker.innovation) * weight;
                marker.square += (record.residual.norm_squared() - marker.square) * weight;
            }
        }
    }

    /// Returns a sentence for each value that correct files would not show.
    pub fn findings(&self, status: &Status) -> Vec<String> {
        if self.unused > NO_POSE {
            return vec![format!(
                "no pose fits the last {} measured markers (order of `markers`, \
                 `imu.orientation`, units, stamps)",
                self.unused
            )];
        }
        let mut found = Vec::new();
        if let Some(Bursts { period, samples }) = status.imu_bursts {
            found.push(format!(
                "the IMU samples come in bursts of {samples:.1} every {:.0} ms with the stamps of \
                 their arrival (driver of the IMU, latency timer of its serial adapter, second publisher)",
                1e3 * samples * period
            ));
        }
        let rejected = self.markers.0.map(|m| if m.count < MEMORY { 0.0 } else { m.rejected });
        let least = rejected.into_iter().fold(f64::INFINITY, f64::min);
        if least > REJECTED {
            found.push(format!(
                "{:.0} % of each marker rejected (units, stamps, `imu.orientation`, \
                 `camera.orientation`, `camera_info`)",
                100.0 * least
            ));
        }
        for (color, marker) in self.markers.iter().filter(|(_, m)| m.count >= MEMORY) {
            let (name, mean) = (color.name(), marker.innovation.norm());
            let certain = CERTAIN * (marker.square / MEMORY).sqrt();
            if marker.rejected > REJECTED && least <= REJECTED {
                let percent = 100.0 * marker.rejected;
                found.push(format!(
                    "{percent:.0} % of {name} rejected (`markers.{name}`, `camera_info`)"
                ));
            } else if marker.rejected <= REJECTED && mean > MEAN_INNOVATION.max(certain) {
                found.push(format!(
                    "{name} has a mean innovation of {mean:.2} px (`markers.{name}`, \
                     `camera.orientation`, `camera_info`)"
                ));
            }
        }
        let settled = self.markers.0.iter().map(|m| m.count).sum::<f64>() > 4.0 * MEMORY;
        if settled && status.initialized && !status.time_offset.searching {
            filter_findings(status, &mut found);
        }
        found
    }
}

/// Adds what the filter's estimates show.
fn filter_findings(status: &Status, found: &mut Vec<String>) {
    if let Some(wrong) = status.encoders.wrong_directions {
        found.push(format!("{wrong} (images and IMU show the climber's motion)"));
    }
    found.extend(rig_evidence::findings(&status.file_errors));
    let largest = |first: usize| status.constants.fixed_rows::<3>(first).amax();
    if status.pixel_noise_factor > PIXEL_NOISE {
        found.push(format!(
            "the pixel sigma is {:.1} times that claimed (`markers`, `camera_info`)",
            status.pixel_noise_factor
        ));
    }
    if status.marker_offset() > OFFSET {
        found.push(format!(
            "the markers are {:.1} mm and more from their places (measure `markers`, or \
             `volant calibrate rig`)",
            1e3 * status.marker_offset()
        ));
    }
    let TimeOffsetStatus { offset, configured, .. } = status.time_offset;
    if (offset - configured).abs() > TIME_OFFSET {
        found.push(format!(
            "image time and IMU time differ by {:.0} ms, and `clock.camera_offset` is {:.0} ms \
             (stamps of camera and IMU)",
            1e3 * offset,
            1e3 * configured
        ));
    }
    let names = ["accelerometer", "gyroscope"];
    for (k, unit) in ["m/s^2", "rad/s"].into_iter().enumerate() {
        let bias = status.biases[k].norm();
        if bias > BIAS[k] {
            found.push(format!(
                "{} bias {bias:.2} {unit} (unit, `imu.orientation`, `camera.orientation`)",
                names[k]
            ));
        }
    }
    for (k, name) in names.into_iter().rev().enumerate() {
        let (scale, rotation) = (largest(3 * k), largest(6 + 3 * k));
        if scale > SCALE[k] {
            let percent = 100.0 * scale;
            found.push(format!("{name} scale factor {percent:.1} % (calibration, unit, layout)"));
        }
        if rotation > ROTATION[k] {
            let degrees = rotation.to_degrees();
            found.push(format!("{name} rotated by {degrees:.1} deg (`imu.orientation`)"));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measurements::Innovation;
    use rig_model::{MarkerColor, Stamp};
    use rig_simulator::random::Random;

    #[test]
    fn a_configured_time_offset_is_no_finding() {
        for (configured, findings) in [(0.2, 0), (0.1, 1), (0.0, 1)] {
            let time_offset =
                TimeOffsetStatus { offset: 0.2, configured, ..TimeOffsetStatus::default() };
            let mut found = Vec::new();
            filter_findings(&Status { time_offset, ..Status::default() }, &mut found);
            assert_eq!(found.len(), findings, "{found:?}");
        }
    }

    #[test]
    fn images_before_the_camera_model_or_of_two_markers_are_no_finding() {
        let mut check = RigCheck::default();
        let note_of = |check: &mut RigCheck, outcomes: [Outcome; 4], images: u32| {
            for _ in 0..images {
                let markers = PerColor(outcomes.map(Innovation::<2>::without_values));
                check.note(&MarkerUpdates { stamp: Stamp::default(), markers });
            }
        };
        let note = |check: &mut RigCheck, outcome, images| note_of(check, [outcome; 4], images);
        let mut two = RigCheck::default();
        two.note_camera();
        let [seen, hidden] = [Outcome::NotInitialized, Outcome::NotDetected];
        note_of(&mut two, [seen, seen, hidden, hidden], NO_POSE);
        assert_eq!(two.findings(&Status::default()), Vec::<String>::new());
        note(&mut check, Outcome::NotInitialized, 90);
        assert_eq!((check.unused, check.markers[MarkerColor::Red].count), (0, 0.0));
        check.note_camera();
        note(&mut check, Outcome::Used, 200);
        assert_eq!(check.markers[MarkerColor::Red].rejected, 0.0);
        note(&mut check, Outcome::Gated, 20);
        assert!(check.markers[MarkerColor::Red].rejected > REJECTED);
    }

    #[test]
    fn a_mean_innovation_is_large_against_its_noise() {
        for (offset, noise, findings) in
            [(0.0, 1.0, 0), (0.05, 0.1, 0), (0.3, 0.1, 4), (1.0, 1.0, 4)]
        {
            let (mut check, mut random) = (RigCheck::default(), Random::new(3));
            check.note_camera();
            for _ in 0..2000 {
                let markers = PerColor([(); 4].map(|()| Innovation::<2> {
                    residual: Vector2::from_fn(|_, _| offset + noise * random.normal()),
                    ..Innovation::without_values(Outcome::Used)
                }));
                check.note(&MarkerUpdates { stamp: Stamp::default(), markers });
                let found = check.findings(&Status::default()).len();
                assert!(found <= findings, "{offset} {noise}");
            }
            assert_eq!(check.findings(&Status::default()).len(), findings, "{offset} {noise}");
        }
    }
}
