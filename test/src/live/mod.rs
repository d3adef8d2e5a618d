//! The simulated rig, live: four real nodes as processes of their own, and hardware that is not there.
//!
//! [`Film`] is what the camera will see, taken beforehand; [`Hardware`] plays it on the image topic at its time, beside an
//! inertial unit on a pty and the encoders; [`Nodes`] are the processes; [`Listener`] hears and keeps what they say.

mod film;
pub mod processes;
pub mod scenario;

pub use film::{Film, Frame};
pub use processes::{Nodes, ProcessError};
pub use scenario::{Cover, Scenario};
