//! What the tests share.
#![allow(dead_code, missing_docs, unused_imports)] // each test uses its share
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

pub mod bags;
pub mod bound;
pub mod laps;
pub mod scoring;
pub mod simulated;
