//! The simulated rig's own tests run here too: all that is asserted about the filter rests on them.
mod common;
