//! What `volant` does, as a library: bags, replay of a recorded run through the nodes' own code, and the evaluation of
//! its estimates against the truth; with the feature `nodes` also recording from and playing onto live topics.

pub mod bag;
pub mod evaluate;
#[cfg(feature = "nodes")]
pub mod live;
pub mod replay;
pub mod report;
mod stopwatch;
