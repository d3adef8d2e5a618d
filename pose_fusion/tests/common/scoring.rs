//! How far an estimate is from the truth, and whether it knows.

use pose_fusion::{Fusion, FusionConfig, Input, Odometry, Output, PoseEstimate, Swing};
use rig_model::Stamp;
pub use rig_model::score::{Nees, PoseError, Score, Truth};
use std::collections::BTreeSet;

/// All outputs of a filter for a series of inputs.
#[derive(Default)]
pub struct Outputs {
    pub odometry: Vec<Odometry>,
    pub visual: Vec<PoseEstimate>,
    pub images: Vec<pose_fusion::MarkerUpdates>,
    pub warnings: Vec<pose_fusion::Warning>,
    pub status: Vec<pose_fusion::PoseStatus>,
    pub predicted: Vec<Odometry>,
    pub swing: Vec<Swing>,
}

impl Outputs {
    /// The records of all markers of all images.
    pub fn records(&self) -> impl Iterator<Item = &pose_fusion::measurements::Innovation<2>> {
        self.images.iter().flat_map(|image| &image.markers.0)
    }

    /// The odometry whose status says that it may be used.
    pub fn valid(&self) -> Vec<Odometry> {
        let valid = self.status.iter().filter(|status| status.valid);
        let valid: BTreeSet<Stamp> = valid.map(|status| status.stamp).collect();
        self.odometry.iter().filter(|o| valid.contains(&o.stamp)).cloned().collect()
    }
}

pub fn run(fusion: &mut Fusion, inputs: impl IntoIterator<Item = Input>) -> Outputs {
    let mut outputs = Outputs::default();
    for input in inputs {
        fusion.handle(input);
        while let Some(output) = fusion.poll() {
            match output {
                Output::Odometry(o) => outputs.odometry.push(o),
                Output::VisualPose(p) => outputs.visual.push(p),
                Output::MarkerUpdates(image) => outputs.images.push(image),
                Output::Warning(w) => outputs.warnings.push(w),
                Output::Status(s) => outputs.status.push(s),
                Output::Predicted(o) => outputs.predicted.push(o),
                Output::Swing(s) => outputs.swing.push(s),
            }
        }
    }
    outputs
}

/// A new filter of the simulated rig after a series of inputs, and all its outputs.
pub fn follow(config: FusionConfig, inputs: impl IntoIterator<Item = Input>) -> (Fusion, Outputs) {
    let mut fusion = Fusion::new(super::simulated::rig(), config);
    let outputs = run(&mut fusion, inputs);
    (fusion, outputs)
}

/// The score of odometry from `from` seconds after the first truth on.
pub fn score(odometry: &[Odometry], truth: &Truth, from: f64) -> Score {
    let (start, _) = truth.span().unwrap();
    let mut score = Score::default();
    for o in odometry.iter().filter(|o| o.stamp.seconds_since(start) >= from) {
        if let Some(truth) = truth.at(o.stamp) {
            score.add(&o.world_from_volant, &o.pose_covariance, &truth.world_from_volant);
        }
    }
    score
}

/// Errors of odometry and their NEES (position, rotation), with the time since the epoch, s.
pub fn errors(
    odometry: &[Odometry],
    truth: &Truth,
) -> impl Iterator<Item = (f64, PoseError, [f64; 2])> {
    let epoch = rig_simulator::inertial::SensorConfig::nominal(0).epoch;
    odometry.iter().filter_map(move |o| {
        let error = PoseError::new(&o.world_from_volant, &truth.at(o.stamp)?.world_from_volant);
        let nees = Nees::pair(&error, &o.pose_covariance);
        Some((o.stamp.seconds_since(epoch), error, nees))
    })
}

/// Share of the odometry beyond the gate (position, rotation) and last errors (m, rad).
pub fn judge(
    outputs: &Outputs,
    run: &super::simulated::Run,
    from: f64,
    to: f64,
) -> (f64, f64, f64, f64) {
    let (mut count, mut beyond, mut last) = (0.0, [0.0; 2], (0.0, 0.0));
    let errors = errors(&outputs.odometry, &run.truth);
    for (_, error, nees) in errors.filter(|(t, ..)| (from..to).contains(t)) {
        count += 1.0;
        for (k, nees) in nees.into_iter().enumerate() {
            beyond[k] += f64::from(u8::from(nees > super::laps::BEYOND));
        }
        last = (error.position.norm(), error.rotation.norm());
    }
    assert!(count > 0.0, "no output");
    (beyond[0] / count, beyond[1] / count, last.0, last.1)
}
