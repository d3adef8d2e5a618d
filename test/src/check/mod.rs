//! `volant check` on recordings whose files or messages are wrong in one thing.

pub mod bench;
pub mod fault;
pub mod light;

pub use bench::{Bench, Cell};
pub use fault::{FAULTS, Fault};
pub use light::findings_while_running;
