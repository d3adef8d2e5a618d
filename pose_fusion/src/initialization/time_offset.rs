//! Search of the camera time offset: collects image poses and IMU readings, and aligns them
//! (`alignment.rs`) until the offset is known, with the sum of several windows (`windows.rs`) where
//! one does not suffice. Equations: `docs/src/equations.md`, "Initialization".

pub use super::alignment::{REACH, TimeOffset, WINDOW};
use super::{
    alignment::{FEWEST, VisualPose, align},
    windows::Windows,
};
use crate::{adaptation::imu_noise::Densities, config::ImuConfig, ekf::propagation::ImuReading};
use nalgebra::{Isometry3, Matrix6};
use rig_model::Stamp;
use std::collections::VecDeque;

/// Images closer together than this add nothing, s.
const SPACING: f64 = 0.024;
/// Number of images from one alignment to the next.
const EVERY: usize = 3;
/// Time from one alignment to the next, s, where none has given the offset for [`LONG`] s: a rig at
/// rest.
const SELDOM: f64 = 0.28;
const LONG: f64 = 10.0;
/// Floors of the visual pose: position, m, and rotation, rad …
const FLOOR: [f64; 2] = [0.4e-3, 1e-3];
/// … and what is left of the IMU's noise in the window when initial state and biases are fitted, as
/// shares of what it integrates to: force to position, rate to rotation, rate by the tilt to
/// position. Noise beyond the rig file's counts more: it is not white.
const IMU_SHARE: [f64; 3] = [0.2, 0.4, 0.04];
const G_SQUARED: f64 = 96.2;
const EXCESS_SHARE: [f64; 3] = [0.5, 0.8, 0.08];
/// The search ends with this standard deviation, s.
pub const FINAL: f64 = 0.002;

/// Collects image poses and IMU readings until the offset is known.
#[derive(Clone, Debug, Default)]
pub struct TimeOffsetSearch {
    poses: VecDeque<VisualPose>,
    readings: VecDeque<(Stamp, ImuReading)>,
    added: usize,
    /// First image, and that of the last alignment.
    began: Option<Stamp>,
    aligned: Option<Stamp>,
    windows: Windows,
    /// Since when all alignments have not refuted the estimated offset.
    agrees_since: Option<Stamp>,
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

    /// Adds the pose of an image (camera time; rotation about world axes; m², rad²).
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
        if self.poses.is_empty() {
            self.agrees_since = None;
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
        let of = |shares: [f64; 3], &Densities { force, rate }: &Densities| {
            let [by_force, by_rate, by_tilt] = shares.map(|share| share * share);
            let position =
                by_force * force * WINDOW.powi(3) + by_tilt * G_SQUARED * rate * WINDOW.powi(5);
            [position, by_rate * rate * WINDOW]
        };
        let usual = of(IMU_SHARE, given);
        let excess = of(EXCESS_SHARE, &noise.zip(given, |noise, given| (noise - given).max(0.0)));
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

    /// Returns for how long before the newest image no alignment has refuted the estimated
    /// offset, s.
    pub fn agrees_for(&self) -> f64 {
        let newest = self.poses.back().map(|pose| pose.stamp);
        newest.zip(self.agrees_since).map_or(0.0, |(newest, since)| newest.seconds_since(since))
    }

    /// Returns the offset once its standard deviation is below 10 ms. Aligns after every third
    /// image only, and every 0.3 s in a search that lasts. `gravity` is in m/s²; `noise` are the
    /// IMU's densities, `given` those of the rig file; `estimated` is the offset that the filter
    /// estimates, s.
    pub fn find(
        &mut self,
        estimated: f64,
        volant_from_imu: &Isometry3<f64>,
        gravity: f64,
        imu: &ImuConfig,
        noise: &Densities,
        given: &Densities,
    ) -> Option<TimeOffset> {
        if self.added < EVERY {
            return None;
        }
        let newest = self.poses.back()?.stamp;
        let since = |stamp: Stamp| newest.seconds_since(stamp);
        let lasts_long = since(*self.began.get_or_insert(newest)) > LONG;
        if lasts_long && self.aligned.is_some_and(|at| (0.0..SELDOM).contains(&since(at))) {
            return None;
        }
        (self.added, self.aligned) = (0, Some(newest));
        self.weigh(noise, given);
        let age = |pose: &VisualPose| newest.seconds_since(pose.stamp);
        let poses = self.poses.make_contiguous();
        let recent = &poses[poses.partition_point(|pose| age(pose) > WINDOW)..];
        if recent.len() < FEWEST {
            return None;
        }
        let settings = (volant_from_imu, gravity, imu, noise);
        // The second time with the biases of the first: they turn by several degrees.
        let first = align(recent, &self.readings, settings, &ImuReading::default())?;
        let aligned = align(recent, &self.readings, settings, &first.biases)?;
        if aligned.refutes(estimated) {
            self.agrees_since = None;
        } else {
            self.agrees_since.get_or_insert(newest);
        }
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
