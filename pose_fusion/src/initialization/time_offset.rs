//! Camera time offset by aligning the visual poses of single images with the motion that the IMU
//! measured.
//!
//! An error-state filter corrects its time offset well while it is off by a few milliseconds, and
//! loses its way where it is off by more than an image period. So the offset is first found by a
//! batch alignment. For a candidate offset τ the image stamped `t` was taken at `t + τ` on the
//! IMU's time line; there the IMU's motion is known but for its initial position, velocity and
//! attitude and the biases (15 numbers), which enter linearly:
//!
//! `R_i = Exp(θ₀ + R₀ J_R b_g) R₀ ΔR_i`,
//! `p_i = p₀ + v₀ s + g s²/2 + R₀ (Δp_i + J_p b) + [θ₀]× R₀ Δp_i − R_i t`
//!
//! (`t`: lever arm). The weighted squares that are left, `J(τ)`, have their minimum at the offset.
//! It is accepted where the curvature says that it is known and every other minimum is refuted;
//! where one window does not suffice, the costs of several are added up. Without motion `J` is flat
//! and nothing is accepted. The image poses come on the climber's clock, which is the camera's, so
//! that nothing else depends on τ.

use super::preintegration::Preintegrated;
use crate::{adaptation::imu_noise::Densities, config::ImuConfig, ekf::propagation::ImuReading};
use nalgebra::{Isometry3, Matrix6, SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use rig_model::Stamp;
use std::collections::VecDeque;

/// Largest offset that is looked for, s.
pub const REACH: f64 = 0.3;
/// An offset that is closer to the end of the candidates, s, is not a minimum.
const EDGE: f64 = 0.003;
/// Distance of the candidates, s.
const STEP: f64 = 0.01;
/// Number of candidates.
const CANDIDATES: usize = 61;
/// The newest image poses of this time are aligned, s: longer, and the IMU's scale errors count.
pub const WINDOW: f64 = 1.5;
/// Images closer together than this add nothing, s.
const SPACING: f64 = 0.024;
/// Fewest images of an alignment.
const FEWEST: usize = 12;
/// Number of images from one alignment to the next.
const EVERY: usize = 3;
/// Floors of the visual pose: position, m, and rotation, rad …
const FLOOR: [f64; 2] = [0.4e-3, 1e-3];
/// … and what is left of the IMU's noise in the window when initial state and biases are fitted, as
/// shares of what it integrates to: specific force to position, angular velocity to rotation,
/// angular velocity by the tilt to position. Noise beyond the rig file's counts more: it is not
/// white, and one error of the window is as good as none.
const IMU_SHARE: [f64; 3] = [0.2, 0.4, 0.04];
const G_SQUARED: f64 = 96.2;
const EXCESS_SHARE: [f64; 3] = [0.5, 0.8, 0.08];
/// Largest standard deviation of an offset that is returned, s.
const ACCEPTED: f64 = 0.010;
/// The search ends with this standard deviation, s.
pub const FINAL: f64 = 0.002;
/// Every other candidate further away than this, s …
const APART: f64 = 0.02;
/// … must fit worse by this (χ²).
const REFUTED: f64 = 16.0;
/// Largest χ² per degree of freedom of an alignment that means anything.
const LARGEST: f64 = 1.2;
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

#[derive(Clone, Copy, Debug)]
struct VisualPose {
    stamp: Stamp,
    world_from_volant: Isometry3<f64>,
    covariance: Matrix6<f64>,
    /// Inverse covariance, the IMU's noise included; of the alignment that runs.
    information: Matrix6<f64>,
}

/// Collects image poses and IMU readings until the offset is known.
#[derive(Clone, Debug, Default)]
pub struct TimeOffsetSearch {
    poses: VecDeque<VisualPose>,
    readings: VecDeque<(Stamp, ImuReading)>,
    added: usize,
    windows: Windows,
}

/// Costs of the candidates, added up over windows that do not overlap.
#[derive(Clone, Debug, Default)]
struct Windows {
    /// χ² of each candidate above the best of its window.
    costs: Option<[f64; CANDIDATES]>,
    /// Newest image of the last window.
    until: Option<Stamp>,
}

impl Windows {
    /// Returns whether a window is due with the image at `newest`: it begins behind the last one.
    fn is_due(&mut self, newest: Stamp) -> bool {
        let until = *self.until.get_or_insert(newest);
        let due = newest.seconds_since(until) >= WINDOW;
        if due {
            self.until = Some(newest);
        }
        due
    }

    /// Adds a window.
    fn add(&mut self, aligned: &Aligned) {
        if aligned.scale < LARGEST {
            let sum = self.costs.get_or_insert([0.0; CANDIDATES]);
            sum.iter_mut().zip(&aligned.costs).for_each(|(sum, cost)| *sum += cost);
        }
    }

    /// Returns the offset, where all windows together show it.
    fn offset(&self) -> Option<TimeOffset> {
        let costs = self.costs.as_ref()?;
        let best = (0..CANDIDATES).min_by(|&a, &b| costs[a].total_cmp(&costs[b]))?;
        let (low, high) = (costs.get(best.checked_sub(1)?)?, costs.get(best + 1)?);
        let curvature = low + high - 2.0 * costs[best];
        let offset = candidate(best) + STEP * (low - high) / (2.0 * curvature);
        let sigma = STEP * (2.0 / curvature).sqrt();
        let refuted = (0..CANDIDATES)
            .filter(|&i| (candidate(i) - offset).abs() > apart(sigma) && !costs[i].is_nan())
            .all(|i| costs[i] - costs[best] > REFUTED);
        (sigma < ACCEPTED && refuted).then_some(TimeOffset { offset, sigma })
    }
}

/// Offset of a candidate, s.
fn candidate(index: usize) -> f64 {
    index as f64 * STEP - REACH
}

/// Distance from an offset of this standard deviation from which on candidates must be refuted, s.
fn apart(sigma: f64) -> f64 {
    APART.max(REFUTED.sqrt() * sigma)
}

/// What the alignment of a window found.
struct Aligned {
    /// Best offset, where it is known.
    found: Option<TimeOffset>,
    /// Biases that go with it.
    biases: Biases,
    /// χ² per degree of freedom.
    scale: f64,
    /// χ² of each candidate above the best, in units of what noise leaves; NaN where the readings
    /// do not reach.
    costs: [f64; CANDIDATES],
}

impl TimeOffsetSearch {
    /// Adds an IMU reading that is newer than those before.
    pub fn add_reading(&mut self, stamp: Stamp, reading: &ImuReading) {
        let oldest = stamp.plus_seconds(-(WINDOW + 2.0 * REACH + 0.2));
        while self.readings.front().is_some_and(|(at, _)| *at < oldest) {
            self.readings.pop_front();
        }
        self.readings.push_back((stamp, *reading));
    }

    /// Adds the pose of an image (camera time; covariance of position and rotation about world
    /// axes; m², rad²).
    pub fn add_pose(
        &mut self,
        stamp: Stamp,
        world_from_volant: &Isometry3<f64>,
        covariance: &Matrix6<f64>,
    ) {
        if self.poses.back().is_some_and(|p| stamp.seconds_since(p.stamp) < SPACING) {
            return;
        }
        while self.poses.front().is_some_and(|p| stamp.seconds_since(p.stamp) > WINDOW + REACH) {
            self.poses.pop_front();
        }
        self.poses.push_back(VisualPose {
            stamp,
            world_from_volant: *world_from_volant,
            covariance: *covariance,
            information: Matrix6::zeros(),
        });
        self.added += 1;
    }

    /// Weighs the poses with the IMU's noise as it is known now.
    fn weigh(&mut self, noise: &Densities, given: &Densities) {
        let of = |shares: [f64; 3], force: f64, rate: f64| {
            let [by_force, by_rate, by_tilt] = shares.map(|share| share * share);
            let position =
                by_force * force * WINDOW.powi(3) + by_tilt * G_SQUARED * rate * WINDOW.powi(5);
            [position, by_rate * rate * WINDOW]
        };
        let usual = of(IMU_SHARE, given.force, given.rate);
        let excess = of(
            EXCESS_SHARE,
            (noise.force - given.force).max(0.0),
            (noise.rate - given.rate).max(0.0),
        );
        let imu = [usual[0] + excess[0], usual[1] + excess[1]];
        for pose in &mut self.poses {
            let mut covariance = pose.covariance;
            for i in 0..6 {
                covariance[(i, i)] += FLOOR[i / 3].powi(2) + imu[i / 3];
            }
            pose.information = covariance.try_inverse().unwrap_or_else(Matrix6::zeros);
        }
    }

    /// Discards everything: image poses or readings are wrong.
    pub fn clear(&mut self) {
        *self = Self::default();
    }

    /// Returns the offset once it is known to 10 ms. Aligns after every third image only.
    ///
    /// `volant_from_imu` is the mounting of the IMU, `gravity` in m/s², `noise` the IMU's noise
    /// densities and `given` those of the rig file.
    pub fn find(
        &mut self,
        volant_from_imu: &Isometry3<f64>,
        gravity: f64,
        imu: &ImuConfig,
        noise: &Densities,
        given: &Densities,
    ) -> Option<TimeOffset> {
        if self.added < EVERY {
            return None;
        }
        self.added = 0;
        self.weigh(noise, given);
        let newest = self.poses.back()?.stamp;
        let age = |pose: &VisualPose| newest.seconds_since(pose.stamp);
        let poses = self.poses.make_contiguous();
        let recent = &poses[poses.partition_point(|pose| age(pose) > WINDOW)..];
        if recent.len() < FEWEST {
            return None;
        }
        let settings = (volant_from_imu, gravity, imu, noise);
        // The second time with the biases that the first one found: over the window they turn by
        // several degrees.
        let first = align(recent, &self.readings, settings, &Biases::default())?;
        let aligned = align(recent, &self.readings, settings, &first.biases)?;
        // A window in which every image counts for every candidate.
        let covered = &poses[..poses.partition_point(|pose| age(pose) >= REACH)];
        if self.windows.is_due(newest)
            && covered.len() >= FEWEST
            && let Some(window) = align(covered, &self.readings, settings, &first.biases)
        {
            self.windows.add(&window);
        }
        let of_all = self.windows.offset();
        [aligned.found, of_all].into_iter().flatten().min_by(|a, b| a.sigma.total_cmp(&b.sigma))
    }
}

/// `volant_from_imu`, gravity (m/s²), errors of the IMU and its noise.
type Settings<'a> = (&'a Isometry3<f64>, f64, &'a ImuConfig, &'a Densities);

/// Aligns image poses with the IMU's motion, linearized at `biases`.
fn align(
    poses: &[VisualPose],
    readings: &VecDeque<(Stamp, ImuReading)>,
    (volant_from_imu, gravity, imu, noise): Settings<'_>,
    biases: &Biases,
) -> Option<Aligned> {
    let track = preintegrate(readings, biases);
    let alignment = Alignment { track: &track, poses, volant_from_imu, gravity, imu, biases };
    let costs: [Option<Cost>; CANDIDATES] = std::array::from_fn(|i| alignment.cost(candidate(i)));
    let usable = costs.iter().enumerate().filter_map(|(i, cost)| Some((i, cost.as_ref()?)));
    let (start, coarse) = usable.min_by(|a, b| a.1.mean().total_cmp(&b.1.mean()))?;
    let refined = alignment.refine(candidate(start));
    let (offset, best, curvature) = refined.unwrap_or((candidate(start), *coarse, 0.0));
    let scale = (best.square / (best.rows - UNKNOWNS as f64).max(1.0)).max(SMALLEST);
    let unit = scale * alignment.excess(offset, noise, scale)?;
    let costs = costs.map(|cost| match cost {
        Some(cost) => (cost.mean() - best.mean()) * best.rows.min(cost.rows) / unit,
        None => f64::NAN,
    });
    let sigma = (2.0 * unit / curvature).sqrt();
    let refuted = (costs.iter().enumerate())
        .filter(|(i, cost)| (candidate(*i) - offset).abs() > apart(sigma) && !cost.is_nan())
        .all(|(_, cost)| *cost > REFUTED);
    let known = curvature > 0.0 && sigma < ACCEPTED && refuted && offset.abs() < REACH - EDGE;
    Some(Aligned {
        found: (known && scale < LARGEST).then_some(TimeOffset { offset, sigma }),
        biases: best.biases,
        scale,
        costs,
    })
}

/// Motion from reading to reading, without the biases.
fn preintegrate(readings: &VecDeque<(Stamp, ImuReading)>, biases: &Biases) -> Vec<Preintegrated> {
    let mut track: Vec<Preintegrated> = Vec::with_capacity(readings.len());
    for (stamp, reading) in readings {
        let reading = &ImuReading {
            specific_force: reading.specific_force - biases.accelerometer,
            angular_velocity: reading.angular_velocity - biases.gyroscope,
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
    biases: Biases,
}

impl Cost {
    fn mean(&self) -> f64 {
        self.square / self.rows
    }
}

/// Biases of the IMU, its axes: m/s², rad/s.
#[derive(Clone, Copy, Debug, Default)]
struct Biases {
    accelerometer: Vector3<f64>,
    gyroscope: Vector3<f64>,
}

struct Alignment<'a> {
    track: &'a [Preintegrated],
    poses: &'a [VisualPose],
    volant_from_imu: &'a Isometry3<f64>,
    gravity: f64,
    imu: &'a ImuConfig,
    biases: &'a Biases,
}

impl Alignment<'_> {
    /// Cost of an offset; `None` where fewer than half of the images (and [`FEWEST`]) have IMU
    /// readings around them.
    fn cost(&self, offset: f64) -> Option<Cost> {
        let motions = self.motions(offset)?;
        let (first, start) = self.origin(&motions)?;
        let rows = motions.iter().map(|(pose, motion)| {
            let (residual, jacobian) = self.row(&start, first, pose, motion);
            (pose.information, residual, jacobian)
        });
        let (solution, square) = self.fit(rows, self.biases)?;
        let biases = Biases {
            accelerometer: self.biases.accelerometer + solution.fixed_rows::<3>(9),
            gyroscope: self.biases.gyroscope + solution.fixed_rows::<3>(12),
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
            // With an image at the edge of the readings: the mean cost per row.
            let rows = best.rows;
            let [low, here, high] = if low.rows == rows && high.rows == rows {
                [low.square, best.square, high.square]
            } else {
                [&low, &best, &high].map(|cost| cost.mean() * rows)
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

    /// First instant, and the attitude there at which the fit is linearized: that which the image in
    /// the middle gives.
    fn origin(
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
        known: &Biases,
    ) -> Option<(Unknowns, f64)> {
        let mut normal = Normal::zeros();
        let mut right = Unknowns::zeros();
        let mut square = 0.0;
        let prior = [OPEN[0], OPEN[1], self.imu.accelerometer_bias, self.imu.gyroscope_bias];
        for (k, sigma) in prior.into_iter().enumerate() {
            for i in 0..3 {
                let index = 3 * (k + 1) + i;
                normal[(index, index)] += 1.0 / (sigma * sigma);
            }
        }
        for (k, bias) in [known.accelerometer, known.gyroscope].iter().enumerate() {
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

    /// Factor by which the variance of an offset exceeds what independent errors of the images leave.
    ///
    /// The IMU's noise adds up: the error of the attitude (a random walk), and the velocity and
    /// position that follow from it, are common to all later images, and many images do not average
    /// them. The offset of a least-squares fit is a weighted sum of the images' errors; the weights
    /// tell what each step's noise contributes.
    fn excess(&self, offset: f64, noise: &Densities, scale: f64) -> Option<f64> {
        let motions = self.motions(offset)?;
        let (first, start) = self.origin(&motions)?;
        // By a change of the offset: derivative of the residual, and that by the unknowns.
        let rows: Vec<_> = motions
            .iter()
            .filter_map(|(pose, motion)| {
                let at = |by: f64| self.at(pose.stamp.plus_seconds(offset + by));
                let (later, earlier) = (at(STEP)?, at(-STEP)?);
                let residual = |motion| self.row(&start, first, pose, motion).0;
                let by_offset = (residual(&later) - residual(&earlier)) / (2.0 * STEP);
                let (_, jacobian) = self.row(&start, first, pose, motion);
                Some((motion.stamp, pose.information, by_offset, jacobian))
            })
            .collect();
        let (solution, information) =
            self.fit(rows.iter().map(|(_, w, r, j)| (*w, *r, *j)), &Biases::default())?;
        // Backwards: what an error of attitude, position, velocity and tilt moves in all images
        // behind it.
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
        start: &UnitQuaternion<f64>,
        origin: Stamp,
        pose: &VisualPose,
        motion: &Preintegrated,
    ) -> (Vector6<f64>, SMatrix<f64, 6, UNKNOWNS>) {
        let s = motion.stamp.seconds_since(origin);
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
        let mut j = SMatrix::<f64, 6, UNKNOWNS>::zeros();
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A window whose cost is a parabola about `offset` with the standard deviation `sigma`, s.
    fn window(offset: f64, sigma: f64, scale: f64) -> Aligned {
        let costs = std::array::from_fn(|i| ((candidate(i) - offset) / sigma).powi(2));
        Aligned { found: None, biases: Biases::default(), scale, costs }
    }

    #[test]
    fn windows_that_do_not_suffice_one_by_one_do_together() {
        let mut windows = Windows::default();
        for (k, offset) in [0.052, 0.038, 0.049, 0.041].into_iter().enumerate() {
            assert_eq!(windows.offset().is_some(), k > 2, "{k}");
            windows.add(&window(offset, 0.015, 1.0));
        }
        let found = windows.offset().unwrap();
        assert!((found.offset - 0.045).abs() < 1e-6, "{found:?}");
        assert!((found.sigma - 0.0075).abs() < 1e-6, "{found:?}");
    }

    #[test]
    fn flat_costs_bad_fits_and_two_minima_give_no_offset() {
        // At rest; a bad fit; a minimum beyond the candidates; two minima that fit alike.
        let flat = window(0.0, 1.0, 1.0);
        let bad = window(0.05, 0.002, 1.3);
        let beyond = window(0.31, 0.005, 1.0);
        let mut two = window(-0.1, 0.005, 1.0);
        for i in 0..CANDIDATES {
            two.costs[i] = two.costs[i].min(window(0.1, 0.005, 1.0).costs[i] + 10.0);
        }
        // Readings that do not reach some candidates.
        let mut short = window(0.29, 0.005, 1.0);
        short.costs[CANDIDATES - 1] = f64::NAN;
        for (name, wrong) in
            [("flat", flat), ("bad", bad), ("beyond", beyond), ("two", two), ("short", short)]
        {
            let mut windows = Windows::default();
            windows.add(&wrong);
            assert_eq!(windows.offset(), None, "{name}");
        }
    }

    #[test]
    fn windows_do_not_overlap() {
        let mut windows = Windows::default();
        let due: Vec<i64> =
            (0..100).filter(|k| windows.is_due(Stamp::from_nanos(k * 100_000_000))).collect();
        assert_eq!(due, [15, 30, 45, 60, 75, 90]);
    }
}
