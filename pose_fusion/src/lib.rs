//! Fuses marker pixels, IMU samples and the climber's encoders to the pose of the platform.
//!
//! [`Fusion::handle`] takes each input in the order of arrival, [`Fusion::poll`] returns what
//! follows from it. Time comes with the data; nothing in the core reads a clock, logs, sleeps or
//! panics.
//!
//! [`filter`] is the tightly coupled error-state filter (the default), [`mod@reference`] the
//! published filter and the pose from one image alone. The ROS 2 node is in `node`
//! (feature `node`).

mod adaptation;
pub mod config;
pub mod ekf;
mod estimator;
pub mod filter;
mod health;
mod initialization;
mod input;
pub mod measurements;
#[cfg(feature = "node")]
pub mod node;
mod output;
#[cfg(feature = "node")]
pub mod parameters;
pub mod reference;
#[cfg(feature = "node")]
pub mod services;
pub mod timeline;

pub use config::{FusionConfig, Model, PaperConfig, PaperMeasurement, PendulumConfig, TightConfig};
pub use estimator::{Fusion, Input};
pub use health::{
    pose_status::{PoseState, PoseStatus},
    rig_check::RigCheck,
    status::Status,
};
pub use initialization::checkpoint::{Checkpoint, Refusal};
pub use measurements::Outcome;
#[cfg(feature = "messages")]
pub use output::messages;
pub use output::{MarkerUpdates, Odometry, Output, PoseEstimate, Swing, Warning};
pub use timeline::arrival::Source;
