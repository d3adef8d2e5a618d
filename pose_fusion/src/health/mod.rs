//! Health: trust in the encoders, recovery from contradictions, soundness of the state, and the
//! published status.

pub mod encoder_trust;
pub mod lock_out;
pub mod pose_status;
pub mod sanity;
pub mod status;
