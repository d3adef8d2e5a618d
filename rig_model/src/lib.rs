//! Description of the rig as plain data and pure functions, shared by drivers, tracker, filter and
//! tools.
//!
//! Units are meters, radians, seconds and pixels; frames are right-handed (REP-103). `a_from_b`
//! maps the coordinates of a point in `b` to its coordinates in `a` (the paper's `aTb`). The center
//! of the top left pixel is (0, 0). Nothing here uses middleware, clocks, threads, files or
//! devices.

pub mod angle;
pub mod calibration_file;
pub mod camera;
pub mod marker;
mod median;
pub mod planar_pose;
pub mod rig;
pub mod samples;
pub mod score;
pub mod stamp;
pub mod topics;

pub use angle::wrap_angle;
pub use calibration_file::CalibrationFileError;
pub use camera::{CameraModel, CameraModelError, Distortion};
pub use marker::{MarkerColor, MarkerLayout, PerColor};
pub use median::median;
pub use rig::{Frames, ImuMounting, Rig, RigError};
pub use samples::{
    ClimberSample, ImuSample, JointReading, MarkerObservation, MarkerObservations, MarkerState,
    OrientationSample, Sample,
};
pub use stamp::Stamp;
