//! How far an estimate is from the truth, and whether it knows.

use nalgebra::Isometry3;
use pose_fusion::{Fusion, Input, Odometry, Output, PoseEstimate};
use rig_model::Stamp;
pub use rig_model::score::{Nees, PoseError, Score, Truth};

/// The true pose at an instant.
pub fn pose_at(truth: &Truth, stamp: Stamp) -> Option<Isometry3<f64>> {
    Some(truth.at(stamp)?.world_from_volant)
}

/// The first stamp of the truth.
pub fn start(truth: &Truth) -> Stamp {
    truth.span().unwrap().0
}

/// All outputs of a filter for a series of inputs.
#[derive(Default)]
pub struct Outputs {
    pub odometry: Vec<Odometry>,
    pub visual: Vec<PoseEstimate>,
    pub records: Vec<pose_fusion::MarkerUpdateRecord>,
    pub warnings: Vec<pose_fusion::Warning>,
    pub status: Vec<pose_fusion::PoseStatus>,
    pub predicted: Vec<Odometry>,
}

pub fn run(fusion: &mut Fusion, inputs: impl IntoIterator<Item = Input>) -> Outputs {
    let mut outputs = Outputs::default();
    for input in inputs {
        fusion.handle(input);
        while let Some(output) = fusion.poll() {
            match output {
                Output::Odometry(o) => outputs.odometry.push(o),
                Output::VisualPose(p) => outputs.visual.push(p),
                Output::MarkerUpdate(r) => outputs.records.push(r),
                Output::Warning(w) => outputs.warnings.push(w),
                Output::Status(s) => outputs.status.push(s),
                Output::Predicted(o) => outputs.predicted.push(o),
                Output::Swing(_) => {}
            }
        }
    }
    outputs
}

/// The score of odometry from `from` seconds after the first truth on.
pub fn score(odometry: &[Odometry], truth: &Truth, from: f64) -> Score {
    let mut score = Score::default();
    for o in odometry {
        if o.stamp.seconds_since(start(truth)) < from {
            continue;
        }
        if let Some(pose) = pose_at(truth, o.stamp) {
            score.add(&o.world_from_volant, &o.pose_covariance, &pose);
        }
    }
    score
}
