//! Calibration of the rig from a recording: mountings of camera and IMU, and marker positions,
//! refined together by bundle adjustment with uncertainties. The platform swings freely, so images
//! alone do not determine the rig: gravity, the IMU between the images, and the encoders do.
//! Parameters that a recording's motion does not determine keep their values and are reported.
//!
//! [`check`] compares the files with a recording and names what is wrong.
//!
//! No middleware, file or image: the caller reads a recording into [`Samples`].

mod adjustment;
pub mod allan;
mod arrow;
mod check;
pub mod climber;
mod error;
mod estimate;
mod inertial;
mod initial;
mod parameters;
mod problem;
mod recording;

pub use check::{
    CheckRow, Configured, Finding, MISFIT, Report, Track, Verdict, check, examine_stamps,
};
pub use error::CalibrationError;
pub use estimate::{Estimate, Refinement, Row, refine_rig};
pub use recording::Samples;
