//! The simulated rig, live: four real nodes as processes of their own, and hardware that is not there.
//!
//! [`Film`] is what the camera will see, taken beforehand; [`Stand`] plays it on the image topic at its time, beside an
//! inertial unit on a pty and the encoders, and hears what the nodes say ([`Heard`]); [`Nodes`] are the processes; [`Run`]
//! is all of it from start to clean end; [`bag`] keeps it.

pub mod bag;
mod clock;
mod film;
mod heard;
pub mod messages;
pub mod processes;
mod run;
pub mod scenario;
pub mod site;
mod stand;

pub use clock::SettableClock;
pub use film::{Film, Frame};
pub use heard::{Heard, Received, quantile};
pub use processes::{Node, Nodes, ProcessError};
pub use run::{Ended, NODES, Run, RunError};
pub use scenario::{Cover, Scenario};
pub use site::{ClockError, Ears, Host, Namespaces, Site};
pub use stand::{Said, Saying, Spoiler, Stand, StandError};
