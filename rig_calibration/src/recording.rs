//! A recording as numbers: marker observations, IMU samples, climber poses, camera.

use crate::CalibrationError;
use nalgebra::{Matrix2, Matrix3, SMatrix, UnitQuaternion, Vector2, Vector3, Vector4};
use rig_model::{
    CameraModel, ClimberSample, ImuSample, MarkerObservations, MarkerState, Stamp, topics,
};

/// What a recording holds, in the order received.
#[derive(Clone, Debug)]
pub struct Samples {
    /// The camera.
    pub camera: CameraModel,
    /// Marker observations.
    pub markers: Vec<MarkerObservations>,
    /// IMU samples.
    pub imu: Vec<ImuSample>,
    /// Climber poses.
    pub climber: Vec<ClimberSample>,
}

impl Samples {
    /// Moves the markers to where they are in the middle of the exposure of a rolling shutter that
    /// takes `readout` s from the first row to the last. The samples are in order
    /// ([`Samples::repair`]).
    pub fn at_one_time(&mut self, readout: f64) {
        if readout == 0.0 {
            return;
        }
        let moves = by_readout(&self.markers, &self.camera);
        for (observations, moves) in self.markers.iter_mut().zip(moves) {
            for (marker, by_readout) in observations.markers.0.iter_mut().zip(moves) {
                marker.centroid -= by_readout * readout;
            }
        }
    }

    /// Sorts each topic by its stamps; removes messages that are repeated, have no stamp or are not
    /// finite, which the filter rejects, too.
    pub fn repair(&mut self) {
        fn in_order<T>(list: &mut Vec<T>, stamp: fn(&T) -> Stamp) {
            list.retain(|s| !stamp(s).is_unset());
            list.sort_by_key(stamp);
            list.dedup_by_key(|s| stamp(s));
        }
        self.imu.retain(|s| finite(s.specific_force.iter().chain(&s.angular_velocity)));
        self.climber.retain(|s| {
            let pose = &s.world_from_climber;
            finite(pose.translation.vector.iter().chain(&pose.rotation.coords))
        });
        self.markers.retain(|o| {
            let mut detected = o.markers.0.iter().filter(|m| m.state == MarkerState::Detected);
            detected.all(|m| finite(m.centroid.iter().chain(&m.covariance)))
        });
        in_order(&mut self.imu, |s| s.stamp);
        in_order(&mut self.climber, |s| s.stamp);
        in_order(&mut self.markers, |o| o.stamp);
    }
}

/// How a rolling shutter moves the markers of each image, px per second of readout: a row is
/// exposed its share of the readout before or after the middle one. 0 where the image velocity is
/// unknown.
fn by_readout(markers: &[MarkerObservations], camera: &CameraModel) -> Vec<[Vector2<f64>; 4]> {
    /// Longest time between two images from which a velocity is computed, s.
    const LONGEST: f64 = 0.35;
    let height = f64::from(camera.size().1);
    let seen = |k: usize, color: usize| {
        let marker = &markers[k].markers.0[color];
        (marker.state == MarkerState::Detected).then_some(marker.centroid)
    };
    let moved = |k: usize, color: usize| {
        let late = seen(k, color)?.y / height - 0.5;
        let between = |from: usize, to: usize| {
            let dt = markers[to].stamp.seconds_since(markers[from].stamp);
            let moved = seen(to, color)? - seen(from, color)?;
            (dt > 0.0 && dt < LONGEST).then(|| moved * (late / dt))
        };
        // At an end, and beside an image without the marker, from one neighbor.
        let before = k.saturating_sub(1);
        let after = (k + 1).min(markers.len() - 1);
        between(before, after).or_else(|| between(before, k)).or_else(|| between(k, after))
    };
    let of_image = |k: usize| [0, 1, 2, 3].map(|color| moved(k, color).unwrap_or_default());
    (0..markers.len()).map(of_image).collect()
}

fn finite<'a>(mut values: impl Iterator<Item = &'a f64>) -> bool {
    values.all(|value| value.is_finite())
}

/// Whether all four markers were measured.
pub(crate) fn all_detected(o: &MarkerObservations) -> bool {
    o.markers.0.iter().all(|m| m.state == MarkerState::Detected)
}

/// Angle of the rotated x axis about the vertical, rad.
pub(crate) fn heading(rotation: &UnitQuaternion<f64>) -> f64 {
    let along = rotation * Vector3::x();
    along.y.atan2(along.x)
}

/// One image in which all four markers were measured.
#[derive(Clone, Debug)]
pub struct Shot {
    /// Time since the recording's first stamp, s, camera clock.
    pub time: f64,
    /// Centroids of the markers, px.
    pub pixels: [Vector2<f64>; 4],
    /// Covariances of the centroids, px².
    pub covariances: [Matrix2<f64>; 4],
    /// How a rolling shutter moves the markers, px per second of readout.
    pub by_readout: [Vector2<f64>; 4],
}

/// Climber at an instant.
#[derive(Clone, Copy, Debug)]
pub struct Moving {
    /// Position, m.
    pub position: Vector3<f64>,
    /// Rotation about the vertical, rad, unwrapped.
    pub turn: f64,
    /// Acceleration, m/s²; 0 where the samples do not show it.
    pub acceleration: Vector3<f64>,
}

/// Recording as numbers.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The camera.
    pub camera: CameraModel,
    /// Images with all four markers, sorted by time.
    pub shots: Vec<Shot>,
    /// IMU samples: s since the first stamp, specific force (m/s²), angular velocity (rad/s).
    pub imu: Vec<(f64, Vector3<f64>, Vector3<f64>)>,
    /// Climber: s since the first stamp, position (m) and rotation about the vertical (rad,
    /// unwrapped).
    pub climber: Vec<(f64, Vector3<f64>, f64)>,
}

/// Half widths of the windows of the weighted fits to the climber's samples, s: they average the
/// encoders' quantization.
const CLIMBER_WINDOW: f64 = 0.2;
const ACCELERATION_WINDOW: f64 = 0.35;

/// Longest part of a recording that a check uses, images, and of how many it takes one in a part of
/// more than half of that: its time grows with them.
const SPAN: usize = 900;
const EVERY: usize = 2;

impl Recording {
    /// Sorts the samples, without those that are repeated or invalid, selects the images with all
    /// four markers, and converts stamps to seconds.
    ///
    /// # Errors
    /// Too few images, IMU samples or climber poses.
    pub fn new(samples: &Samples) -> Result<Self, CalibrationError> {
        let mut samples = samples.clone();
        samples.repair();
        let (imu, climber) = (&samples.imu, &samples.climber);
        for (count, topic) in [(imu.len(), topics::IMU), (climber.len(), topics::CLIMBER_TRANSFORM)]
        {
            if count < 100 {
                return Err(CalibrationError::TooShort(count, topic));
            }
        }
        let start = imu[0].stamp;
        let climber = climber_line(climber, start);
        let imu: Vec<_> = imu
            .iter()
            .map(|s| (s.stamp.seconds_since(start), s.specific_force, s.angular_velocity))
            .collect();
        let end = imu[imu.len() - 1].0;
        // Beyond its ends the climber's readings are unknown.
        let covered = climber[0].0..=climber[climber.len() - 1].0;
        let moves = by_readout(&samples.markers, &samples.camera);
        let mut shots: Vec<Shot> = samples
            .markers
            .iter()
            .zip(moves)
            .filter(|(o, _)| all_detected(o))
            .map(|(o, by_readout)| Shot {
                time: o.stamp.seconds_since(start),
                pixels: o.markers.0.map(|m| m.centroid),
                covariances: o.markers.0.map(|m| m.covariance),
                by_readout,
            })
            // The IMU samples must extend beyond both ends, also with different clocks.
            .filter(|s| s.time > 0.2 && s.time < end - 0.2 && covered.contains(&s.time))
            .collect();
        shots.dedup_by(|a, b| a.time - b.time < 1e-4);
        if shots.len() < 60 {
            return Err(CalibrationError::FewImages(shots.len()));
        }
        Ok(Self { camera: samples.camera, shots, imu, climber })
    }

    /// Keeps the consecutive images, at most [`SPAN`], in which the climber moves most; of more
    /// than half as many one in [`EVERY`].
    pub(crate) fn keep_liveliest(&mut self) {
        if self.shots.len() > SPAN {
            self.keep_span();
        }
        if self.shots.len() > SPAN / 2 {
            self.shots = self.shots.iter().step_by(EVERY).cloned().collect();
        }
    }

    fn keep_span(&mut self) {
        let mut way = vec![0.0_f64];
        for w in self.shots.windows(2) {
            let (a, b) = (self.climber_at(w[0].time), self.climber_at(w[1].time));
            way.push(
                way[way.len() - 1] + ((b.position - a.position).norm() + (b.turn - a.turn).abs()),
            );
        }
        let last = self.shots.len() - SPAN;
        let of = |k: &usize| way[k + SPAN - 1] - way[*k];
        let first = (0..=last).max_by(|a, b| of(a).total_cmp(&of(b))).unwrap_or(0);
        self.shots = self.shots[first..first + SPAN].to_vec();
    }

    /// The climber at a time of its clock, by parabolas through the samples around it.
    pub fn climber_at(&self, time: f64) -> Moving {
        let fitted = |window| fit(&self.climber, time, window);
        let (value, acceleration) = match fitted(CLIMBER_WINDOW) {
            Some((value, _)) => (value, fitted(ACCELERATION_WINDOW).map(|(_, a)| a)),
            None => (line(&self.climber, time), None),
        };
        let acceleration = acceleration.unwrap_or_default().xyz();
        Moving { position: value.xyz(), turn: value.w, acceleration }
    }
}

fn reading(sample: &(f64, Vector3<f64>, f64)) -> Vector4<f64> {
    sample.1.push(sample.2)
}

/// Value and acceleration at a time by a parabola through the climber's samples within half a
/// window, s; `None` at an end, or in a gap.
fn fit(
    climber: &[(f64, Vector3<f64>, f64)],
    time: f64,
    window: f64,
) -> Option<(Vector4<f64>, Vector4<f64>)> {
    let first = climber.partition_point(|c| c.0 < time - window);
    let last = climber.partition_point(|c| c.0 <= time + window);
    let samples = &climber[first..last];
    let around = samples.iter().any(|c| c.0 < time) && samples.iter().any(|c| c.0 > time);
    if !around || samples.len() < 5 {
        return None;
    }
    // Normal equations of value, rate and half the acceleration at `time`.
    let (mut matrix, mut right) = (Matrix3::zeros(), SMatrix::<f64, 3, 4>::zeros());
    for c in samples {
        let u = (c.0 - time) / window;
        // Weights that vanish at the window's ends: the result is smooth in time.
        let weight = (1.0 - u * u).max(0.0).powi(2);
        let powers = Vector3::new(1.0, u, u * u);
        matrix += powers * powers.transpose() * weight;
        right += powers * reading(c).transpose() * weight;
    }
    let solved = matrix.cholesky()?.solve(&right);
    let [value, half] = [0, 2].map(|power| solved.row(power).transpose());
    Some((value, half * (2.0 / (window * window))))
}

/// Value at a time on the line through two of the climber's samples.
fn line(climber: &[(f64, Vector3<f64>, f64)], time: f64) -> Vector4<f64> {
    let middle = climber.partition_point(|c| c.0 < time).clamp(1, climber.len() - 1);
    let (a, b) = (&climber[middle - 1], &climber[middle]);
    reading(a) + (reading(b) - reading(a)) * ((time - a.0) / (b.0 - a.0).max(1e-6))
}

fn climber_line(samples: &[ClimberSample], start: Stamp) -> Vec<(f64, Vector3<f64>, f64)> {
    let mut line: Vec<(f64, Vector3<f64>, f64)> = Vec::with_capacity(samples.len());
    for sample in samples {
        let pose = &sample.world_from_climber;
        let mut turn = heading(&pose.rotation);
        let time = sample.stamp.seconds_since(start);
        if let Some(last) = line.last() {
            turn += ((last.2 - turn) / std::f64::consts::TAU).round() * std::f64::consts::TAU;
        }
        line.push((time, pose.translation.vector, turn));
    }
    line
}
