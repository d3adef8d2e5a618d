//! A folder in which `volant` runs.
#![allow(clippy::unwrap_used, clippy::new_without_default, reason = "tests use it")]

use crate::process::executables;
use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Output},
};
use tempfile::TempDir;

/// Names of the files in a folder, sorted.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<_> =
        entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// How a command ended, and what it printed.
pub struct Ran {
    /// Exit status; `None` after a signal.
    pub status: Option<i32>,
    /// Standard output.
    pub out: String,
    /// Standard error.
    pub err: String,
}

impl From<Output> for Ran {
    fn from(output: Output) -> Self {
        let [out, err] =
            [output.stdout, output.stderr].map(|b| String::from_utf8_lossy(&b).into_owned());
        Self { status: output.status.code(), out, err }
    }
}

impl Ran {
    /// Asserts that it failed with one line with these words.
    pub fn failed_with(&self, words: &[&str]) {
        let line = &self.err;
        assert_eq!(self.status, Some(1), "{line}");
        assert_eq!(line.trim_end().lines().count(), 1, "{line}");
        for word in words {
            assert!(line.contains(word), "`{word}` is not in: {line}");
        }
        assert!(!line.contains("panicked"), "{line}");
    }
}

/// A temporary folder in which `volant` runs.
pub struct Place(TempDir);

impl Place {
    /// Makes an empty folder.
    pub fn new() -> Self {
        Self(TempDir::new().unwrap())
    }

    /// Makes a folder with a `rig.yaml`.
    pub fn with_rig(text: &str) -> Self {
        let place = Self::new();
        place.write("rig.yaml", text);
        place
    }

    /// Its path.
    pub fn folder(&self) -> &Path {
        self.0.path()
    }

    /// Path of a file in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a file.
    pub fn write(&self, name: &str, bytes: impl AsRef<[u8]>) {
        fs::write(self.path(name), bytes).unwrap();
    }

    /// Reads a file.
    pub fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.path(name)).unwrap()
    }

    /// Reads a text file.
    pub fn text(&self, name: &str) -> String {
        String::from_utf8(self.read(name)).unwrap()
    }

    /// Names of its files, sorted.
    pub fn names(&self) -> Vec<String> {
        names(self.folder())
    }

    /// `volant` with these words, which are separated by spaces.
    pub fn command(&self, arguments: &str) -> Command {
        let mut command = Command::new(executables().join("volant"));
        command.args(arguments.split_whitespace()).current_dir(self.folder());
        command
    }

    /// Runs a command.
    pub fn volant(&self, arguments: &str) -> Ran {
        self.command(arguments).output().unwrap().into()
    }

    /// Runs a command that succeeds; returns what it prints.
    pub fn done(&self, arguments: &str) -> String {
        let ran = self.volant(arguments);
        assert_eq!(ran.status, Some(0), "{arguments}: {}{}", ran.out, ran.err);
        ran.out + &ran.err
    }

    /// Runs a command that fails; returns its error.
    pub fn failed(&self, arguments: &str) -> String {
        let ran = self.volant(arguments);
        assert_eq!(ran.status, Some(1), "{arguments}: {}", ran.err);
        ran.err
    }

    /// Runs a command that fails with one line with these words.
    pub fn fails(&self, arguments: &str, words: &[&str]) {
        self.volant(arguments).failed_with(words);
    }
}
