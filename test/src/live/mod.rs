//! The simulated rig, live: the four nodes as processes, and simulated hardware.
//!
//! [`ImageSequence`] is rendered in advance. [`SimulatedHardware`] publishes it in real time,
//! beside an IMU on a pty and the encoders, and collects the nodes' messages ([`Received`]).
//! [`Nodes`] are the processes, [`Run`] is a run from start to clean end, [`bag`] writes it to a
//! file.

pub mod bag;
mod clock;
mod hardware;
mod images;
pub mod processes;
mod received;
mod run;
pub mod scenario;
pub mod site;

pub use clock::SettableClock;
pub use hardware::{FaultInjector, SimulatedHardware};
pub use images::{Frame, ImageSequence};
pub use processes::{Node, Nodes};
pub use received::{Received, TopicLog, quantile};
pub use run::{Ended, Run};
pub use scenario::{Cover, Scenario};
pub use site::{ClockError, Host, Namespaces, Site};
