//! What the tests share: the simulated rig (the very files of the test package, without its weight).
#![allow(dead_code, missing_docs, unused_imports)] // each test uses its share
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::panic)] // test code, outside of #[test]

#[path = "../../../test/src/rig"]
pub mod rig {
    pub mod inertial;
    pub mod motion;
    pub mod random;
}

pub mod bags;
pub mod bound;
pub mod laps;
pub mod scoring;
pub mod simulated;
