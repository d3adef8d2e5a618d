//! What tests need from the machine: recordings and Python peers, or a recorded skip; processes,
//! and folders for them.
//!
//! libtest cannot report a test as skipped while it runs. A test that lacks something calls
//! [`skip`] and returns; `test/tier`, which `make test` runs, counts it as skipped, not as passed.

pub mod place;
pub mod process;

use std::{fmt::Display, io::Write as _, path::PathBuf, process::Command};

/// Reports the running test as skipped: a line `SKIPPED <test>: <reason>` on standard error.
///
/// The reason says what is missing and how to get it. The line passes libtest's capture, so that
/// `cargo test` shows it for a test that passes.
pub fn skip(reason: impl Display) {
    let thread = std::thread::current();
    let test = std::env::var("NEXTEST_TEST_NAME").ok();
    let test = test.as_deref().or(thread.name()).unwrap_or("?");
    // libtest captures `eprintln!`, but not the stream itself. Nothing is lost without the stream.
    let _ = std::io::stderr().write_all(format!("SKIPPED {test}: {reason}\n").as_bytes());
}

/// Folder of the recordings with `bags/` and `data/` in it, from `VOLANT_SHARED`; else a skip.
pub fn recordings() -> Option<PathBuf> {
    let folder = variable("VOLANT_SHARED");
    if folder.is_none() {
        skip("VOLANT_SHARED does not name the folder of the recordings (bags/, data/)");
    }
    folder
}

/// The Python of `VOLANT_PYTHON` if it can import `module`, else a skip.
pub fn python(module: &str) -> Option<PathBuf> {
    let Some(python) = variable("VOLANT_PYTHON") else {
        skip(format!("VOLANT_PYTHON names no Python with {module}; `make test` sets it"));
        return None;
    };
    let import = Command::new(&python).args(["-c", &format!("import {module}")]).output();
    if import.is_ok_and(|output| output.status.success()) {
        return Some(python);
    }
    skip(format!("{} cannot import {module}", python.display()));
    None
}

fn variable(name: &str) -> Option<PathBuf> {
    std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from)
}
