//! What `volant` does, as a library: bags, replay of a recorded run through the nodes' own code, and the evaluation of
//! its estimates against the truth.

pub mod bag;
pub mod evaluate;
pub mod replay;
mod stopwatch;
