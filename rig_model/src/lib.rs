//! What the rig *is*, as plain data and pure functions: the one vocabulary in which the drivers, the tracker,
//! the filter and the tools speak to each other.
//!
//! In flow the rig file ([`rig`], ROS 2 parameter YAML through [`parameters`]) and `CameraInfo` ([`camera`]);
//! out flow typed frames, stamps, samples and the projection of the markers. No middleware, clock, thread,
//! file or device is in here.
//!
//! Conventions: metres, radians, seconds, pixels; right-handed frames (REP-103). `a_from_b` maps a point's
//! coordinates in `b` to its coordinates in `a` (the paper's `aTb`). The centre of the top left pixel is (0, 0).

pub mod calibration_file;
pub mod camera;
pub mod marker;
pub mod parameters;
pub mod planar_pose;
pub mod rig;
pub mod samples;
pub mod stamp;
pub mod yaml;

pub use calibration_file::CalibrationFileError;
pub use camera::{CameraModel, CameraModelError, Distortion};
pub use marker::{MarkerColor, MarkerLayout, PerColor};
pub use rig::{Frames, ImuMounting, Rig, RigError};
pub use samples::{
    ClimberSample, ImuSample, MarkerObservation, MarkerObservations, MarkerState, OrientationSample,
};
pub use stamp::Stamp;
