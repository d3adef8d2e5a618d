//! `volant calibrate`: what must be measured once before the rig can be used.
//!
//! Pictures and recordings flow in; a standard `camera_info` file, the markers' colours or a refined rig file flow out,
//! each with its uncertainties. What the data do not determine is refused, with what is missing.

pub mod camera;
pub mod pictures;
pub mod rig;
