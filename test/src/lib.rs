//! The simulated rig that feeds the real nodes, and what the end-to-end tests, the demo and the faults share.
//!
//! [`rig`] is the world: it moves, and what its camera, inertial unit and encoders say flows out, with the truth.

pub mod rig;
