//! Health: trust in the encoders, recovery from contradictions, soundness of the state, the
//! light check of the rig file, and the published status.

pub mod contradiction_monitor;
pub mod encoder_directions;
pub mod encoder_trust;
pub mod pose_status;
pub mod rig_check;
pub mod rig_evidence;
pub mod sanity;
pub mod status;
