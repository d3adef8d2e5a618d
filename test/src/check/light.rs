//! The light check that `pose_fusion` runs, over a recording.

use pose_fusion::{Fusion, FusionConfig, Input, Output, RigCheck};
use rig_simulator::recording::Recording;

/// Time between two looks at the findings, as in the node, s.
const PERIOD: f64 = 1.0;

/// Returns the newest findings that the node would report in `/diagnostics`; empty where there are
/// none during the whole recording.
pub fn findings_while_running(recording: &Recording) -> Vec<String> {
    let mut fusion = Fusion::new(recording.rig.clone(), FusionConfig::default());
    let (mut check, mut newest, mut last) = (RigCheck::default(), Vec::new(), None);
    for (at, input) in &recording.inputs {
        if let Input::Camera(_) = input {
            check.note_camera();
        }
        fusion.handle(input.clone());
        while let Some(output) = fusion.poll() {
            if let Output::MarkerUpdates(image) = output {
                check.note(&image);
            }
        }
        if at.seconds_since(*last.get_or_insert(*at)) >= PERIOD {
            last = Some(*at);
            let status = fusion.status();
            let mut findings = check.findings(&status);
            if !findings.is_empty() && !status.initialized {
                findings.push(format!("not initialized: {}", fusion.missing()));
            }
            if !findings.is_empty() {
                newest = findings;
            }
        }
    }
    newest
}
