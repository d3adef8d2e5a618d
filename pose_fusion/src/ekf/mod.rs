//! The error-state extended Kalman filter: state, propagation with inertial readings, and updates.

pub mod calibration;
pub mod consider;
pub mod propagation;
pub mod state;
mod transition;
pub mod update;
