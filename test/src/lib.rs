//! The simulated rig that feeds the real nodes, and what the end-to-end tests, the demo and the
//! faults share.
//!
//! [`rig_simulator`] yields motion, sensor data and truth. [`live`] feeds the four nodes, which run
//! as processes of their own, [`hosts`] on two computers with an impaired link; [`faults`] breaks
//! it; [`accuracy`] computes errors, [`report`] shows them. [`robustness`] changes recordings and
//! compares the pose with the truth.
#![allow(missing_docs, reason = "not published: a comment stands where a name does not say it all")]

pub mod accuracy;
pub mod check;
pub mod faults;
pub mod hosts;
pub mod live;
pub mod paper;
pub mod report;
pub mod robustness;
pub mod run_folder;
pub mod soak;
