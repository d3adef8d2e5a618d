//! The long run: laps of a live rig with faults at random from a seed; memory and threads must stay
//! flat, nothing may panic, no number may be none, no node may fall silent, and the covariance must
//! stay true.
//!
//! [`live`] runs rows of the fault table in real time on the four processes.

pub mod live;
mod memory;

pub use memory::{Instance, Instances};
