//! Time line: measurements in the order of their own time, with the state after each of them.
//!
//! A delayed measurement goes to its place, and everything behind it is propagated again from
//! there.

pub mod arrival;
pub mod clock_step;
pub mod dropout;
pub mod history;
pub mod repropagation;
