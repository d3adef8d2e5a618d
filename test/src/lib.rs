//! The simulated rig that feeds the real nodes, and what the end-to-end tests, the demo and the faults share.
//!
//! [`rig`] is the world: it moves, and what its camera, inertial unit and encoders say flows out, with the truth.
//! [`live`] plays it to the four nodes, which run as processes of their own, [`hosts`] on two computers with a bad link; [`faults`]
//! breaks it; [`accuracy`] tells how far off they were,
//! [`report`] shows it. [`robustness`] changes recordings and compares the pose with the truth.

pub mod accuracy;
pub mod crowd;
pub mod faults;
pub mod hosts;
pub mod live;
pub mod paper;
pub mod report;
pub mod rig;
pub mod robustness;
pub mod soak;
