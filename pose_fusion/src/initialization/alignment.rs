//! Alignment of the visual poses of single images with the motion that the IMU measured, to find
//! the camera time offset. Equations: `docs/src/equations.md`, "Initialization".

use super::preintegration::Preintegrated;
use crate::{adaptation::imu_noise::Densities, config::ImuConfig, ekf::propagation::ImuReading};
use nalgebra::{Isometry3, Matrix6, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use rig_model::Stamp;
use std::collections::VecDeque;

/// Largest offset that is looked for, s.
pub const REACH: f64 = 0.3;
/// The newest image poses of this time are aligned, s: longer, and the IMU's scale errors count.
pub const WINDOW: f64 = 1.5;
/// An offset that is closer to the end of the candidates, s, is not a minimum.
const EDGE: f64 = 0.003;
/// Distance of the candidates, s.
pub(super) const STEP: f64 = 0.01;
/// Number of candidates.
pub(super) const CANDIDATES: usize = 61;
/// Smallest standard deviation of a bias, m/s², rad/s: a bias that is known has one, too.
const SMALLEST_BIAS: f64 = 1e-6;
/// Fewest images of an alignment.
pub(super) const FEWEST: usize = 12;
/// Largest standard deviation of an offset that is known, s.
pub(super) const ACCEPTED: f64 = 0.010;
/// Every other candidate further away than this, s …
const APART: f64 = 0.02;
/// … must fit worse by this (χ²).
const REFUTED: f64 = 16.0;
/// Largest χ² per degree of freedom of an alignment that means anything.
pub(super) const LARGEST: f64 = 1.2;
/// Smallest χ² per degree of freedom that is accepted: the poses' own covariances are cautious.
const SMALLEST: f64 = 0.6;
/// Uncertainty of the initial velocity, m/s, and attitude, rad.
const OPEN: [f64; 2] = [2.0, 0.5];

const UNKNOWNS: usize = 15;
type Jacobian = SMatrix<f64, 6, UNKNOWNS>;
type Normal = SMatrix<f64, UNKNOWNS, UNKNOWNS>;
type Unknowns = SVector<f64, UNKNOWNS>;

/// Camera time offset with its standard deviation, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeOffset {
    /// Image time + offset = IMU time.
    pub offset: f64,
    /// Standard deviation.
    pub sigma: f64,
}

/// Pose of one image.
#[derive(Clone, Copy, Debug)]
pub(super) struct VisualPose {
    pub(super) stamp: Stamp,
    pub(super) world_from_volant: Isometry3<f64>,
    pub(super) covariance: Matrix6<f64>,
    /// Inverse covariance, the IMU's noise included; of the alignment that runs.
    pub(super) information: Matrix6<f64>,
}

/// Offset of a candidate, s.
pub(super) fn candidate(index: usize) -> f64 {
    index as f64 * STEP - REACH
}

/// Returns whether every candidate that is apart from an offset of this standard deviation, s, fits
/// worse than `best` by what refutes it; `costs` are the χ² of the candidates, NaN: no readings.
pub(super) fn others_are_refuted(costs: &[f64], best: f64, offset: f64, sigma: f64) -> bool {
    let apart = APART.max(REFUTED.sqrt() * sigma);
    (costs.iter().enumerate())
        .filter(|(i, cost)| (candidate(*i) - offset).abs() > apart && !cost.is_nan())
        .all(|(_, cost)| cost - best > REFUTED)
}

/// What the alignment of a window found.
pub(super) struct Aligned {
    /// Best offset, where it is known.
    pub(super) found: Option<TimeOffset>,
    /// Biases of the IMU that go with it.
    pub(super) biases: ImuReading,
    /// χ² per degree of freedom.
    pub(super) scale: f64,
    /// χ² of each candidate above the best, normalized; NaN where the readings do not reach.
    pub(super) costs: [f64; CANDIDATES],
}

impl Aligned {
    /// Returns whether an offset, s, fits badly: by itself, or worse than the best.
    pub(super) fn refutes(&self, offset: f64) -> bool {
        let index = ((offset + REACH) / STEP).round();
        let cost = self.costs.get(index as usize).copied().unwrap_or(f64::INFINITY);
        cost > REFUTED
    }
}

/// `volant_from_imu`, gravity (m/s²), errors of the IMU and its noise.
pub(super) type AlignmentSettings<'a> = (&'a Isometry3<f64>, f64, &'a ImuConfig, &'a Densities);

/// Aligns image poses with the IMU's motion, linearized at `biases`.
pub(super) fn align(
    poses: &[VisualPose],
    readings: &VecDeque<(Stamp, ImuReading)>,
    (volant_from_imu, gravity, imu, noise): AlignmentSettings<'_>,
    biases: &ImuReading,
) -> Option<Aligned> {
    let track = preintegrate(readings, biases);
    let of = |poses| Alignment { track: &track, poses, volant_from_imu, gravity, imu, biases };
    let mut alignment = of(poses);
    let mut costs = alignment.costs();
    let (mut start, mut coarse) = likeliest(&costs)?;
    // All are compared by the images that the readings reach with the likeliest: without a false
    // image each fits better, and the fewest images fit best.
    let common = alignment.reached(candidate(start));
    if !common.is_empty() {
        alignment = of(&common);
        costs = alignment.costs();
        (start, coarse) = likeliest(&costs)?;
    }
    let refined = alignment.refine(candidate(start));
    let (offset, best, curvature) = refined.unwrap_or((candidate(start), coarse, 0.0));
    let scale = best.mean().max(SMALLEST);
    let unit = scale * alignment.excess(offset, noise, scale)?;
    let costs = costs.map(|cost| match cost {
        Some(cost) => (cost.mean() - best.mean()) * best.freedom().min(cost.freedom()) / unit,
        None => f64::NAN,
    });
    let sigma = (2.0 * unit / curvature).sqrt();
    let refuted = others_are_refuted(&costs, 0.0, offset, sigma);
    let known = curvature > 0.0 && sigma < ACCEPTED && refuted && offset.abs() < REACH - EDGE;
    Some(Aligned {
        found: (known && scale < LARGEST).then_some(TimeOffset { offset, sigma }),
        biases: best.biases,
        scale,
        costs,
    })
}

/// Returns the candidate with the smallest cost, and that.
fn likeliest(costs: &[Option<Cost>; CANDIDATES]) -> Option<(usize, Cost)> {
    let usable = costs.iter().enumerate().filter_map(|(i, cost)| Some((i, (*cost)?)));
    usable.min_by(|a, b| a.1.mean().total_cmp(&b.1.mean()))
}

/// Motion from reading to reading, without the biases.
fn preintegrate(
    readings: &VecDeque<(Stamp, ImuReading)>,
    biases: &ImuReading,
) -> Vec<Preintegrated> {
    let mut track: Vec<Preintegrated> = Vec::with_capacity(readings.len());
    for (stamp, reading) in readings {
        let reading = &ImuReading {
            specific_force: reading.specific_force - biases.specific_force,
            angular_velocity: reading.angular_velocity - biases.angular_velocity,
        };
        let next = match track.last() {
            Some(last) => last.to(*stamp, reading),
            None => Preintegrated::first(*stamp, *reading),
        };
        track.push(next);
    }
    track
}

/// What is left of an alignment, and the biases that it found.
#[derive(Clone, Copy, Debug)]
struct Cost {
    square: f64,
    rows: f64,
    biases: ImuReading,
}

impl Cost {
    /// Degrees of freedom.
    fn freedom(&self) -> f64 {
        (self.rows - UNKNOWNS as f64).max(1.0)
    }

    /// χ² per degree of freedom.
    fn mean(&self) -> f64 {
        self.square / self.freedom()
    }
}

struct Alignment<'a> {
    track: &'a [Preintegrated],
    poses: &'a [VisualPose],
    volant_from_imu: &'a Isometry3<f64>,
    gravity: f64,
    imu: &'a ImuConfig,
    biases: &'a ImuReading,
}

impl Alignment<'_> {
    /// Cost of every candidate.
    fn costs(&self) -> [Option<Cost>; CANDIDATES] {
        std::array::from_fn(|i| self.cost(candidate(i)))
    }

    /// Images that the readings reach with an offset and those a step beside it; none where they
    /// reach all.
    fn reached(&self, offset: f64) -> Vec<VisualPose> {
        let reaches = |p: &&VisualPose| {
            let at = |by: f64| self.at(p.stamp.plus_seconds(offset + by)).is_some();
            at(-STEP) && at(STEP)
        };
        if self.poses.iter().all(|pose| reaches(&pose)) {
            return Vec::new();
        }
        self.poses.iter().filter(reaches).copied().collect()
    }

    /// Cost of an offset; `None` where readings surround less than [`FEWEST`] or half the images.
    fn cost(&self, offset: f64) -> Option<Cost> {
        let motions = self.motions(offset)?;
        let start = self.start(&motions)?;
        let rows = motions.iter().map(|(pose, motion)| {
            let (residual, jacobian) = self.row(&start, pose, motion);
            (pose.information, residual, jacobian)
        });
        let (solution, square) = self.fit(rows, self.biases)?;
        let biases = ImuReading {
            specific_force: self.biases.specific_force + solution.fixed_rows::<3>(9),
            angular_velocity: self.biases.angular_velocity + solution.fixed_rows::<3>(12),
        };
        Some(Cost { square, rows: 6.0 * motions.len() as f64, biases })
    }

    /// Refines an offset by parabolas through candidates a step apart: closer ones differ by the
    /// noise of single readings. Returns offset, cost and curvature.
    fn refine(&self, start: f64) -> Option<(f64, Cost, f64)> {
        let (mut offset, h) = (start, STEP);
        let (mut best, mut curvature) = (self.cost(offset)?, 0.0);
        for _ in 0..3 {
            let (low, high) = (self.cost(offset - h)?, self.cost(offset + h)?);
            // With an image at the edge of the readings: the cost per degree of freedom.
            let (rows, freedom) = (best.rows, best.freedom());
            let [low, here, high] = if low.rows == rows && high.rows == rows {
                [low.square, best.square, high.square]
            } else {
                [&low, &best, &high].map(|cost| cost.mean() * freedom)
            };
            let bend = low + high - 2.0 * here;
            curvature = bend / (h * h);
            offset += (h * (low - high) / (2.0 * bend)).clamp(-h, h);
            if !(curvature > 0.0 && offset.is_finite()) {
                return None;
            }
            best = self.cost(offset)?;
        }
        Some((offset, best, curvature))
    }

    /// Images with the motion at their instants.
    fn motions(&self, offset: f64) -> Option<Vec<(&VisualPose, Preintegrated)>> {
        let motions: Vec<_> = (self.poses.iter())
            .filter_map(|p| Some((p, self.at(p.stamp.plus_seconds(offset))?)))
            .collect();
        (motions.len() >= FEWEST.max(self.poses.len() / 2)).then_some(motions)
    }

    /// First instant, and the attitude there by the middle image, to linearize at.
    fn start(
        &self,
        motions: &[(&VisualPose, Preintegrated)],
    ) -> Option<(Stamp, UnitQuaternion<f64>)> {
        let (pose, motion) = motions.get(motions.len() / 2)?;
        let imu_rotation = self.volant_from_imu.rotation;
        let start = pose.world_from_volant.rotation * imu_rotation * motion.rotation.inverse();
        Some((self.track.first()?.stamp, start))
    }

    /// Unknowns that fit rows of information, residual and derivative, and the squares that are
    /// left; `known` are the biases at which the rows are linearized.
    fn fit(
        &self,
        rows: impl Iterator<Item = (Matrix6<f64>, Vector6<f64>, Jacobian)>,
        known: &ImuReading,
    ) -> Option<(Unknowns, f64)> {
        let mut normal = Normal::zeros();
        let mut right = Unknowns::zeros();
        let mut square = 0.0;
        let bias = [self.imu.accelerometer_bias, self.imu.gyroscope_bias];
        let bias = bias.map(|sigma| sigma.max(SMALLEST_BIAS));
        let prior = [OPEN[0], OPEN[1], bias[0], bias[1]];
        for (k, sigma) in prior.into_iter().enumerate() {
            for i in 0..3 {
                let index = 3 * (k + 1) + i;
                normal[(index, index)] += 1.0 / (sigma * sigma);
            }
        }
        for (k, bias) in [known.specific_force, known.angular_velocity].iter().enumerate() {
            for i in 0..3 {
                let (index, weight) = (9 + 3 * k + i, prior[2 + k].powi(-2));
                right[index] -= bias[i] * weight;
                square += bias[i] * bias[i] * weight;
            }
        }
        for (information, residual, jacobian) in rows {
            let weighted = information * jacobian;
            normal += jacobian.transpose() * weighted;
            right += weighted.transpose() * residual;
            square += residual.dot(&(information * residual));
        }
        let solution = normal.cholesky()?.solve(&right);
        Some((solution, (square - right.dot(&solution)).max(0.0)))
    }

    /// Factor by which the variance of an offset exceeds what independent errors of the images
    /// leave: the IMU's noise adds up, and is common to all later images.
    fn excess(&self, offset: f64, noise: &Densities, scale: f64) -> Option<f64> {
        let motions = self.motions(offset)?;
        let start = self.start(&motions)?;
        // By a change of the offset: derivative of the residual, and that by the unknowns.
        let rows: Vec<_> = motions
            .iter()
            .filter_map(|(pose, motion)| {
                let at = |by: f64| self.at(pose.stamp.plus_seconds(offset + by));
                let (later, earlier) = (at(STEP)?, at(-STEP)?);
                let residual = |motion| self.row(&start, pose, motion).0;
                let by_offset = (residual(&later) - residual(&earlier)) / (2.0 * STEP);
                let (_, jacobian) = self.row(&start, pose, motion);
                Some((motion.stamp, pose.information, by_offset, jacobian))
            })
            .collect();
        let (solution, information) =
            self.fit(rows.iter().map(|(_, w, r, j)| (*w, *r, *j)), &ImuReading::default())?;
        // Backwards: what an error of each moves in all images behind it.
        let [mut turn, mut shift, mut speed, mut tilt] = [Vector3::zeros(); 4];
        let mut variance = 0.0;
        for (k, (at, weight, by_offset, jacobian)) in rows.iter().enumerate().rev() {
            if let Some((next, ..)) = rows.get(k + 1) {
                let dt = next.seconds_since(*at);
                tilt += speed * dt + shift * (dt * dt / 2.0);
                speed += shift * dt;
            }
            let share = weight * (by_offset - jacobian * solution);
            shift += share.fixed_rows::<3>(0);
            turn += share.fixed_rows::<3>(3);
            if let Some((before, ..)) = k.checked_sub(1).and_then(|k| rows.get(k)) {
                // A tilt turns the specific force, which is about gravity.
                let by_tilt = Vector3::new(-tilt.y, tilt.x, 0.0) * self.gravity;
                let (by_rate, by_force) = ((turn + by_tilt).norm_squared(), speed.norm_squared());
                let dt = at.seconds_since(*before);
                variance += dt * (noise.rate * by_rate + noise.force * by_force);
            }
        }
        Some(1.0 + variance / (information.max(f64::MIN_POSITIVE) * scale))
    }

    /// Residual of an image (position, rotation) and its derivative by p₀, v₀, θ₀, b_a, b_g.
    fn row(
        &self,
        (origin, start): &(Stamp, UnitQuaternion<f64>),
        pose: &VisualPose,
        motion: &Preintegrated,
    ) -> (Vector6<f64>, Jacobian) {
        let s = motion.stamp.seconds_since(*origin);
        let r0 = start.to_rotation_matrix();
        let r0 = r0.matrix();
        let world_from_imu = start * motion.rotation;
        let world_from_volant = world_from_imu * self.volant_from_imu.rotation.inverse();
        let lever = world_from_volant * self.volant_from_imu.translation.vector;
        let moved = start * motion.position;
        let position = moved - Vector3::z() * (self.gravity * s * s / 2.0) - lever;
        let rotation =
            (pose.world_from_volant.rotation * world_from_volant.inverse()).scaled_axis();
        let shift = pose.world_from_volant.translation.vector - position;
        let residual = Vector6::new(shift.x, shift.y, shift.z, rotation.x, rotation.y, rotation.z);
        let mut j = Jacobian::zeros();
        let by_gyroscope = r0 * motion.rotation_by_gyroscope;
        j.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
        j.fixed_view_mut::<3, 3>(0, 3).fill_diagonal(s);
        j.fixed_view_mut::<3, 3>(0, 6).copy_from(&(lever - moved).cross_matrix());
        j.fixed_view_mut::<3, 3>(0, 9).copy_from(&(r0 * motion.position_by[1]));
        j.fixed_view_mut::<3, 3>(0, 12)
            .copy_from(&(r0 * motion.position_by[0] + lever.cross_matrix() * by_gyroscope));
        j.fixed_view_mut::<3, 3>(3, 6).fill_with_identity();
        j.fixed_view_mut::<3, 3>(3, 12).copy_from(&by_gyroscope);
        (residual, j)
    }

    /// Motion at an instant between two readings.
    fn at(&self, stamp: Stamp) -> Option<Preintegrated> {
        let after = self.track.partition_point(|p| p.stamp <= stamp);
        let (before, next) = (self.track.get(after.checked_sub(1)?)?, self.track.get(after)?);
        let span = next.stamp.seconds_since(before.stamp);
        let share = stamp.seconds_since(before.stamp) / span;
        Some(before.to(stamp, &before.reading.lerp(&next.reading, share)))
    }
}
