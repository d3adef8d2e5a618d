//! How far an estimate is from the truth, and whether it knows.

use nalgebra::{Isometry3, Vector3, Vector6};
use pose_fusion::{Fusion, Input, Odometry, Output, PoseEstimate};
use rig_model::Stamp;

/// The truth at an instant.
pub struct Truth {
    pub stamp: Stamp,
    pub pose: Isometry3<f64>,
    /// Volant axes.
    pub velocity: Vector3<f64>,
}

/// The true pose at an instant, between two truths.
pub fn pose_at(truth: &[Truth], stamp: Stamp) -> Option<Isometry3<f64>> {
    let after = truth.partition_point(|t| t.stamp < stamp);
    let (a, b) = (truth.get(after.checked_sub(1)?)?, truth.get(after)?);
    let share = stamp.seconds_since(a.stamp) / b.stamp.seconds_since(a.stamp);
    Some(a.pose.lerp_slerp(&b.pose, share))
}

/// The errors of a series of estimates.
#[derive(Clone, Debug, Default)]
pub struct Score {
    pub count: usize,
    position2: f64,
    rotation2: f64,
    pub position_max: f64,
    pub rotation_max: f64,
    position_nees: f64,
    rotation_nees: f64,
}

impl Score {
    pub fn add(
        &mut self,
        estimate: &Isometry3<f64>,
        covariance: &nalgebra::Matrix6<f64>,
        truth: &Isometry3<f64>,
    ) {
        let (p, r) = errors(estimate, truth);
        self.count += 1;
        self.position2 += p.norm_squared();
        self.rotation2 += r.norm_squared();
        self.position_max = self.position_max.max(p.norm());
        self.rotation_max = self.rotation_max.max(r.norm());
        let nees = |e: Vector3<f64>, first: usize| {
            let c = covariance.fixed_view::<3, 3>(first, first).into_owned();
            c.cholesky().map_or(f64::INFINITY, |c| e.dot(&c.solve(&e)))
        };
        self.position_nees += nees(p, 0);
        self.rotation_nees += nees(r, 3);
    }

    /// mm
    pub fn position_rmse(&self) -> f64 {
        (self.position2 / self.count as f64).sqrt() * 1e3
    }

    /// degrees
    pub fn rotation_rmse(&self) -> f64 {
        (self.rotation2 / self.count as f64).sqrt().to_degrees()
    }

    pub fn nees(&self) -> (f64, f64) {
        (self.position_nees / self.count as f64, self.rotation_nees / self.count as f64)
    }
}

impl std::fmt::Display for Score {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (np, nr) = self.nees();
        write!(
            f,
            "{:5} poses  {:7.3} mm (max {:7.2})  {:6.4}° (max {:6.3})  NEES {np:5.2} {nr:5.2}",
            self.count,
            self.position_rmse(),
            self.position_max * 1e3,
            self.rotation_rmse(),
            self.rotation_max.to_degrees(),
        )
    }
}

/// Position (world, m) and rotation (about world-fixed axes, rad) by which `estimate` is off.
pub fn errors(estimate: &Isometry3<f64>, truth: &Isometry3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    (
        truth.translation.vector - estimate.translation.vector,
        (truth.rotation * estimate.rotation.inverse()).scaled_axis(),
    )
}

pub fn error6(estimate: &Isometry3<f64>, truth: &Isometry3<f64>) -> Vector6<f64> {
    let (p, r) = errors(estimate, truth);
    Vector6::new(p.x, p.y, p.z, r.x, r.y, r.z)
}

/// Everything that a filter said of a series of inputs.
#[derive(Default)]
pub struct Said {
    pub odometry: Vec<Odometry>,
    pub visual: Vec<PoseEstimate>,
    pub records: Vec<pose_fusion::MarkerUpdateRecord>,
    pub warnings: Vec<pose_fusion::Warning>,
    pub status: Vec<pose_fusion::PoseStatus>,
    pub predicted: Vec<Odometry>,
}

pub fn run(fusion: &mut Fusion, inputs: impl IntoIterator<Item = Input>) -> Said {
    let mut said = Said::default();
    for input in inputs {
        fusion.handle(input);
        while let Some(output) = fusion.poll() {
            match output {
                Output::Odometry(o) => said.odometry.push(o),
                Output::VisualPose(p) => said.visual.push(p),
                Output::MarkerUpdate(r) => said.records.push(r),
                Output::Warning(w) => said.warnings.push(w),
                Output::Status(s) => said.status.push(s),
                Output::Predicted(o) => said.predicted.push(o),
            }
        }
    }
    said
}

/// The score of odometry from `from` seconds after the first truth on.
pub fn score(odometry: &[Odometry], truth: &[Truth], from: f64) -> Score {
    let mut score = Score::default();
    for o in odometry {
        if o.stamp.seconds_since(truth[0].stamp) < from {
            continue;
        }
        if let Some(pose) = pose_at(truth, o.stamp) {
            score.add(&o.world_from_volant, &o.pose_covariance, &pose);
        }
    }
    score
}
